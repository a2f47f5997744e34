// The state of the page, in one place: the document that a user edits, its history, and the answers of the server.

const MOST_STEPS = 200;

export class Store {
  constructor() {
    this.document = null; // { scenario, start, edge }: what is saved, undone and planned
    this.shown = { heading_deg: null, executions: true, field: true, steps: Infinity };
    this.selected = null; // number of the obstacle whose edges can be split
    this.changed = 0; // time of the newest change by the user (ms)
    this.plan = null; // newest answer on a plan, with its path
    this.executions = null; // newest answer on executions
    this.pinned = null; // document, plan and executions to compare with
    this.replay = null; // a recorded insertion and the time up to which it is shown
    this.source = ""; // name of the file that was opened
    this.refusal = null; // why the document has no plan
    this.past = [];
    this.future = [];
    this.merging = null;
    this.listeners = [];
  }

  listen(listener) {
    this.listeners.push(listener);
  }

  // `what` is one of "document", "start", "heading", "shown", "rest" (by the user), or "plan", "path", "field",
  // "executions", "refusal" (by the server).
  tell(what) {
    for (const listener of this.listeners) listener(what);
  }

  // Changes the document. Changes with the same `gesture` (a drag, a slider) are one step of the history.
  change(gesture, what, edit) {
    if (gesture === null || gesture !== this.merging) {
      this.past.push(this.document);
      if (this.past.length > MOST_STEPS) this.past.shift();
    }
    this.merging = gesture;
    this.future = [];
    this.document = structuredClone(this.document);
    edit(this.document);
    this.tell(what);
  }

  endGesture() {
    this.merging = null;
    this.tell("rest");
  }

  undo() {
    this.step(this.past, this.future);
  }

  redo() {
    this.step(this.future, this.past);
  }

  step(from, to) {
    if (!from.length) return;
    to.push(this.document);
    this.document = from.pop();
    this.merging = null;
    this.tell("document");
  }
}
