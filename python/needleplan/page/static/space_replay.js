// A recorded insertion in space: executed path, tip and rotations over time, and how it ended.

import { make, percent } from "./panel.js";
import { newest, Replay } from "./replay.js";

export class SpaceReplay {
  // `moved` is called with the position (mm) of the tip when another time is shown.
  constructor(element, moved) {
    this.moved = moved;
    this.store = { replay: null, plan: null, document: null, tell: () => this.tell() };
    this.replay = new Replay(element, this.store);
    this.run = null;
  }

  begin(track) {
    this.track = track;
    this.turns = track.decisions.filter(({ action }) => action === "rotate");
    this.replay.begin(track);
  }

  // What is shown up to the time of the slider: points of the executed path, and of the rotations, in mm.
  tell() {
    const { track, store } = this;
    const { time_s: time } = store.replay;
    const count = track.tip_time_s.length && track.tip_time_s[0] <= time ? newest(track.tip_time_s, time) + 1 : 0;
    const executed = track.tip.subarray(0, 3 * count);
    const turns = this.turns.filter((each) => each.time_s <= time).map((each) => [each.x_mm, each.y_mm, each.z_mm]);
    this.run = { executed_mm: executed, turns_mm: turns };
    this.moved(count ? [...executed.subarray(3 * count - 3)] : null);
  }

  draw() {
    this.replay.draw();
  }

  get playing() {
    return this.replay.playing > 0;
  }

  // The planned path, as an entry without executions.
  planned() {
    const { planned_mm: path } = this.track;
    return { path_mm: path, runs_mm: new Float32Array(0), ends: new Uint32Array(0), reached: new Uint8Array(0) };
  }

  // Writes how the insertion ended into the panel.
  describe(element) {
    const { track } = this;
    const table = make("table");
    table.append(make("caption", "Insertion"));
    const first = track.decisions[0];
    const forces = track.force_n ? Math.max(...track.force_n.map(Math.abs)) : null;
    const away = track.deviation_mm ? Math.max(...track.deviation_mm) : null;
    const rows = {
      ended: track.ended ?? "not in the recording",
      "error": track.error_mm === null ? "–" : `${track.error_mm.toFixed(2)} mm from the centre of the target (radius ${track.target_radius_mm.toFixed(1)} mm)`,
      "predicted at first": first ? percent(first.success) : "–",
      "largest deviation": away === null ? "–" : `${away.toFixed(2)} mm`,
      "largest force": forces === null ? "–" : `${forces.toFixed(2)} N`,
      decisions: String(track.decisions.length),
      rotations: String(track.turns),
      "new plans": String(track.replans),
      duration: `${track.duration_s.toFixed(1)} s`,
    };
    for (const [name, text] of Object.entries(rows)) {
      const row = table.appendChild(make("tr"));
      row.appendChild(make("th", name)).scope = "row";
      row.appendChild(make("td", text)).dataset.name = name;
    }
    element.prepend(table);
  }
}
