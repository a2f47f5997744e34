// Scenarios and results as files: open, save, download, and "copy as".

import { save } from "./menus.js";
import { ask, fetchBlob } from "./net.js";
import { RUNS } from "./planner.js";

export class Files {
  constructor(store, say) {
    this.store = store;
    this.say = say;
  }

  // Runs an action of a menu; a refusal becomes a message.
  async run(action) {
    try {
      await action();
    } catch (refusal) {
      this.say(refusal.message);
    }
  }

  request(more = {}) {
    const { scenario, start, edge } = this.store.document;
    return { scenario, start, edge, runs: RUNS, ...more };
  }

  openFile(file) {
    return this.run(async () => this.open({ text: await file.text(), name: file.name }));
  }

  openShipped(shipped) {
    return this.run(() => this.open({ shipped }));
  }

  async open(request) {
    const { scenario } = await ask("/api/open", request);
    this.store.change(null, "document", (edited) => {
      edited.scenario = scenario;
      edited.start = null;
    });
    this.store.selected = null;
    this.say("Opened. Undo returns to the scenario before.");
  }

  save() {
    return this.run(async () => {
      save(await fetchBlob("/api/toml", this.request()), `${this.name()}.toml`);
      this.say("Saved with standard comments; comments of your own file are not kept.");
    });
  }

  downloadTable() {
    return this.run(async () => save(await fetchBlob("/api/table", this.request()), `${this.name()}.h5`));
  }

  downloadFigure(format) {
    return this.run(async () => save(await fetchBlob("/api/figure", this.request({ format })), `${this.name()}.${format}`));
  }

  downloadPage() {
    return this.run(async () => save(await fetchBlob("/api/page", this.request()), `${this.name()}.html`));
  }

  copy(language) {
    return this.run(async () => {
      const text = await (await fetchBlob("/api/code", this.request({ language, name: this.name() }))).text();
      await navigator.clipboard.writeText(text);
      this.say(`Copied: ${language === "python" ? "Python" : "commands"} that compute what is shown.`);
    });
  }

  // Name of files: the title in letters, digits and underscores.
  name() {
    const words = (this.store.document.scenario.title ?? "").toLowerCase().match(/[a-z0-9]+/g);
    return words ? words.join("_") : "scenario";
  }
}
