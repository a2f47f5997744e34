// A 3D insertion, recorded or in the lab twin: executed path, tip and rotations over time, and how it ended.

import { Replay } from "./replay.js";
import { newest, shapeAt } from "./sensed.js";
import { ofInsertion } from "./sentences.js";
import { make, percent } from "./texts.js";

const NOTHING = { executed_mm: new Float32Array(0), turns_mm: [], shape_mm: new Float32Array(0), seen_mm: [] };

export class SpaceReplay {
  // `panel` shows sentences and numbers. `moved` is called with the position (mm) of the tip, or null, when another time is shown.
  constructor(element, panel, moved) {
    Object.assign(this, { panel, moved, track: null, run: NOTHING });
    this.store = { replay: null, plan: null, document: null, successBy: " by the table", tell: () => this.tell() };
    this.replay = new Replay(element, this.store);
    this.table = make("table");
    this.table.className = "insertion";
    this.table.hidden = true;
  }

  begin(track, isTwin = false) {
    this.load(track);
    this.replay.begin(track, isTwin);
  }

  // Takes the newer state of a running insertion.
  extend(track) {
    this.load(track);
    this.replay.extend(track);
  }

  end() {
    this.track = null;
    this.table.hidden = true;
    this.replay.end();
  }

  load(track) {
    this.track = track;
    this.turns = track.decisions.filter(({ action }) => action === "rotate");
    this.describe();
  }

  // What is shown up to the time of the slider: points of the executed path, of the rotations, of the needle by its sensors
  // and of the tip in images, in mm.
  tell() {
    const { track, store } = this;
    if (!track || !store.replay) {
      this.run = NOTHING;
      this.moved(null);
      return;
    }
    const { time_s: time } = store.replay;
    const count = track.tip_time_s.length && track.tip_time_s[0] <= time ? newest(track.tip_time_s, time) + 1 : 0;
    const executed = track.tip.subarray(0, 3 * count);
    const turns = this.turns.filter((each) => each.time_s <= time).map((each) => [each.x_mm, each.y_mm, each.z_mm]);
    const shape = track.shape_mm && track.sensed_time_s[0] <= time ? shapeAt(track, time) : NOTHING.shape_mm;
    this.run = { executed_mm: executed, turns_mm: turns, shape_mm: shape, seen_mm: seenUntil(track, time) };
    this.panel.sentences.show(ofInsertion(store.replay));
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

  // Writes into the panel how the insertion ended, or how it is.
  describe() {
    const { track, table } = this;
    table.replaceChildren(make("caption", "Insertion"));
    const first = track.decisions[0];
    const most = (values) => values.reduce((largest, value) => Math.max(largest, Math.abs(value)), 0);
    const rows = {
      ended: track.ended ?? (track.running ? "not yet" : "not in the recording"),
      error: track.error_mm === null ? "–" : `${track.error_mm.toFixed(2)} mm from the centre of the target`,
      target: `radius of equal volume ${track.target_radius_mm.toFixed(1)} mm`,
      "predicted at first": first ? `${percent(first.success)} by the table` : "–",
      "largest deviation": track.deviation_mm ? `${most(track.deviation_mm).toFixed(2)} mm` : "–",
      "largest force": track.force_n ? `${most(track.force_n).toFixed(2)} N` : "–",
      decisions: String(track.decisions.length),
      turns: String(track.turns),
      "new plans": String(track.replans),
      duration: `${track.duration_s.toFixed(1)} s`,
    };
    for (const [name, text] of Object.entries(rows)) {
      const row = table.appendChild(make("tr"));
      row.appendChild(make("th", name)).scope = "row";
      row.appendChild(make("td", text)).dataset.name = name;
    }
    table.hidden = false;
    if (!table.parentElement) this.panel.sentences.element.after(table);
  }
}

// Positions (mm) of the tip in images up to a time (s), without missed ones.
function seenUntil({ image_time_s: times, image_mm: places }, time) {
  const found = [];
  for (let row = 0; row < (times?.length ?? 0) && times[row] <= time; row++) {
    const place = [...places.subarray(3 * row, 3 * row + 3)];
    if (place.every(Number.isFinite)) found.push(place);
  }
  return found;
}
