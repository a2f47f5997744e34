// The panel beside the plane: what the plan promises, what executions make of it, and how it was computed.

export class Panel {
  constructor(element) {
    this.element = element;
    this.parts = {};
    this.section("Success", ["predicted", "realised"]);
    this.section("Path", ["outcome", "length", "rotations", "cost", "entry"]);
    this.section("Solve", ["grid", "status", "time"]);
  }

  section(title, names) {
    const heading = make("h2", title);
    const list = make("dl");
    for (const name of names) {
      this.parts[name] = make("dd", "–");
      this.parts[name].dataset.name = name;
      list.append(make("dt", name), this.parts[name]);
    }
    this.element.append(heading, list);
  }

  show({ plan, executions }) {
    if (!plan) return;
    const { start } = plan;
    this.write({
      predicted: percent(plan.predicted_success),
      outcome: plan.reached ? "target" : plan.outcome,
      length: `${plan.length_mm.toFixed(1)} mm`,
      rotations: String(plan.turns),
      cost: plan.predicted_cost.toPrecision(4),
      entry: `${start.x_mm.toFixed(1)}, ${start.y_mm.toFixed(1)} mm; ${start.heading_deg.toFixed(1)}°; bevel ${start.bevel > 0 ? "+1" : "−1"}`,
      grid: `${plan.shape.slice(0, 3).join(" × ")} × 2 = ${plan.states.toLocaleString("en")} states${plan.draft ? ", draft" : ""}`,
      status: `${plan.status.replace("_", " ")}, error ≤ ${plan.error_bound === "inf" ? "∞" : plan.error_bound.toPrecision(2)}`,
      time: `${(1000 * plan.seconds).toFixed(0)} ms`,
    });
    const realised = executions && `${percent(executions.success)} (${percent(executions.interval[0])} to ${percent(executions.interval[1])})`;
    this.write({ realised: realised || "…" });
  }

  write(texts) {
    for (const [name, text] of Object.entries(texts)) {
      if (this.parts[name].textContent !== text) this.parts[name].textContent = text;
    }
  }
}

export function percent(share) {
  return `${(100 * share).toFixed(1)} %`;
}

export function make(tag, text = "") {
  const element = document.createElement(tag);
  if (text) element.textContent = text;
  return element;
}
