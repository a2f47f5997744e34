// The page: connects state, server, canvas, handles and panel.

import { Animation } from "./animation.js";
import { Compare } from "./compare.js";
import { Controls } from "./controls.js";
import { draw } from "./draw.js";
import { Files } from "./files.js";
import { Handles } from "./handles.js";
import { Keep } from "./keep.js";
import { connect } from "./menus.js";
import { ask, load, openSession } from "./net.js";
import { Panel } from "./panel.js";
import { Plane } from "./plane.js";
import { Planner } from "./planner.js";
import { Replay } from "./replay.js";
import { called, newObstacle } from "./shapes.js";
import { Store } from "./store.js";
import { percent } from "./texts.js";
import { Twin } from "./twin.js";
import { Values } from "./values.js";

const element = (id) => document.getElementById(id);
const store = new Store();
const plane = new Plane(document.querySelector("#plane canvas"));
const handles = new Handles(element("handles"), plane, store);
const compare = new Compare(element("pinned"), element("compare"), store);
const panel = new Panel(element("panel"));
const replay = new Replay(element("replay"), store);
const twin = new Twin(element("twin"), replay, say, () => {
  const { plan, document } = store;
  if (!plan || plan.draft || plan.of !== document) return null;
  return { plan: plan.plan, start: document.start, edge: document.edge };
});
const controls = new Controls(element("controls"), store);
new Animation(controls.play, store);
const files = new Files(store, say);
new Planner(store, () => handles.dragged !== null);
new Values(element("plane"), element("values"), plane, store);
let keep = null;

// Shows a message for some seconds; a refusal stays until the plan is possible again.
let silence = 0;

function say(text, stays = false) {
  clearTimeout(silence);
  element("message").textContent = text;
  element("message").hidden = !text;
  if (text && !stays) silence = setTimeout(() => say(store.refusal?.message ?? "", true), 6000);
}

let frame = 0;

function paint() {
  if (frame || !store.document) return;
  frame = requestAnimationFrame(() => {
    frame = 0;
    draw(plane, store);
    compare.draw();
    replay.draw();
    handles.place();
    panel.show(store);
    controls.show(store);
    element("undo").disabled = !store.past.length;
    element("redo").disabled = !store.future.length;
    element("delete").disabled = store.selected === null;
    element("best").setAttribute("aria-pressed", String(!store.document.start));
    document.body.dataset.state = state();
  });
}

function state() {
  const { refusal, plan, executions } = store;
  if (refusal) return "refused";
  if (plan?.of !== store.document) return "changed";
  if (plan.draft) return "draft";
  return executions ? "done" : "planned";
}

store.listen((what) => {
  if (what === "refusal") say(store.refusal?.message ?? "", true);
  if (what === "document") {
    if (store.selected >= (store.document.scenario.obstacle ?? []).length) store.selected = null;
    showTitle();
  }
  if (what === "document" || what === "start") {
    keep?.save(store.document);
    if (store.replay?.isTwin) twin.end();
  }
  // The text beside the slider has the deviation from the planned path.
  if ((what === "plan" || what === "path") && store.replay) replay.show(store.replay.time_s);
  if (what === "executions") announce();
  // Only a painted plan is done; that it has changed holds at once.
  const now = state();
  if (now !== "done") document.body.dataset.state = now;
  paint();
});

// Tells readers of the screen what the plan has become; the plane itself is an image to them.
function announce() {
  const { plan, executions } = store;
  const path = plan.reached ? `The path reaches the target with ${plan.turns} turns` : `The path ends: ${plan.outcome}`;
  element("live").textContent =
    `${path}. Predicted success ${percent(plan.predicted_success)}, realised ${percent(executions.success)}.`;
}

function showTitle() {
  const { title } = store.document.scenario;
  element("title").textContent = title || store.source;
  document.title = `${title || store.source} – needleplan`;
}

function add(kind) {
  store.change(null, "document", ({ scenario }) => {
    scenario.obstacle = [...(scenario.obstacle ?? []), newObstacle(kind, scenario.workspace)];
  });
  store.selected = store.document.scenario.obstacle.length - 1;
  handles.place();
  handles.buttons.get(`body ${store.selected}`)?.focus();
  say(`Added ${called({}, store.selected)}: drag it, or move it with the arrows.`);
}

const ACTIONS = {
  undo: () => store.undo(),
  redo: () => store.redo(),
  best: () => store.change(null, "start", (edited) => { edited.start = null; }),
  delete: () => handles.remove(`body ${store.selected}`),
  "add polygon": () => add("polygon"),
  "add disc": () => add("disc"),
  "add capsule": () => add("capsule"),
  insert: () => twin.begin(),
  halt: () => twin.stop(),
  open: () => element("file").click(),
  save: () => files.save(),
  table: () => files.downloadTable(),
  svg: () => files.downloadFigure("svg"),
  png: () => files.downloadFigure("png"),
  page: () => files.downloadPage(),
  python: () => files.copy("python"),
  command: () => files.copy("command"),
  theme: () => {
    const root = document.documentElement;
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    paint();
  },
};

connect(ACTIONS);
element("file").addEventListener("change", ({ target }) => {
  if (target.files[0]) files.openFile(target.files[0]);
  target.value = "";
});
element("shipped").addEventListener("change", ({ target }) => {
  if (target.value) files.openShipped(target.value);
  target.value = "";
});
addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || document.body.classList.contains("offline")) return;
  const key = event.key.toLowerCase();
  if (key !== "z" && key !== "y") return;
  event.preventDefault();
  if (key === "y" || event.shiftKey) store.redo();
  else store.undo();
});
new ResizeObserver(paint).observe(element("plane"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);

async function begin() {
  openSession();
  let opened;
  let recorded;
  try {
    opened = await load("/api/start");
    if (opened.is_recording) recorded = await ask("/api/recording", {});
  } catch (refusal) {
    say(refusal.message, true);
    if (refusal.kind === "away") setTimeout(begin, 1500);
    return;
  }
  say("");
  store.source = opened.source;
  for (const name of opened.shipped) element("shipped").append(new Option(name.replaceAll("_", " "), name));
  store.document = { scenario: opened.scenario, start: opened.start, edge: "left" };
  document.body.classList.toggle("offline", Boolean(opened.offline));
  if (recorded) replay.begin(recorded); // before the first plan: a page whose plan is done shows all of it
  if (!opened.offline) keep = new Keep(opened.digest);
  const kept = keep?.load();
  if (kept && JSON.stringify(kept) !== JSON.stringify(store.document)) {
    store.change(null, "document", (edited) => Object.assign(edited, kept));
    say("Your edits of this scenario are back. Undo returns to the file.");
  } else {
    store.tell("document");
  }
}

begin();
