// Insertions in the lab twin: begins one, and follows it while it runs.

import { ask } from "./net.js";

const POLL_MS = 150; // time between two looks at a running insertion

export class Twin {
  // `request` returns what the insertion follows, or null if the plan is not ready yet.
  constructor(element, replay, say, request) {
    Object.assign(this, { element, replay, say, request });
    this.share = element.querySelector('[name="curvature_error"]');
    this.seed = element.querySelector('[name="seed"]');
    this.halt = element.querySelector('[data-action="halt"]');
    this.number = 0; // of the insertion that is followed; 0: none
    const output = element.querySelector("output");
    const tell = () => { output.textContent = `${this.share.value.replace("-", "−")} %`; };
    this.share.addEventListener("input", tell);
    tell();
  }

  async begin() {
    const plan = this.request();
    if (!plan) {
      this.say("The plan is not ready yet: insert when it is solved.");
      return;
    }
    const request = { ...plan, seed: Number(this.seed.value), curvature_error: Number(this.share.value) / 100 };
    await this.follow(() => ask("/api/insert", request));
  }

  async follow(first) {
    const number = ++this.number;
    this.halt.disabled = false;
    try {
      let track = await first();
      this.replay.begin(track, true);
      while (track.running && number === this.number) {
        await new Promise((done) => setTimeout(done, POLL_MS));
        track = await ask("/api/inserted", {});
        if (number === this.number) this.replay.extend(track);
      }
    } catch (refusal) {
      this.say(refusal.message);
    }
    if (number === this.number) this.halt.disabled = true;
  }

  async stop() {
    try {
      await ask("/api/inserted", { stop: true });
    } catch (refusal) {
      this.say(refusal.message);
    }
  }

  // Ends the view of an insertion by a plan that has changed.
  end() {
    if (!this.halt.disabled) this.stop();
    this.number++;
    this.halt.disabled = true;
    this.replay.end();
  }
}
