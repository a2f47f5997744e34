// The panel beside the views: the chosen entry, the point of the slices, what is shown, and the ranked entries.

import { ofEntry, Sentences } from "./sentences.js";
import { make, percent } from "./texts.js";

const ROWS = {
  Entry: ["success", "interval", "by the table", "expected", "under errors", "length", "risk", "turns", "loss 2 mm", "loss 2°", "entry, RAS", "direction"],
  Solve: ["states", "status", "time"],
};

const points = (share) => (100 * share).toFixed(1);

export class SpacePanel {
  constructor(numbers, ranked, choose) {
    this.parts = {};
    this.ranked = ranked;
    this.choose = choose;
    this.sentences = new Sentences(numbers);
    for (const [title, names] of Object.entries(ROWS)) {
      const table = numbers.appendChild(make("table"));
      table.append(make("caption", title));
      for (const name of names) {
        const row = table.appendChild(make("tr"));
        row.appendChild(make("th", name)).scope = "row";
        this.parts[name] = row.appendChild(make("td", "–"));
        this.parts[name].dataset.name = name;
      }
    }
  }

  load(volume) {
    this.volume = volume;
    this.write({
      states: volume.states.toLocaleString("en"), status: volume.status.replace("_", " "), time: `${volume.seconds.toFixed(1)} s`,
    });
    const table = make("table");
    table.className = "list";
    const several = volume.targets.length > 1;
    table.append(make("caption", `Ranked by expected ${several ? "number of targets" : "success, in %; by executions"}`));
    const head = table.appendChild(make("thead")).appendChild(make("tr"));
    for (const name of ["rank", several ? "targets" : "expected", "success", "clear", "length", "turns"]) head.appendChild(make("th", name)).scope = "col";
    const body = table.appendChild(make("tbody"));
    volume.ranked.forEach((each, index) => {
      const row = body.appendChild(make("tr"));
      row.dataset.number = each.number;
      const button = row.appendChild(make("td")).appendChild(make("button", String(index + 1)));
      const worth = several ? `expected number of targets ${each.score.toFixed(2)}` : `expected success ${percent(each.expected_success)}`;
      button.setAttribute("aria-label", `Entry ${index + 1}, ${worth}`);
      button.addEventListener("click", () => this.choose(each.number));
      for (const text of [several ? each.score.toFixed(2) : points(each.expected_success), points(each.success), each.clearance_mm.toFixed(1), each.length_mm.toFixed(0), String(each.turns)]) {
        row.appendChild(make("td", text));
      }
    });
    this.ranked.replaceChildren(table);
  }

  // Shows at once what the table says of an entry; the other numbers follow.
  expect(tableSuccess) {
    for (const name of ROWS.Entry) this.parts[name].textContent = "…";
    this.write({ "by the table": percent(tableSuccess) });
    this.parts.success.ariaBusy = "true";
  }

  // Shows the numbers of an entry, with its success by executions if that is known.
  show(entry) {
    const numbers = (values, digits) => values.map((each) => each.toFixed(digits).replace("-", "−")).join(", ");
    this.write({
      "by the table": percent(entry.table_success),
      length: `${entry.length_mm.toFixed(1)} mm`,
      risk: entry.risk ? `${entry.risk.distance_mm.toFixed(1)} mm, ${entry.risk.name}` : "none near",
      turns: String(entry.turns),
      "loss 2 mm": `${(100 * entry.shift_cost).toFixed(1)} points`,
      "loss 2°": `${(100 * entry.tilt_cost).toFixed(1)} points`,
      "entry, RAS": `${numbers(entry.position_mm, 1)} mm`,
      direction: numbers(entry.direction, 3),
    });
    this.showEstimate(entry);
    this.sentences.show(ofEntry(entry, this.volume));
    for (const row of this.ranked.querySelectorAll("tbody tr")) {
      const chosen = Number(row.dataset.number) === entry.number;
      row.classList.toggle("chosen", chosen);
      row.querySelector("button").setAttribute("aria-pressed", String(chosen));
    }
  }

  showEstimate({ success, success_interval: interval, expected_success: expected, promise }) {
    this.write({ "under errors": promise ? promised(promise) : "–" });
    if (!interval) return;
    this.write({ success: percent(success), interval: `${points(interval[0])}–${percent(interval[1])}`, expected: percent(expected) });
    this.parts.success.ariaBusy = "false";
  }

  // No estimate comes.
  leaveEstimate() {
    this.write({ success: "–", interval: "–", expected: "–", "under errors": "–" });
    this.parts.success.ariaBusy = "false";
  }

  write(found) {
    for (const [name, text] of Object.entries(found)) this.parts[name].textContent = text;
  }
}

// The success under all errors with its interval, then under each error alone.
function promised({ together, uncertainty: _, exact: __, ...alone }) {
  const [low, high] = together.success_interval;
  const parts = Object.entries(alone).map(([name, part]) => `${name} ${percent(part.success)}`);
  return `${percent(together.success)} (${points(low)}–${percent(high)}); ${parts.join(", ")}`;
}

// What is at a grid point, in words.
export function describe(volume, at) {
  const { shape, spacing_mm: spacing, origin_mm: origin, axes } = volume;
  const state = (at[0] * shape[1] + at[1]) * shape[2] + at[2];
  const ras = [0, 1, 2].map((part) => origin[part] + at.reduce((sum, index, axis) => sum + index * spacing * axes[axis][part], 0));
  const label = volume.labels[volume.label_numbers[state]];
  const what = ["tissue", "target", "obstacle or its margin", "outside"][volume.codes[state]];
  const words = [`R, A, S ${ras.map((mm) => mm.toFixed(1).replace("-", "−")).join(", ")} mm`, label ? `${label} (${what})` : what];
  if (volume.codes[state] < 2) {
    const clearance = volume.clearance[state] / 8;
    words.push(`success ${percent(volume.field[state] / 255)} by the table in the best direction`);
    words.push(`clearance ${clearance >= 30 ? "30 mm or more" : `${clearance.toFixed(1)} mm`}`);
    words.push(`radius ${volume.radii_mm[volume.tissues[state]]} mm`);
  }
  return words.join("; ");
}
