// The page of a 3D plan: connects slices, 3D view, panel and server.

import { isDark } from "./colours.js";
import { connect, save } from "./menus.js";
import { ask, fetchBlob, load, openSession } from "./net.js";
import { Scene } from "./scene.js";
import { withoutEntry } from "./sentences.js";
import { Slices } from "./slices.js";
import { SpaceReplay } from "./space_replay.js";
import { make, percent } from "./texts.js";
import { Twin } from "./twin.js";
import { describe, SpacePanel } from "./space_panel.js";
import { Newest } from "./wire.js";

const element = (id) => document.getElementById(id);
const scene = new Scene(document.querySelector("#scene canvas"), choose);
const slices = new Slices([...document.querySelectorAll("figure[data-across]")], moved);
const panel = new SpacePanel(element("numbers"), element("ranked"), choose);
let volume = null;
let entry = null;
let chosen = -1; // number of the entry that was chosen last
let offline = false;
let isRecording = false;
let follows = true; // whether the slices follow the tip of the recorded insertion

function say(text) {
  element("message").textContent = text;
  element("message").hidden = !text;
}

let frame = 0;

function paint() {
  if (frame) return;
  frame = requestAnimationFrame(() => {
    frame = 0;
    scene.loadRun(replay.run);
    slices.draw(entry, replay.run);
    scene.draw();
    replay.draw();
  });
}

function moved(at) {
  element("there").textContent = describe(volume, at);
  paint();
}

const entries = new Newest(async (number) => {
  let found;
  try {
    found = await ask(kept(`/api/entry`, ` ${number}`), { number, target: volume.target });
  } catch (refusal) {
    say(refusal.message);
    panel.leaveEstimate();
    if (entry && number === chosen) {
      chosen = entry.number;
      panel.show(entry);
    }
    return;
  }
  if (number !== chosen) return;
  entry = found;
  say("");
  panel.show(entry);
  scene.loadEntry(entry);
  const path = entry.path_mm;
  slices.moveToPoint([...path.subarray(path.length - 3)]);
  document.body.dataset.state = "done";
  if (entry.success_interval) tellEstimate(entry);
  else {
    element("live").textContent = `Entry with success ${percent(entry.table_success)} by the table; executions estimate it now.`;
    estimates.request(number);
  }
});

// The path of a message, which an exported page holds for each entry and target.
function kept(path, part = "", target = volume.target) {
  return offline ? `${path}${part}${target ? ` ${target}` : ""}` : path;
}

// Asks for the estimated success of an entry, which takes about a second.
const estimates = new Newest(async (number) => {
  try {
    const found = await ask("/api/estimate", { number, target: volume.target });
    if (number !== chosen) return;
    Object.assign(entry, found);
    panel.show(entry);
    tellEstimate(found);
  } catch (refusal) {
    if (number === chosen) panel.leaveEstimate();
    say(refusal.message);
  }
});

function tellEstimate({ success, success_interval: [low, high], success_runs: runs }) {
  element("live").textContent = `Success ${percent(success)}, 95 % interval ${percent(low)} to ${percent(high)}, by ${runs.toLocaleString("en")} executions.`;
}

function choose(number) {
  if (isRecording) return;
  if (replay.track) twin.end(); // an insertion from another entry
  document.body.dataset.state = "asked";
  chosen = number;
  estimates.forget();
  panel.expect(volume.success[number]);
  entries.request(number);
}

const replay = new SpaceReplay(element("replay"), panel, (tip) => {
  // Screen readers are not told the place of the tip while it plays.
  element("there").setAttribute("aria-live", replay.playing ? "off" : "polite");
  if (tip && follows) slices.moveToPoint(tip);
  paint();
});
const twin = new Twin(element("twin"), replay, say, () => (entry ? { number: entry.number, target: volume.target } : null));

const SHOWN = [
  ["field", "success by the table, best direction; else tissues", (on) => { slices.show.field = on; }],
  ["obstacle", "obstacles in the 3D view", (on) => { scene.show.obstacle = on; }],
  ["entries", "entry points", (on) => { scene.show.entries = on; }],
  ["runs", "40 executions with noise", (on) => { scene.show.runs = on; }],
  ["follow", "slices follow the tip of an insertion", (on) => { follows = on; }],
];

const SHOWN_OF_RUN = [
  SHOWN[0],
  SHOWN[1],
  ["path", "planned path in the 3D view", (on) => { scene.show.path = on; }],
  SHOWN.at(-1),
];

function addChecks(list) {
  element("shown").append(make("h2", "Show"));
  for (const [name, text, set] of list) {
    const label = element("shown").appendChild(make("label"));
    label.className = "check";
    const box = label.appendChild(make("input"));
    Object.assign(box, { type: "checkbox", checked: true, name });
    label.append(text);
    box.addEventListener("change", () => {
      set(box.checked);
      paint();
    });
  }
}

async function download(path, name) {
  try {
    save(await fetchBlob(path, { target: volume.target }), name);
  } catch (refusal) {
    say(refusal.message);
  }
}

async function copy(language) {
  try {
    const number = entry?.number ?? undefined;
    const text = await (await fetchBlob("/api/code", { language, number })).text();
    if (!text) throw new Error("This plan is from no file: there is no code that reads it.");
    await navigator.clipboard.writeText(text);
    say(`Copied: ${language === "python" ? "Python" : "commands"} that compute what is shown.`);
    setTimeout(() => say(""), 6000);
  } catch (refusal) {
    say(refusal.message);
  }
}

const ACTIONS = {
  slicer: () => download("/api/slicer", "entries.mrk.json"),
  vtp: () => download("/api/vtp", "entries.vtp"),
  nifti: () => download("/api/nifti", "success.nii.gz"),
  table: () => download("/api/table", "table.h5"),
  page: () => download("/api/page", "plan.html"),
  python: () => copy("python"),
  command: () => copy("command"),
  insert: () => twin.begin(),
  halt: () => twin.stop(),
  theme: () => {
    document.documentElement.dataset.theme = isDark() ? "light" : "dark";
    scene.load(volume);
    scene.loadEntry(entry);
    paint();
  },
};

connect(ACTIONS);
new ResizeObserver(paint).observe(element("views"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  scene.load(volume);
  scene.loadEntry(entry);
  paint();
});

// Shows a recorded insertion instead of the ranked entries.
function beginReplay(track) {
  document.body.dataset.mode = "recording";
  isRecording = true;
  element("twin").hidden = true;
  scene.show.entries = false;
  element("scene").querySelector("figcaption").textContent = "drag or arrows: turn; wheel, + and −: zoom";
  element("ranked").hidden = true;
  element("numbers").querySelector("table").remove(); // the numbers of an entry
  replay.begin(track);
  entry = replay.planned();
  scene.loadEntry(entry);
  element("live").textContent = `Recorded insertion, ${track.duration_s.toFixed(1)} s, ended: ${track.ended ?? "not in the recording"}.`;
  document.body.dataset.state = "done";
}

// Says in place of the 3D view why it is missing; all else works without it.
function tellWithoutGraphics() {
  const figure = element("scene");
  figure.querySelector("canvas").remove();
  figure.querySelector("figcaption").textContent = "3D view";
  const text = "This browser has no WebGL 2, which the 3D view needs: allow graphics acceleration in its settings, or " +
    "use another browser. Slices, numbers and entries work without it.";
  figure.appendChild(make("p", text)).className = "missing";
}

// Of several targets, the path and the fields are those of the chosen one.
function addTargets() {
  if (volume.targets.length < 2 || isRecording) return;
  const label = element("targets").appendChild(make("label", "Target "));
  const choice = label.appendChild(make("select"));
  for (const name of volume.targets) choice.append(new Option(name, name));
  choice.value = volume.target;
  choice.addEventListener("change", () => chooseTarget(choice.value));
}

async function chooseTarget(target) {
  document.body.dataset.state = "asked";
  try {
    volume = await ask(kept("/api/volume", "", target), { target });
  } catch (refusal) {
    say(refusal.message);
    return;
  }
  slices.load(volume);
  scene.load(volume);
  panel.load(volume);
  choose(chosen);
}

async function begin() {
  openSession();
  let opened;
  try {
    opened = await load("/api/start");
    offline = Boolean(opened.offline);
    document.body.classList.toggle("offline", offline);
    element("title").textContent = opened.title || opened.source;
    document.title = `${opened.title || opened.source} – needleplan`;
    if (!offline) say("Solving all directions at all grid points, and comparing the best entries by executions; this takes some seconds.");
    volume = await ask(kept("/api/volume", "", opened.targets?.[0] ?? ""), {});
  } catch (refusal) {
    say(refusal.message);
    if (refusal.kind === "away") setTimeout(begin, 1500);
    return;
  }
  say("");
  slices.load(volume);
  scene.load(volume);
  panel.load(volume);
  addChecks(opened.is_recording ? SHOWN_OF_RUN : SHOWN);
  if (!scene.gl) tellWithoutGraphics();
  addTargets();
  if (opened.is_recording) {
    try {
      beginReplay(await ask("/api/recording", {}));
    } catch (refusal) {
      say(refusal.message);
    }
    return;
  }
  if (volume.ranked.length) {
    choose(volume.ranked[0].number);
    return;
  }
  panel.sentences.show(withoutEntry(volume));
  element("live").textContent = withoutEntry(volume).join(" ");
  slices.tell();
  document.body.dataset.state = "done";
}

begin();
