// Keeps the plan up to date: asks the server after every change, drafts first, and the full plan when the user pauses.

import { ask, load } from "./net.js";
import { Newest } from "./wire.js";

const REST_MS = 200; // time without a change after which the full plan and the executions are asked for
const RETRY_MS = 1500; // time between two attempts to reach a server that is away
export const RUNS = 2000; // executions with tip noise

export class Planner {
  // `isDragging` tells whether the user holds a handle, so that the full plan waits.
  constructor(store, isDragging) {
    this.store = store;
    this.isDragging = isDragging;
    this.resting = 0;
    this.away = 0;
    this.planning = new Newest((draft) => this.plan(draft));
    this.pathing = new Newest(() => this.path());
    this.executing = new Newest(() => this.execute());
    this.fielding = new Newest(() => this.field());
    store.listen((what) => this.heed(what));
    addEventListener("storage", () => { if (this.away) this.retry(); });
  }

  heed(what) {
    if (what === "document" || what === "start") this.store.changed = performance.now();
    if (what === "document") this.planning.request(true);
    if (what === "start") this.pathing.request();
    if (what === "heading") this.fielding.request();
    if (["document", "start", "plan", "path", "rest"].includes(what)) this.restart();
  }

  restart() {
    clearTimeout(this.resting);
    this.resting = setTimeout(() => this.rest(), REST_MS);
  }

  rest() {
    const { store } = this;
    if (this.isDragging()) this.restart();
    else if (store.plan?.of !== store.document || store.plan.draft) this.planning.request(false);
    else if (!store.executions) this.executing.request();
  }

  // The document as it is now, as a request.
  request(more) {
    const { scenario, start, edge } = this.store.document;
    return { scenario, start, edge, heading_deg: this.store.shown.heading_deg, ...more };
  }

  async plan(draft) {
    const { store } = this;
    const { document, changed } = store;
    const heading = store.shown.heading_deg;
    const plan = await this.answer("/api/plan", this.request({ draft }));
    if (!plan) return;
    const before = store.plan;
    store.plan = Object.assign(plan, { of: document });
    if (before?.plan !== plan.plan || !sameStart(before.start, plan.start)) store.executions = null;
    store.tell("plan");
    if (store.shown.heading_deg !== heading) this.fielding.request();
    paintedAfter(changed);
  }

  async path() {
    const { store } = this;
    const { plan, changed, document } = store;
    if (!plan) return this.planning.request(true);
    const { start, edge } = document;
    const path = await this.answer("/api/path", { plan: plan.plan, start, edge });
    if (!path || store.plan !== plan) return;
    Object.assign(plan, path);
    // A draft, or a plan of another scenario, stays one.
    if (plan.of.scenario === document.scenario || same(plan.of.scenario, document.scenario)) plan.of = document;
    store.executions = null;
    store.tell("path");
    paintedAfter(changed);
  }

  async field() {
    const { plan, shown } = this.store;
    if (!plan) return;
    const field = await this.answer("/api/field", { plan: plan.plan, heading_deg: shown.heading_deg });
    if (!field || this.store.plan?.plan !== field.plan) return;
    Object.assign(this.store.plan, field);
    this.store.tell("field");
  }

  async execute() {
    const { store } = this;
    const { plan, document: { start, edge } } = store;
    if (!plan || plan.draft) return;
    const found = await this.answer("/api/executions", { plan: plan.plan, start, edge, runs: RUNS });
    if (!found || store.plan !== plan || !sameStart(found.start, plan.start)) return;
    store.executions = found;
    store.tell("executions");
  }

  // Asks the server. A refusal becomes part of the state and gives null.
  async answer(path, request) {
    try {
      const found = await ask(path, request);
      this.refuse(null);
      return found;
    } catch (refusal) {
      if (refusal.kind === "unknown") this.planning.request(true); // the server has dropped the table
      else if (refusal.kind !== "superseded") this.refuse(refusal);
      return null;
    }
  }

  refuse(refusal) {
    if (refusal === this.store.refusal) return;
    this.store.refusal = refusal;
    this.store.tell("refusal");
    if (refusal?.kind === "away" || refusal?.kind === "token") this.waitForServer();
  }

  waitForServer() {
    clearTimeout(this.away);
    this.away = setTimeout(() => this.retry(), RETRY_MS);
  }

  async retry() {
    try {
      await load("/api/start");
      clearTimeout(this.away);
      this.away = 0;
      this.planning.request(true);
    } catch (refusal) {
      this.refuse(refusal);
      this.waitForServer();
    }
  }
}

function same(a, b) {
  return JSON.stringify(a) === JSON.stringify(b);
}

export function sameStart(a, b) {
  return ["x_mm", "y_mm", "heading_deg", "bevel"].every((key) => a?.[key] === b?.[key]);
}

let measured = 0; // time of the newest change whose path has been painted

// Notes the time from a change by the user to the frame that first shows its path, for benches and tests.
function paintedAfter(changed) {
  if (changed <= measured) return;
  measured = changed;
  requestAnimationFrame(() => {
    const channel = new MessageChannel(); // its message comes after the frame is painted
    channel.port1.onmessage = () => performance.measure("change to path", { start: changed, end: performance.now() });
    channel.port2.postMessage(null);
  });
}
