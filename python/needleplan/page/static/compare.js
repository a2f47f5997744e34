// Two plans side by side: the pinned one stays as it is, the other goes on.

import { draw } from "./draw.js";
import { Plane } from "./plane.js";

export class Compare {
  constructor(section, button, store) {
    this.section = section;
    this.button = button;
    this.store = store;
    this.plane = new Plane(section.querySelector("canvas"));
    button.addEventListener("click", () => this.toggle());
    store.listen((what) => {
      if (what === "plan" || what === "executions") this.complete();
    });
  }

  // Takes the final plan and its executions if the plan was pinned before they were there.
  complete() {
    const { pinned, document, plan, executions } = this.store;
    if (pinned && pinned.document === document && !pinned.executions && plan.of === document) {
      this.store.pinned = { document, plan: { ...plan }, executions };
    }
  }

  toggle() {
    const { store } = this;
    store.pinned = store.pinned ? null : { document: store.document, plan: { ...store.plan }, executions: store.executions };
    this.section.hidden = !store.pinned;
    this.button.setAttribute("aria-pressed", String(Boolean(store.pinned)));
    store.tell("shown");
  }

  draw() {
    const { pinned, shown } = this.store;
    if (pinned) draw(this.plane, { ...pinned, shown });
  }
}
