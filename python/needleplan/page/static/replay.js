// Replays a recorded insertion: a slider of time, the axial force over time, and the decisions.

import { palette } from "./colours.js";
import { drawSensed, isSensed, newest, sensedTexts } from "./sensed.js";

const MARGIN = { left: 52, right: 12, top: 8, bottom: 8 };

export class Replay {
  constructor(element, store) {
    this.element = element;
    this.store = store;
    this.slider = element.querySelector("input");
    this.output = element.querySelector("output");
    this.canvas = element.querySelector("canvas");
    this.key = element.querySelector(".chart-key");
    this.sensed = element.querySelector(".sensed");
    this.sensedKey = element.querySelector(".sensed + .chart-key");
    this.button = element.querySelector('[data-step="0"]');
    for (const step of [-1, 1]) {
      element.querySelector(`[data-step="${step}"]`).addEventListener("click", () => this.stepTo(step));
    }
    this.playing = 0; // time (ms) of the newest frame, 0 while it stands
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value)));
    this.button.addEventListener("click", () => this.play(!this.playing));
  }

  // `isTwin`: an insertion in the lab twin, which may still run and ends when the plan changes.
  begin(track, isTwin = false) {
    this.element.hidden = false;
    this.slider.max = track.duration_s;
    this.store.replay = { track, time_s: track.duration_s, isTwin };
    this.show(track.duration_s);
  }

  // Takes the newer state of a running insertion, and shows its end if the end was shown.
  extend(track) {
    const { replay } = this.store;
    const follows = replay.time_s >= replay.track.duration_s;
    replay.track = track;
    this.slider.max = track.duration_s;
    this.show(follows && !this.playing ? track.duration_s : replay.time_s);
  }

  end() {
    this.play(false);
    this.element.hidden = true;
    this.store.replay = null;
    this.store.tell("shown");
  }

  // Goes to the next decision (1) or the one before (-1).
  stepTo(direction) {
    this.play(false);
    const { replay } = this.store;
    const times = replay.track.decisions.map((each) => each.time_s);
    const beyond = direction > 0 ? replay.track.duration_s : 0;
    const found = direction > 0 ? times.find((time) => time > replay.time_s + 1e-6) : times.findLast((time) => time < replay.time_s - 1e-6);
    this.show(found ?? beyond);
  }

  show(time_s) {
    const { replay } = this.store;
    replay.time_s = time_s;
    this.slider.value = time_s;
    const { track } = replay;
    const decision = track.decisions.findLast((each) => each.time_s <= time_s);
    const event = track.events.findLast((each) => each.time_s <= time_s);
    const parts = [`${time_s.toFixed(1)} s`];
    if (track.force_n) parts.push(`force ${at(track.force_time_s, track.force_n, time_s).toFixed(2)} N`);
    const deviation = this.deviations(track);
    if (deviation) parts.push(`deviation ${at(track.tip_time_s, deviation, time_s).toFixed(2)} mm`);
    if (track.risk_mm?.length) parts.push(`risk ${distance(at(track.tip_time_s, track.risk_mm, time_s))}`);
    parts.push(...sensedTexts(track, time_s));
    if (decision) parts.push(`${decision.action}, success ${(100 * decision.success).toFixed(1)} %${this.store.successBy ?? ""}`);
    if (event) parts.push([event.name, event.cause].filter(Boolean).join(": "));
    const isEnd = time_s >= track.duration_s - 1e-3;
    if (isEnd && track.error_mm !== undefined && track.error_mm !== null) parts.push(`error ${track.error_mm.toFixed(2)} mm`);
    this.output.textContent = parts.join(" · ");
    this.slider.setAttribute("aria-valuetext", parts.join(", "));
    this.store.tell("shown");
  }

  // Distances (mm) of the tip from the planned path without noise, or null without one. Made once for each track and path.
  deviations(track) {
    if (track.deviation_mm) return track.deviation_mm.length ? track.deviation_mm : null;
    const { plan } = this.store;
    if (!plan?.poses || !track.tip.length) return null;
    const known = this.known;
    if (known?.track === track && known.poses === plan.poses) return known.found;
    const found = new Float32Array(track.tip_time_s.length);
    const line = prolonged(plan.poses, 2 * this.store.document.scenario.target.radius_mm);
    for (let row = 0; row < found.length; row++) found[row] = away([track.tip[3 * row], track.tip[3 * row + 1]], line);
    this.known = { track, poses: plan.poses, found };
    return found;
  }

  // Plays in real time from the shown time, or from the beginning if the end is shown.
  play(isOn) {
    this.button.textContent = isOn ? "Pause" : "Play";
    this.playing = isOn ? performance.now() : 0;
    if (!isOn) return;
    const { replay } = this.store;
    if (replay.time_s >= replay.track.duration_s) replay.time_s = 0;
    requestAnimationFrame((now) => this.step(now));
  }

  step(now) {
    if (!this.playing) return;
    const { replay } = this.store;
    const end = replay.track.duration_s;
    const time_s = Math.min(replay.time_s + Math.max(now - this.playing, 0) / 1000, end);
    this.playing = Math.max(now, 1);
    this.show(time_s);
    if (time_s >= end) this.play(false);
    else requestAnimationFrame((next) => this.step(next));
  }

  // Draws force and deviation over time, each on its own scale, with a line at the shown time.
  draw() {
    const { replay } = this.store;
    if (replay && !this.element.hidden) this.drawSensors(replay);
    if (!replay?.track.force_n || this.element.hidden) return;
    const deviation = this.deviations(replay.track);
    const { canvas } = this;
    const density = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [Math.round(width * density), Math.round(height * density)];
    const context = canvas.getContext("2d");
    const colours = palette();
    context.scale(density, density);
    const { track } = replay;
    const { force_time_s: times, force_n: forces, duration_s } = track;
    const [low, high] = [Math.min(0, ...forces), Math.max(0.1, ...forces)];
    const x = (time) => MARGIN.left + (time / duration_s) * (width - MARGIN.left - MARGIN.right);
    const y = (force) => height - MARGIN.bottom - ((force - low) / (high - low)) * (height - MARGIN.top - MARGIN.bottom);
    context.beginPath();
    times.forEach((time, number) => context.lineTo(x(time), y(forces[number])));
    context.strokeStyle = colours.executed;
    context.lineWidth = 1.25;
    context.stroke();
    const parts = [[`axial force, ${low.toPrecision(1).replace("-", "−")}–${high.toPrecision(2)} N`, colours.executed, "solid"]];
    if (deviation) {
      const tolerance = track.target_radius_mm ?? this.store.document?.scenario.target.radius_mm ?? null;
      const most = Math.max(1, tolerance === null ? 0 : 1.1 * tolerance, ...deviation);
      const up = (mm) => height - MARGIN.bottom - (mm / most) * (height - MARGIN.top - MARGIN.bottom);
      context.beginPath();
      track.tip_time_s.forEach((time, number) => context.lineTo(x(time), up(deviation[number])));
      context.strokeStyle = colours.path;
      context.setLineDash([4, 3]);
      context.stroke();
      if (tolerance !== null) {
        context.strokeStyle = colours.target;
        context.setLineDash([1, 3]);
        context.beginPath();
        context.moveTo(MARGIN.left, up(tolerance));
        context.lineTo(width - MARGIN.right, up(tolerance));
        context.stroke();
        const radius = track.target_radius_mm === undefined ? "radius of the target" : "target: radius of equal volume";
        parts.push([`${radius}, ${Number(tolerance.toPrecision(2))} mm`, colours.target, "dotted"]);
      }
      context.setLineDash([]);
      parts.splice(1, 0, [`deviation, 0–${most.toPrecision(2)} mm`, colours.path, "dashed"]);
    }
    tellKey(this.key, parts);
    context.strokeStyle = colours.edge;
    context.lineWidth = 1;
    context.strokeRect(MARGIN.left, MARGIN.top, width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom);
    context.beginPath();
    context.moveTo(x(replay.time_s), MARGIN.top);
    context.lineTo(x(replay.time_s), height - MARGIN.bottom);
    context.strokeStyle = colours.ink;
    context.lineWidth = 1.5;
    context.stroke();
    context.fillStyle = colours.faint;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "right";
    context.textBaseline = "middle";
    context.fillText(`${high.toPrecision(2)} N`, MARGIN.left - 6, MARGIN.top + 6);
    context.fillText(low.toPrecision(1).replace("-", "−"), MARGIN.left - 6, height - MARGIN.bottom - 4);
  }

  // Draws what the sensors of needle and images measure, if the insertion has them.
  drawSensors({ track, time_s }) {
    this.sensed.hidden = this.sensedKey.hidden = !isSensed(track);
    if (!this.sensed.hidden) tellKey(this.sensedKey, drawSensed(this.sensed, track, time_s, palette()));
  }
}

// Names the lines of a chart below it: texts, colours and styles.
function tellKey(key, parts) {
  const told = JSON.stringify(parts);
  if (key.dataset.told === told) return;
  key.dataset.told = told;
  key.replaceChildren(...parts.map(([text, colour, style]) => {
    const part = document.createElement("span");
    const line = part.appendChild(document.createElement("i"));
    Object.assign(line.style, { borderTopColor: colour, borderTopStyle: style });
    part.append(text);
    return part;
  }));
}

// Points of a path (rows of four numbers that begin with x and y) with a straight end of a length (mm): the planned path
// ends at the rim of the target, and the needle inside of it.
function prolonged(poses, length) {
  const points = [];
  for (let row = 0; row < poses.length; row += 4) points.push([poses[row], poses[row + 1]]);
  if (points.length < 2) return points;
  const [[ax, ay], [bx, by]] = points.slice(-2);
  const size = Math.hypot(bx - ax, by - ay) || 1;
  return [...points, [bx + (length * (bx - ax)) / size, by + (length * (by - ay)) / size]];
}

// Distance of a point from a line through points; 0 before its beginning, where the needle has not entered.
function away([x, y], line) {
  let least = Infinity;
  for (let place = 0; place + 1 < line.length; place++) {
    const [[ax, ay], [bx, by]] = [line[place], line[place + 1]];
    const [dx, dy] = [bx - ax, by - ay];
    const along = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1);
    if (place === 0 && along < 0) return 0;
    const share = Math.max(0, Math.min(1, along));
    least = Math.min(least, Math.hypot(x - ax - share * dx, y - ay - share * dy));
  }
  return least;
}

// Distances from 30 mm on are not computed in 3D.
const distance = (mm) => (mm >= 30 ? "30 mm or more" : `${mm.toFixed(1)} mm`);

function at(times, values, time) {
  return values[newest(times, time)];
}
