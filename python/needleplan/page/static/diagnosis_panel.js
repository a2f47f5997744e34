// The result of a diagnosis in words and numbers: verdict, hypotheses, effects, gap, next motion.

import { Chart, written } from "./chart.js";
import { palette } from "./colours.js";
import { round } from "./curves.js";
import { ofDiagnosis, Sentences } from "./sentences.js";
import { make, roleWords } from "./texts.js";

// Words for the stages of the gap budget.
const STAGES = { given: "given model", parameters: "other parameters", effects: "effects", laws: "laws and tissue" };

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
    const sentences = new Sentences(element);
    sentences.show(ofDiagnosis(found));
    sentences.element.firstChild.dataset.name = "verdict";
    this.addBudget(found);
    element.append(make("h2", "In detail"));
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

  // Shares of the gap by cause, as bars, and what each leaves: other values of parameters, each effect, laws, noise.
  addBudget({ given, effects, unit }) {
    if (!given) return;
    this.element.append(make("h2", "Gap budget"));
    const table = this.element.appendChild(make("table"));
    table.className = "list budget";
    table.dataset.name = "budget";
    table.append(make("caption", `RMS left, ${unit}; share of the gap closed`));
    table.caption.className = "plain";
    const body = table.appendChild(make("tbody"));
    const row = (name, rms, share, isPart = false) => {
      const line = body.appendChild(make("tr"));
      line.classList.toggle("part", isPart);
      line.appendChild(make("th", name)).scope = "row";
      line.append(make("td", rms === null ? "" : written(round(rms))));
      const cell = line.appendChild(make("td", share === null ? "" : `${Math.round(100 * share)} %`));
      const bar = line.appendChild(make("td")).appendChild(make("i"));
      bar.style.width = `${100 * Math.max(0, Math.min(1, share ?? 0))}%`;
      cell.className = "number";
    };
    for (const { name, rms, share } of given.stages) {
      row(STAGES[name] ?? name, rms, name === "given" ? null : share);
      // The share of the stage is divided among its effects by their squared amplitudes in standard deviations.
      if (name === "effects" && share !== null) for (const effect of effects) row(effect.title, null, share * effect.share, true);
    }
    row("noise", given.noise_rms, null);
  }

  // Parameters of the given model, with the intervals of its file, beside the data.
  addGiven({ given }) {
    if (!given) return;
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
