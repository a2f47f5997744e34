// Plays the executions that are drawn: all needles advance together, step by step.

const DURATION_MS = 4000; // from the entry to the end of the longest execution

export class Animation {
  constructor(button, store) {
    Object.assign(this, { button, store, frame: 0 });
    button.addEventListener("click", () => (this.frame ? this.end() : this.begin()));
    store.listen((what) => {
      if (this.frame && (what === "document" || what === "start" || what === "executions")) this.end();
    });
  }

  begin() {
    const { executions } = this.store;
    if (!executions) return;
    // Steps of the longest execution; the others end earlier.
    let longest = 0;
    executions.ends.forEach((end, run) => { longest = Math.max(longest, end - (run ? executions.ends[run - 1] : 0) - 1); });
    this.button.textContent = "Show all of the executions";
    performance.clearMarks("frame of executions");
    const began = performance.now();
    const step = (now) => {
      const share = Math.max(now - began, 0) / DURATION_MS;
      if (share >= 1) return this.end();
      performance.mark("frame of executions");
      this.store.shown.steps = share * longest;
      this.store.tell("shown");
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  end() {
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    this.button.textContent = "Play the executions";
    this.store.shown.steps = Infinity;
    this.store.tell("shown");
  }
}
