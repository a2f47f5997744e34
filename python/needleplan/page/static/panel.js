// The panel beside the plane: what the plan promises, what executions make of it, and how it was computed.
// While two plans are compared, a second column shows the numbers of the pinned one.

import { ofPlan, Sentences } from "./sentences.js";
import { make, percent } from "./texts.js";

const ROWS = {
  Success: ["predicted", "realised", "interval"],
  Path: ["outcome", "length", "turns", "risk", "cost", "entry", "heading"],
  Solve: ["states", "status", "error", "time"],
};

export class Panel {
  constructor(element) {
    this.element = element;
    this.parts = {};
    this.sentences = new Sentences(element);
    for (const [title, names] of Object.entries(ROWS)) this.section(title, names);
    this.bar = this.makeBar();
    // What the grid of the plan does not resolve, or where executions break its promise.
    this.warnings = make("p");
    this.warnings.className = "warnings";
    this.warnings.setAttribute("role", "status");
    element.querySelector("table").after(this.bar.element, this.warnings);
  }

  section(title, names) {
    const table = make("table");
    table.append(make("caption", title));
    for (const name of names) {
      const row = table.appendChild(make("tr"));
      const head = row.appendChild(make("th", name));
      head.scope = "row";
      this.parts[name] = row.appendChild(make("td", "–"));
      this.parts[name].dataset.name = name;
      this.parts[`${name} pinned`] = row.appendChild(make("td"));
      this.parts[`${name} pinned`].className = "pinned";
    }
    this.element.append(table);
  }

  // A scale from 0 to 1 with the predicted success as a mark and the interval of the realised success as a bar.
  makeBar() {
    const element = make("div");
    element.className = "bar";
    element.setAttribute("aria-hidden", "true");
    const interval = element.appendChild(make("i"));
    const mark = element.appendChild(make("b"));
    return { element, interval, mark };
  }

  show(store) {
    const { plan, executions, pinned } = store;
    this.sentences.show(ofPlan(store));
    this.element.classList.toggle("comparing", Boolean(pinned));
    this.write(texts(plan, executions), "");
    this.write(pinned ? texts(pinned.plan, pinned.executions) : {}, " pinned");
    const warnings = plan && !plan.draft ? (executions?.warnings ?? []) : [];
    this.warnings.textContent = warnings.map((warning) => `Warning: ${warning}.`).join(" ");
    this.bar.mark.style.left = plan ? percent(plan.predicted_success).replace(" ", "") : "0%";
    const [low, high] = executions?.interval ?? [0, 0];
    this.bar.interval.style.left = `${100 * low}%`;
    this.bar.interval.style.width = `${100 * (high - low)}%`;
  }

  write(found, suffix) {
    for (const [name, text] of Object.entries(found)) {
      const part = this.parts[name + suffix];
      if (part.textContent !== text) part.textContent = text;
    }
  }
}

function texts(plan, executions) {
  if (!plan) return {};
  const { start } = plan;
  return {
    predicted: percent(plan.predicted_success),
    realised: executions ? percent(executions.success) : "…",
    interval: executions ? `${percent(executions.interval[0]).replace(" %", "")}–${percent(executions.interval[1])}` : "…",
    outcome: plan.reached ? "target" : plan.outcome,
    length: `${plan.length_mm.toFixed(1)} mm`,
    turns: String(plan.turns),
    risk: plan.risk ? `${plan.risk.distance_mm.toFixed(1)} mm, ${plan.risk.name.replace("obstacle ", "")}` : "none",
    cost: plan.predicted_cost === "inf" ? "∞" : String(Number(plan.predicted_cost.toPrecision(4))),
    entry: `${start.x_mm.toFixed(1)}, ${start.y_mm.toFixed(1)} mm`,
    heading: `${start.heading_deg.toFixed(1).replace("-", "−")}°, bevel ${start.bevel > 0 ? "+1" : "−1"}`,
    states: `${plan.states.toLocaleString("en")}${plan.draft ? " (draft)" : ""}`,
    status: plan.status.replace("_", " "),
    error: plan.error_bound === "inf" ? "no bound" : `≤ ${plan.error_bound.toPrecision(2)}`,
    time: `${(1000 * plan.seconds).toFixed(0)} ms`,
  };
}
