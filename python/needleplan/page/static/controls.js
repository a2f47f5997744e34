// Sliders of the needle, the costs and the grid, and what is shown.

import { make } from "./texts.js";

// Cost of 1 mm of insertion near an obstacle, if the scenario has none: as dear as four more millimetres.
const CLEARANCE_PER_MM = 4;

// Each slider reads a value of a scenario and writes it. Values of logarithmic sliders are powers of ten.
const SLIDERS = [
  {
    name: "curvature radius", unit: "mm", least: 1, most: 3.3, step: 0.01, isLog: true,
    read: ({ needle }) => needle.curvature_radius_mm,
    write: ({ needle }, value) => { needle.curvature_radius_mm = value; },
  },
  {
    name: "tip noise", unit: "° a step", least: 0, most: 15, step: 0.25,
    read: ({ motion }) => deviation(motion.tip_noise) * noiseStep(motion),
    write: ({ motion }, value) => { motion.tip_noise = noise(value / noiseStep(motion)); },
  },
  {
    name: "rotation cost", unit: "", least: -1, most: 3, step: 0.05, isLog: true,
    read: ({ objective }) => objective.rotation,
    write: ({ objective }, value) => { objective.rotation = value; },
  },
  {
    name: "collision cost", unit: "", least: 1, most: 5, step: 0.05, isLog: true,
    read: ({ objective }) => objective.collision,
    write: ({ objective }, value) => { objective.collision = value; },
  },
  {
    name: "exit cost", unit: "", least: 1, most: 5, step: 0.05, isLog: true,
    read: ({ objective }) => objective.exit,
    write: ({ objective }, value) => { objective.exit = value; },
  },
  {
    // Steps that begin nearer to an obstacle cost more.
    name: "clearance", unit: "mm", least: 0, most: 10, step: 0.5,
    read: ({ objective }) => objective.clearance_mm ?? 0,
    write: ({ objective }, value) => {
      objective.clearance_mm = value || null;
      objective.clearance_per_mm = value ? objective.clearance_per_mm ?? CLEARANCE_PER_MM : null;
    },
  },
  {
    name: "grid spacing", unit: "mm", least: -0.7, most: 0.7, step: 0.02, isLog: true,
    read: ({ grid }) => grid.spacing_mm[0],
    write: ({ grid }, value) => {
      const [dx, dy] = grid.spacing_mm;
      grid.spacing_mm = [value, fine((dy / dx) * value)];
    },
  },
  {
    name: "refinement", unit: "×", least: 1, most: 5, step: 1,
    read: ({ grid }) => grid.refinement ?? 1,
    write: ({ grid }, value) => { grid.refinement = value; grid.success_refinement = 1; },
  },
];

function noiseStep({ headings, tip_noise_step_deg }) {
  return tip_noise_step_deg ?? 360 / headings;
}

// Standard deviation of tip noise, in noise steps.
function deviation(probabilities) {
  return Math.sqrt(probabilities.reduce((sum, share, step) => sum + 2 * share * step * step, 0));
}

// Tip noise with a standard deviation: a normal distribution at whole noise steps, [P(0), P(+-1), ...].
export function noise(sd) {
  if (sd < 0.05) return [1];
  let [low, high] = [0.05, 20]; // of the normal distribution; whole steps make the result narrower
  for (let turn = 0; turn < 40; turn++) {
    const middle = (low + high) / 2;
    if (deviation(discrete(middle)) < sd) low = middle;
    else high = middle;
  }
  return discrete(low);
}

function discrete(sd) {
  const count = Math.min(7, Math.max(1, Math.ceil(2.5 * sd)));
  const weights = Array.from({ length: count + 1 }, (_, step) => Math.exp((-step * step) / (2 * sd * sd)));
  const total = weights.reduce((sum, weight, step) => sum + (step ? 2 : 1) * weight, 0);
  const shares = weights.map((weight) => Math.round((weight / total) * 1e5) / 1e5);
  shares[0] = 1 - 2 * shares.slice(1).reduce((sum, share) => sum + share, 0);
  return shares;
}

export class Controls {
  constructor(element, store) {
    this.store = store;
    this.sliders = [];
    const editing = element.appendChild(make("div"));
    editing.className = "editing";
    editing.append(make("h2", "Needle, costs and grid"));
    for (const slider of SLIDERS) this.addSlider(editing, slider);
    element.append(make("h2", "Show"));
    const heading = element.appendChild(make("div"));
    heading.className = "editing";
    this.addHeading(heading);
    for (const [key, text] of [["field", "success field"], ["executions", "executions with tip noise"]]) {
      this.addSwitch(element, key, text);
    }
    this.play = element.appendChild(make("button", "Play the executions"));
    this.play.className = "wide";
  }

  addSlider(element, slider) {
    const { label, input, output } = makeSlider(slider);
    input.addEventListener("input", () => {
      const value = fine(slider.isLog ? 10 ** Number(input.value) : Number(input.value));
      this.store.change(`slider ${slider.name}`, "document", ({ scenario }) => slider.write(scenario, value));
    });
    input.addEventListener("change", () => this.store.endGesture());
    element.append(label);
    this.sliders.push({ ...slider, input, output });
  }

  // The heading for which the field is shown; without it, the best one at each position.
  addHeading(element) {
    const { label, input, output } = makeSlider({ name: "heading of the field", least: -180, most: 180, step: 6 });
    const isBest = this.addBox(element, "field at the best heading", true);
    const show = () => {
      input.disabled = isBest.checked;
      this.store.shown.heading_deg = isBest.checked ? null : Number(input.value);
      output.textContent = isBest.checked ? "best" : `${input.value}°`;
      this.store.tell("heading");
    };
    [input.value, input.disabled, output.textContent] = [0, true, "best"];
    for (const each of [input, isBest]) each.addEventListener("input", show);
    element.append(label);
  }

  addSwitch(element, key, text) {
    const box = this.addBox(element, text, this.store.shown[key]);
    box.addEventListener("input", () => {
      this.store.shown[key] = box.checked;
      this.store.tell("shown");
    });
  }

  addBox(element, text, isChecked) {
    const label = element.appendChild(make("label"));
    label.className = "check";
    const box = label.appendChild(make("input"));
    [box.type, box.checked] = ["checkbox", isChecked];
    label.append(text);
    return box;
  }

  // Puts the sliders where the scenario is.
  show({ document: { scenario } }) {
    for (const { read, input, output, isLog, unit } of this.sliders) {
      const value = read(scenario);
      const text = `${fine(value)} ${unit}`.trim();
      if (window.document.activeElement !== input || output.textContent !== text) {
        input.value = isLog ? Math.log10(value) : value;
      }
      if (output.textContent !== text) output.textContent = text;
      input.setAttribute("aria-valuetext", text);
    }
  }
}

function fine(number) {
  return Number(number.toPrecision(3));
}

function makeSlider({ name, least, most, step }) {
  const label = make("label");
  label.className = "slider";
  const output = make("output");
  const input = make("input");
  Object.assign(input, { type: "range", min: least, max: most, step });
  input.dataset.slider = name;
  label.append(make("span", name), output, input);
  return { label, input, output };
}
