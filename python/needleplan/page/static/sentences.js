// The first lines of each panel: verdict, nearest risk and next step, in sentences with one number each.

import { make, percent } from "./texts.js";

// Shows sentences; the first one is the verdict. The element is changed only if they are others.
export class Sentences {
  constructor(element) {
    this.element = element.appendChild(make("div"));
    this.element.className = "sentences";
    this.element.dataset.name = "sentences";
  }

  show(sentences) {
    const told = sentences.filter(Boolean);
    const texts = [...this.element.children].map((line) => line.textContent);
    if (told.length === texts.length && told.every((text, place) => text === texts[place])) return;
    this.element.replaceChildren(...told.map((text) => make("p", text)));
    this.element.firstChild?.classList.add("verdict");
  }
}

const mm = (length) => `${length.toFixed(1)} mm`;

// Smallest gain of success for which another entry is recommended; less is within the rounding of the numbers shown.
const WORTH = 0.001;

export function ofPlan({ plan, executions, document, refusal, replay }) {
  if (replay) return ofInsertion(replay, "tip");
  if (refusal) return ["This scenario cannot be planned.", `Next: change what the message names, or undo.`];
  if (!plan) return ["The plan is being computed."];
  const realised = executions && !plan.draft;
  const share = percent(realised ? executions.success : plan.predicted_success);
  const verdict = realised
    ? `The needle reaches the target in ${share} of the executions with tip noise.`
    : `The table predicts that the needle reaches the target with ${share}.`;
  const way = plan.reached ? riskOf(plan.risk, "The planned path") : `Without noise, the path ends: ${plan.outcome}.`;
  return [verdict, way, nextOfPlan(plan, document, executions)];
}

function nextOfPlan(plan, document, executions) {
  if (plan.draft || !executions) return "";
  if (document.start && plan.best_success > plan.predicted_success + WORTH) {
    return `Next: take the best entry, which reaches the target with ${percent(plan.best_success)}.`;
  }
  if (!plan.reached) return "Next: move target or obstacles, since no better entry is known on this edge.";
  if (executions.warnings.length) return "Next: change the scenario as the warning below says.";
  return `Next: insert it, in the lab twin or with needleplan insert; expect ${counted(plan.turns, "turn")}.`;
}

// `risk`: name and distance of the nearest obstacle; null without one, undefined in a page of an older version.
function riskOf(risk, subject) {
  if (risk === undefined) return "";
  if (!risk) return `${subject} has no obstacle near it.`;
  if (risk.distance_mm === 0) return `${subject} meets ${risk.name}.`;
  return `${subject} passes ${risk.name} at ${mm(risk.distance_mm)}.`;
}

const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

// What an insertion has come to at the shown time.
export function ofInsertion({ track, time_s: time }) {
  const end = track.events.findLast((event) => event.name === "end" || event.name === "fault");
  const isOver = end && time >= track.duration_s - 1e-3;
  const off = track.error_mm === null || track.error_mm === undefined ? "" : `, ${mm(track.error_mm)} from its centre`;
  let verdict = "The needle is on its way.";
  if (isOver) verdict = end.cause === "target" ? `The needle is in the target${off}.` : `The insertion ended: ${end.cause}.`;
  const passed = track.risk_mm?.filter((_, place) => track.tip_time_s[place] <= time) ?? [];
  const least = passed.reduce((smallest, value) => Math.min(smallest, value), Infinity);
  const risk = passed.length ? `The tip came within ${mm(least)} of an obstacle.` : "";
  const next = !isOver || track.running ? "" : end.cause === "target"
    ? "Next: compare force and deviation below with the plan."
    : "Next: step through the decisions below, and diagnose the recording.";
  return [verdict, least >= FAR_MM ? "No obstacle was near the tip." : risk, next];
}

// Distance (mm) beyond which distances in 3D are not computed.
const FAR_MM = 30;

export function ofEntry(entry, volume) {
  const { success, success_interval: interval, risk, turns } = entry;
  const target = volume.target ? `target ${volume.target}` : "target";
  const verdict = interval
    ? `The needle reaches the ${target} in ${percent(success)} of the executions with tip noise.`
    : `The table predicts that the needle reaches the ${target} with ${percent(entry.table_success)}.`;
  return [verdict, riskOf(risk, "The planned path"), severalOf(entry, volume), nextOfEntry(entry, volume, turns)];
}

// What is said instead of an entry if none is ranked.
export function withoutEntry({ impossible }) {
  const verdict = impossible
    ? "Impossible: no path of this needle leads from the entry region to the target."
    : "No entry reaches the target in 0.1 % of executions; that no path exists is not proved.";
  return [verdict, "Next: change the entry region, the cone or the curvature radius in the anatomy file."];
}

function severalOf({ expected_number: expected, order }, { targets }) {
  if (expected === undefined) return "";
  return `From this entry, ${expected.toFixed(2)} of the ${targets.length} targets are reached on average, ${order[0].name} first.`;
}

function nextOfEntry(entry, { ranked: [first], targets }, turns) {
  if (first && first.number !== entry.number) {
    const worth = targets.length > 1
      ? `reaches ${first.score.toFixed(2)} targets with an error of the entry`
      : `has ${percent(first.expected_success)} with an error of the entry`;
    return `Next: compare it with entry 1 of the list, which ${worth}.`;
  }
  return `Next: plan and insert it, or try the lab twin; expect ${counted(turns, "turn")}.`;
}

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

export function ofDiagnosis({ verdict, given, advice }) {
  const stages = given?.stages ?? [];
  const gap = stages.length ? stages[0].rms / given.noise_rms : null;
  const closed = stages.slice(1).reduce((sum, { share }) => sum + share, 0);
  const size = gap === null ? "" : stages[0].share === null
    ? `The given model is off by ${gap.toFixed(1)} times the noise, which is no more than chance.`
    : `The given model is off by ${gap.toFixed(1)} times the noise.`;
  const cause = stages[0]?.share === null || !stages.length ? "" : `The causes below close ${(100 * closed).toFixed(0)} % of this gap.`;
  return [VERDICTS[verdict] ?? verdict, size, cause, advice.length ? `Next: ${advice[0][0].toLowerCase()}${advice[0].slice(1)}` : ""];
}
