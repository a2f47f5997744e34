// Buttons with actions, menus that close, and files that the browser saves: what all pages share.

// Calls the action of a button with `data-action`, and closes its menu. Escape and a click elsewhere close menus too.
export function connect(actions) {
  for (const button of document.querySelectorAll("[data-action]")) {
    button.addEventListener("click", () => {
      button.closest("details")?.removeAttribute("open");
      actions[button.dataset.action]();
    });
  }
  for (const menu of document.querySelectorAll("details")) {
    menu.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      menu.removeAttribute("open");
      menu.querySelector("summary").focus();
    });
  }
  addEventListener("pointerdown", ({ target }) => {
    for (const menu of document.querySelectorAll("details[open]")) if (!menu.contains(target)) menu.removeAttribute("open");
  });
}

export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
