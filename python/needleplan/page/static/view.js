// The page: connects state, server, canvas, handles and panel.

import { ask, load, Newest, openSession } from "./net.js";
import { draw } from "./draw.js";
import { Handles } from "./handles.js";
import { Panel } from "./panel.js";
import { Plane } from "./plane.js";
import { Store } from "./store.js";

const RUNS = 2000; // executions with tip noise
const REST_MS = 200; // time without a change after which the full plan and the executions are asked for

const element = (id) => document.getElementById(id);
const store = new Store();
const plane = new Plane(document.querySelector("#plane canvas"));
const handles = new Handles(element("handles"), plane, store);
const panel = new Panel(element("panel"));

// A request: the document as it is now, and when the user changed it.
function described(more = {}) {
  const { scenario, start, edge } = store.document;
  return { scenario, start, edge, heading_deg: store.shown.heading_deg, ...more };
}

const planning = new Newest(async (draft) => {
  const { document, changed } = store;
  const plan = await answer("/api/plan", described({ draft }));
  if (!plan) return;
  store.plan = plan;
  store.plan.of = document;
  store.refusal = null;
  if (store.executions?.plan !== plan.plan || !sameStart(store.executions.start, plan.start)) store.executions = null;
  store.tell("plan");
  paintedAfter(changed);
});

const pathing = new Newest(async () => {
  const { plan, changed, document } = store;
  if (!plan) return;
  const path = await answer("/api/path", { ...described({ plan: plan.plan }), scenario: undefined });
  if (!path || store.plan?.plan !== path.plan) return;
  Object.assign(store.plan, path, { of: document });
  store.executions = null;
  store.tell("path");
  paintedAfter(changed);
});

const executing = new Newest(async () => {
  const { plan } = store;
  if (!plan || plan.draft) return;
  const { start, edge } = store.document;
  const found = await answer("/api/executions", { plan: plan.plan, start, edge, runs: RUNS });
  if (!found || store.plan !== plan || !sameStart(found.start, plan.start)) return;
  store.executions = found;
  store.tell("executions");
});

function sameStart(a, b) {
  return ["x_mm", "y_mm", "heading_deg", "bevel"].every((key) => a?.[key] === b?.[key]);
}

// Asks the server. A refusal is shown and gives null.
async function answer(path, request) {
  try {
    const found = await ask(path, request);
    say("");
    return found;
  } catch (refusal) {
    if (refusal.kind === "unknown") planning.request(true);
    else if (refusal.kind !== "superseded") {
      store.refusal = refusal;
      say(refusal.message);
      store.tell("refusal");
    }
    return null;
  }
}

function say(text) {
  const place = element("message");
  place.hidden = !text;
  if (place.textContent !== text) place.textContent = text;
}

// Notes the time from a change by the user to the next frame that shows its plan, for benches and tests.
function paintedAfter(changed) {
  if (!changed) return;
  requestAnimationFrame(() => {
    const channel = new MessageChannel(); // its message comes after the frame is painted
    channel.port1.onmessage = () => performance.measure("change to path", { start: changed, end: performance.now() });
    channel.port2.postMessage(null);
  });
}

let frame = 0;

function paint() {
  if (frame) return;
  frame = requestAnimationFrame(() => {
    frame = 0;
    draw(plane, store);
    handles.place();
    panel.show(store);
    element("undo").disabled = !store.past.length;
    element("redo").disabled = !store.future.length;
    element("best").setAttribute("aria-pressed", String(!store.document.start));
    document.body.dataset.state = store.refusal ? "refused" : store.plan?.of !== store.document ? "changed"
      : store.plan.draft ? "draft" : store.executions ? "done" : "planned";
  });
}

let resting = 0;

function rest() {
  if (handles.dragged) {
    resting = setTimeout(rest, REST_MS);
    return;
  }
  if (store.plan?.of === store.document && !store.plan.draft) executing.request();
  else planning.request(false);
}

store.listen((what) => {
  if (what === "document" || what === "start") store.changed = performance.now();
  if (what === "document") planning.request(true);
  if (what === "start") pathing.request();
  if (["document", "start", "plan", "path", "rest"].includes(what)) {
    clearTimeout(resting);
    resting = setTimeout(rest, REST_MS);
  }
  paint();
});

element("undo").addEventListener("click", () => store.undo());
element("redo").addEventListener("click", () => store.redo());
element("best").addEventListener("click", () => store.change(null, "start", (edited) => { edited.start = null; }));
addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.target.matches("input, textarea")) return;
  const key = event.key.toLowerCase();
  if (key === "z" || key === "y") {
    event.preventDefault();
    if (key === "y" || event.shiftKey) store.redo();
    else store.undo();
  }
});
new ResizeObserver(() => { if (store.document) paint(); }).observe(element("plane"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);

async function begin() {
  openSession();
  try {
    const { scenario, source } = await load("/api/start");
    store.document = { scenario, start: null, edge: "left" };
    element("title").textContent = scenario.title || source;
    document.title = `${scenario.title || source} – needleplan`;
    store.tell("document");
  } catch (refusal) {
    say(refusal.message);
  }
}

begin();
