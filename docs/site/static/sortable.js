// Tables of the validation pages: a click on a heading sorts the rows by its column, another click turns the order round.

const number = (text) => Number.parseFloat(text.replace(/[,\s]/g, "").replace("−", "-"));

function compare(one, other) {
  const [a, b] = [number(one), number(other)];
  if (Number.isNaN(a) && Number.isNaN(b)) return one.localeCompare(other);
  return Number.isNaN(a) ? 1 : Number.isNaN(b) ? -1 : a - b; // rows without a number come last
}

function sort(table, heading) {
  const column = heading.cellIndex;
  const falling = heading.getAttribute("aria-sort") === "ascending";
  for (const each of heading.parentElement.cells) each.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", falling ? "descending" : "ascending");
  const text = (row) => row.cells[column]?.textContent.trim() ?? "";
  const rows = [...table.tBodies[0].rows].sort((one, other) => compare(text(one), text(other)));
  table.tBodies[0].append(...(falling ? rows.reverse() : rows));
}

for (const table of document.querySelectorAll("article table")) {
  if (!location.pathname.includes("/validation/") || !table.tHead || table.tBodies[0].rows.length < 3) continue;
  for (const heading of table.tHead.rows[0].cells) {
    const button = document.createElement("button");
    button.type = "button";
    button.title = "sort by this column";
    button.style.cssText = "all: unset; cursor: pointer; text-decoration: underline dotted";
    button.append(...heading.childNodes);
    button.addEventListener("click", () => sort(table, heading));
    heading.append(button);
  }
}
