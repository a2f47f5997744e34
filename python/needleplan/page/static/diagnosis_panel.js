// The result of a diagnosis in words and numbers: verdict, hypotheses, effects, gap, next motion.

import { Chart, written } from "./chart.js";
import { palette } from "./colours.js";
import { round } from "./curves.js";
import { make, roleWords } from "./panel.js";

const VERDICTS = {
  none: "No effect is missing that these data could show.",
  underpowered: "Nothing was found, but these data could hide a relevant effect.",
  named: "The missing effect is known.",
  incomplete: "A missing effect is known, and probably something else is missing too.",
  ambiguous: "Something is missing, and these data do not decide which effect.",
  changed: "No effect is missing, but parameters or laws of the model have changed.",
  unknown: "Something is missing, and no known effect explains it.",
  implausible: "The best effect has an amplitude at its bound: check units and model.",
};

const named = (name) => (name === "size" ? "amplitude" : name.replace(/_(mm|s|n|hz|rad|mm_s)$/, "").replaceAll("_", " "));
const interval = (low, high) => (low === null && high === null ? "none" : `${written(round(low))} to ${written(round(high))}`);

export class DiagnosisPanel {
  constructor(element) {
    this.element = element;
  }

  load(found) {
    this.found = found;
    const { element } = this;
    element.replaceChildren();
    const verdict = element.appendChild(make("p", VERDICTS[found.verdict] ?? found.verdict));
    verdict.className = "verdict";
    verdict.dataset.name = "verdict";
    for (const sentence of found.sentences) element.append(make("p", sentence));
    this.addGiven(found);
    this.addHypotheses(found);
    this.addEffects(found);
    this.addGap(found);
    this.addTrials(found);
    this.addList("What to do", found.advice);
    this.addNext(found.next_motion);
    this.addList("Where the gap is", found.where.map(({ label, share }) => `${label}: ${Math.round(100 * share)} % of the gap`));
    this.addFacts(found.facts);
  }

  addList(title, lines) {
    if (!lines.length) return;
    this.element.append(make("h2", title));
    const list = this.element.appendChild(make("ul"));
    for (const each of lines) list.append(make("li", each));
  }

  addTable(caption, head, rows) {
    const table = this.element.appendChild(make("table"));
    table.className = "list";
    table.append(make("caption", caption));
    const line = table.appendChild(make("thead")).appendChild(make("tr"));
    for (const name of head) line.appendChild(make("th", name)).scope = "col";
    const body = table.appendChild(make("tbody"));
    for (const [first, ...others] of rows) {
      const row = body.appendChild(make("tr"));
      row.appendChild(make("th", first)).scope = "row";
      for (const each of others) row.append(make("td", each));
    }
    return table;
  }

  addEffects({ effects }) {
    for (const effect of effects) {
      const rows = effect.parameters.map(({ name, value, low, high, unit }) => [
        named(name),
        written(round(value)), interval(low, high), unit || "1",
      ]);
      this.addTable(effect.title, ["parameter", "value", "95 % interval", "unit"], rows).dataset.effect = effect.title;
      const law = this.element.appendChild(make("p", `${effect.equation} (${effect.source})`));
      law.className = "remark";
    }
  }

  // Parameters of the given model, with the intervals of its file, beside the data.
  addGiven({ given }) {
    if (!given) return;
    const closes = ({ share }) => (share === null ? "" : `${Math.round(100 * share)} %`);
    const stages = given.stages.map((stage) => [stage.name, written(round(stage.rms)), closes(stage)]);
    this.addTable("Gap budget: residual after each stage", ["stage", "RMS", "closes"], stages).dataset.name = "budget";
    if (!given.parameters.length) return;
    const rows = given.parameters.map(({ name, unit, given: value, file_low, file_high, value: now, low, high, departs }) => [
      named(name), `${written(round(value))} ${unit}\n${interval(file_low, file_high)}`,
      `${written(round(now))} ${unit}\n${interval(low, high)}`,
      file_low === null ? (departs ? "differs" : "agrees") : departs ? "outside" : "inside",
    ]);
    const head = ["parameter", "given, 95 % interval of the file", "in the data, 95 % interval", "verdict"];
    this.addTable("The given model beside the data", head, rows).dataset.name = "given";
  }

  // Bars of the residual on the held-out trials, with the noise.
  addGap({ held_out: gap, unit, noise_rms: noise }) {
    if (!gap) return;
    this.element.append(make("h2", "Gap on the held-out trials"));
    const most = Math.max(gap.before_rms, gap.after_rms, noise) || 1;
    for (const [name, value] of [["before", gap.before_rms], ["after", gap.after_rms], ["noise", gap.floor_rms]]) {
      const row = this.element.appendChild(make("div"));
      row.className = "gauge";
      row.dataset.gap = name;
      row.append(make("span", name));
      const bar = row.appendChild(make("i"));
      bar.className = name;
      bar.style.width = `${(52 * value) / most}%`;
      row.append(make("span", `${written(round(value))} ${unit}`));
    }
  }

  addTrials({ trials, unit }) {
    const rows = trials.map(({ trial, role, before_rms: before, after_rms: after }) => [
      trial, roleWords(role), written(round(before)), written(round(after)),
    ]);
    const table = this.addTable("Residual RMS, ", ["trial", "role", "before", "after"], rows);
    table.caption.appendChild(make("span", unit)).className = "unit";
  }

  addHypotheses({ hypotheses }) {
    this.addList("Hypotheses", hypotheses.map(({ words, probability, because }) => `${(100 * probability).toFixed(1)} % ${words}: ${because}`));
  }

  addNext(next) {
    if (!next) return;
    this.element.append(make("h2", "Next motion"));
    this.element.append(make("p", `${next.why} Role: ${roleWords(next.role)}.`));
    const list = this.element.appendChild(make("ul"));
    for (const { name, about, file, duration_s: seconds } of next.motions) {
      list.append(make("li", `${name}: ${about}, ${seconds.toFixed(0)} s${file ? ` (${file})` : ""}`));
    }
    if (!this.found.next_time_s) return;
    this.canvas = this.element.appendChild(make("canvas"));
    this.canvas.className = "motion";
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `Depth over time of the next motion: ${next.motions[0].about}`);
    this.chart = new Chart(this.canvas);
    new ResizeObserver(() => this.paint()).observe(this.canvas);
  }

  addFacts(facts) {
    const table = this.element.appendChild(make("table"));
    table.append(make("caption", "Provenance"));
    for (const [name, value] of Object.entries(facts)) {
      const row = table.appendChild(make("tr"));
      row.appendChild(make("th", name)).scope = "row";
      row.appendChild(make("td", value)).className = "long";
    }
  }

  paint() {
    if (!this.canvas) return;
    const { next_time_s: values, next_depth_mm: depth } = this.found;
    const colours = palette();
    const x = { values, label: "time (s)", low: values[0], high: values[values.length - 1] };
    this.chart.draw({ x, panels: [{ label: "depth (mm)", share: 1, lines: [{ values: depth, colour: colours.after }] }], colours });
  }
}
