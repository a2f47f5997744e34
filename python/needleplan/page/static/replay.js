// Replays a recorded insertion: a slider of time, the axial force over time, and the decisions.

import { palette } from "./colours.js";

const MARGIN = { left: 52, right: 20, top: 8, bottom: 8 };

export class Replay {
  constructor(element, store) {
    this.element = element;
    this.store = store;
    this.slider = element.querySelector("input");
    this.output = element.querySelector("output");
    this.canvas = element.querySelector("canvas");
    this.button = element.querySelector("button");
    this.playing = 0; // time (ms) of the newest frame, 0 while it stands
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value)));
    this.button.addEventListener("click", () => this.play(!this.playing));
  }

  begin(track) {
    this.element.hidden = false;
    this.slider.max = track.duration_s;
    this.store.replay = { track, time_s: track.duration_s };
    this.show(track.duration_s);
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
    if (decision) parts.push(`${decision.action}, success ${(100 * decision.success).toFixed(1)} %`);
    if (event) parts.push([event.name, event.cause].filter(Boolean).join(": "));
    this.output.textContent = parts.join(" · ");
    this.slider.setAttribute("aria-valuetext", parts.join(", "));
    this.store.tell("shown");
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

  // Draws the force over time, with a line at the shown time.
  draw() {
    const { replay } = this.store;
    if (!replay?.track.force_n) return;
    const { canvas } = this;
    const density = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [Math.round(width * density), Math.round(height * density)];
    const context = canvas.getContext("2d");
    const colours = palette();
    context.scale(density, density);
    const { force_time_s: times, force_n: forces, duration_s } = replay.track;
    const [low, high] = [Math.min(0, ...forces), Math.max(0.1, ...forces)];
    const x = (time) => MARGIN.left + (time / duration_s) * (width - MARGIN.left - MARGIN.right);
    const y = (force) => height - MARGIN.bottom - ((force - low) / (high - low)) * (height - MARGIN.top - MARGIN.bottom);
    context.beginPath();
    times.forEach((time, number) => context.lineTo(x(time), y(forces[number])));
    context.strokeStyle = colours.executed;
    context.lineWidth = 1.25;
    context.stroke();
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
    context.fillText(low.toPrecision(1), MARGIN.left - 6, height - MARGIN.bottom - 4);
  }
}

// Number of the newest sample at a time; at least 0.
export function newest(times, time) {
  let [low, high] = [0, times.length];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle;
  }
  return low;
}

function at(times, values, time) {
  return values[newest(times, time)];
}
