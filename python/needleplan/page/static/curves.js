// The curves of one trial: measured and modelled output, residual with the band of the noise, and depth.

import { Chart, written } from "./chart.js";
import { palette } from "./colours.js";
import { make, roleWords } from "./texts.js";

const NOISE_SDS = 2; // half width of the band of noise
const SHARES = { output: 3, residual: 2, depth: 1 };

export class Curves {
  constructor(section, announce) {
    this.section = section;
    this.announce = announce;
    this.canvas = section.querySelector("canvas");
    this.chart = new Chart(this.canvas);
    this.slider = section.querySelector(".place input");
    this.told = section.querySelector(".place output");
    this.shown = { before: true, after: true, axis: "time", output: 0 };
    this.trial = 0;
    this.zoomed = null; // the shown part of the axis, [low, high]; null: the whole
    for (const name of ["before", "after"]) {
      this.input(name).addEventListener("change", ({ target }) => this.set({ [name]: target.checked }));
    }
    for (const name of ["axis", "output"]) {
      this.input(name).addEventListener("change", ({ target }) => {
        this.zoomed = null;
        this.set({ [name]: name === "output" ? Number(target.value) : target.value });
      });
    }
    for (const button of section.querySelectorAll("[data-zoom]")) {
      button.addEventListener("click", () => this.zoom(Number(button.dataset.zoom)));
    }
    this.slider.addEventListener("input", () => this.paint());
    this.canvas.addEventListener("pointermove", (event) => this.follow(event));
    this.canvas.addEventListener("pointerdown", (event) => this.follow(event));
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 0.8 : 1.25);
    }, { passive: false });
    new ResizeObserver(() => this.paint()).observe(this.canvas);
  }

  input(name) {
    return this.section.querySelector(`[name="${name}"]`);
  }

  set(change) {
    Object.assign(this.shown, change);
    this.paint();
  }

  load(found) {
    this.found = found;
    this.section.hidden = Boolean(found.problem);
    if (found.problem) return;
    this.input("output").replaceChildren(...found.outputs.map((name, number) => new Option(name, number)));
    this.input("output").parentElement.hidden = found.outputs.length < 2;
    if (!found.after0) this.input("after").closest("label").hidden = true;
    const group = this.section.querySelector("#trials");
    group.replaceChildren(...found.trials.map(({ trial, role }, number) => {
      const button = make("button", trial);
      button.append(make("small", roleWords(role)));
      button.dataset.role = role;
      button.addEventListener("click", () => this.choose(number));
      return button;
    }));
    this.shown.output = this.largest();
    this.input("output").value = this.shown.output;
    this.choose(0);
  }

  // Number of the output that the effects change most, in all trials; 0 if no effect was added.
  largest() {
    const { found } = this;
    if (!found.after0) return 0;
    const energy = found.outputs.map(() => 0);
    found.trials.forEach((_, trial) => {
      const [before, after] = [found[`before${trial}`], found[`after${trial}`]];
      const count = found[`time_s${trial}`].length;
      before.forEach((value, sample) => { energy[Math.floor(sample / count)] += (value - after[sample]) ** 2; });
    });
    return energy.indexOf(Math.max(...energy));
  }

  choose(number) {
    this.trial = number;
    this.zoomed = null;
    [...this.section.querySelectorAll("#trials button")].forEach((button, place) => {
      button.setAttribute("aria-pressed", String(place === number));
    });
    const count = this.found[`time_s${number}`].length;
    this.slider.max = count - 1;
    this.slider.value = Math.floor(count / 2);
    this.paint();
    this.announce(this.summary());
  }

  // The curves of the shown trial and output.
  curves() {
    const { found, trial, shown } = this;
    const time = found[`time_s${trial}`];
    const count = time.length;
    const of = (name) => found[`${name}${trial}`]?.subarray(shown.output * count, (shown.output + 1) * count) ?? null;
    return { time, depth: found[`depth_mm${trial}`], measured: of("measured"), before: of("before"), after: of("after") };
  }

  summary() {
    const { trial, role, before_rms: before, after_rms: after } = this.found.trials[this.trial];
    const { unit, noise_rms: noise } = this.found;
    const words = [`residual ${written(round(before))} ${unit} before`];
    if (after !== null) words.push(`${written(round(after))} ${unit} after`);
    return `Trial ${trial}, ${roleWords(role)}: ${words.join(", ")}; noise ${written(round(noise))} ${unit} RMS.`;
  }

  paint() {
    if (!this.found || this.found.problem) return;
    const { found, shown } = this;
    const colours = palette();
    const curves = this.curves();
    const values = shown.axis === "time" ? curves.time : curves.depth;
    this.whole = extent(values);
    const [low, high] = this.zoomed ?? this.whole;
    const place = Number(this.slider.value);
    const name = `${found.outputs[shown.output]} (${found.unit})`;
    const output = [{ values: curves.measured, colour: colours.measured, width: 1 }];
    const residual = [];
    for (const [key, dash] of [["before", [6, 3]], ["after", []]]) {
      if (!shown[key] || !curves[key]) continue;
      output.push({ values: curves[key], colour: colours[key], width: 1.75, dash });
      residual.push({ values: curves.measured.map((each, sample) => each - curves[key][sample]), colour: colours[key], width: 1 });
    }
    const noise = NOISE_SDS * found.noise_rms;
    const panels = [
      { label: name, share: SHARES.output, lines: output },
      { label: `residual (${found.unit})`, share: SHARES.residual, lines: residual, band: [-noise, noise] },
    ];
    if (shown.axis === "time") {
      panels.push({ label: "depth (mm)", share: SHARES.depth, lines: [{ values: curves.depth, colour: colours.ink }] });
    }
    const label = shown.axis === "time" ? "time (s)" : "depth of the tip (mm)";
    this.chart.draw({ x: { values, label, low, high }, panels, place, colours });
    this.tell(curves, place);
  }

  // Writes the values at the chosen sample beside the slider.
  tell(curves, place) {
    const { unit } = this.found;
    const parts = [`${curves.time[place].toFixed(2)} s`, `depth ${curves.depth[place].toFixed(1)} mm`, `measured ${curves.measured[place].toFixed(3)} ${unit}`];
    for (const key of ["before", "after"]) {
      if (curves[key]) parts.push(`${key} ${curves[key][place].toFixed(3)} ${unit}`);
    }
    const text = parts.join(" · ").replaceAll("-", "−");
    this.told.textContent = text;
    this.slider.setAttribute("aria-valuetext", parts.join(", "));
    this.canvas.setAttribute("aria-label", this.summary());
  }

  // Chooses the sample nearest to the pointer; over depth, the one nearest in time to the sample before.
  follow({ clientX }) {
    if (!this.found || this.found.problem) return;
    const wanted = this.chart.valueAt(clientX - this.canvas.getBoundingClientRect().left);
    const { values } = this.chart.x;
    const before = Number(this.slider.value);
    let [best, least] = [before, Infinity];
    const tolerance = (this.chart.x.high - this.chart.x.low) / this.chart.frame.width;
    for (let sample = 0; sample < values.length; sample++) {
      const far = Math.max(Math.abs(values[sample] - wanted), tolerance) + 1e-6 * tolerance * Math.abs(sample - before);
      if (far < least) [best, least] = [sample, far];
    }
    if (best === before) return;
    this.slider.value = best;
    this.paint();
  }

  // Shows `factor` of the shown part of the axis about the chosen sample; 0: the whole.
  zoom(factor) {
    const [low, high] = this.zoomed ?? this.whole;
    const middle = this.chart.x.values[Number(this.slider.value)];
    const width = (high - low) * factor;
    if (!factor || width >= this.whole[1] - this.whole[0]) this.zoomed = null;
    else if (width > (this.whole[1] - this.whole[0]) / 500) {
      const from = Math.min(Math.max(middle - width / 2, this.whole[0]), this.whole[1] - width);
      this.zoomed = [from, from + width];
    }
    this.paint();
  }
}

function extent(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

export function round(value) {
  return value === null ? null : Number(value.toPrecision(3));
}
