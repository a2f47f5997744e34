// Three slices across the axes of the lattice, through one point that a click, a drag or a slider moves.

import { palette } from "./colours.js";
import { bodyColour, successColour } from "./scene.js";

const NAMES = "xyz";
// Lengths (mm) of scale bars.
const BARS = [1, 2, 5, 10, 20, 50, 100];
// Codes of the lattice.
const [TARGET, OBSTACLE, OUTSIDE] = [1, 2, 3];

export class Slices {
  constructor(figures, moved) {
    this.moved = moved;
    this.show = { field: true };
    this.parts = figures.map((figure) => {
      const across = Number(figure.dataset.across);
      const part = {
        across,
        axes: [0, 1, 2].filter((axis) => axis !== across),
        canvas: figure.querySelector("canvas"),
        caption: figure.querySelector("figcaption"),
        slider: figure.querySelector("input"),
      };
      part.slider.addEventListener("input", () => this.move(across, Number(part.slider.value)));
      let dragged = false;
      const follow = (event) => {
        if (dragged) this.moveTo(part, event);
      };
      part.canvas.addEventListener("pointerdown", (event) => {
        dragged = true;
        part.canvas.setPointerCapture(event.pointerId);
        follow(event);
      });
      part.canvas.addEventListener("pointermove", follow);
      for (const end of ["pointerup", "pointercancel"]) part.canvas.addEventListener(end, () => { dragged = false; });
      return part;
    });
  }

  load(volume) {
    this.volume = volume;
    this.at = volume.shape.map((count) => Math.floor(count / 2));
    for (const { across, slider } of this.parts) {
      Object.assign(slider, { min: 0, max: volume.shape[across] - 1, step: 1, value: this.at[across] });
    }
  }

  // Moves the point to a position in mm.
  moveToPoint(point) {
    const { shape, spacing_mm: spacing } = this.volume;
    this.at = point.map((mm, axis) => Math.max(0, Math.min(shape[axis] - 1, Math.round(mm / spacing))));
    this.tell();
  }

  move(axis, index) {
    this.at[axis] = index;
    this.tell();
  }

  moveTo({ axes, canvas, place }, event) {
    if (!place) return;
    const box = canvas.getBoundingClientRect();
    const { shape } = this.volume;
    const spots = [(event.clientX - box.left - place.left) / place.scale, (place.bottom - (event.clientY - box.top)) / place.scale];
    axes.forEach((axis, which) => { this.at[axis] = Math.max(0, Math.min(shape[axis] - 1, Math.floor(spots[which]))); });
    this.tell();
  }

  tell() {
    for (const { across, slider } of this.parts) slider.value = this.at[across];
    this.moved(this.at);
  }

  // `run`: a recorded insertion, whose executed path is drawn over that of the entry.
  draw(entry, run = null) {
    if (this.volume) for (const part of this.parts) this.drawPart(part, entry, run);
  }

  drawPart(part, entry, run) {
    const { across, axes, canvas, caption, slider } = part;
    const { shape, spacing_mm: spacing } = this.volume;
    const mm = this.at[across] * spacing;
    caption.textContent = `lattice ${NAMES[across]} = ${mm.toFixed(0)} mm; ${NAMES[axes[0]]} to the right, ${NAMES[axes[1]]} up`;
    slider.setAttribute("aria-valuetext", `${NAMES[across]} ${mm.toFixed(0)} mm`);
    const ratio = devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width || !height) return;
    Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    const [n, m] = axes.map((axis) => shape[axis]);
    const scale = Math.min(width / n, height / m);
    const place = { scale, left: (width - n * scale) / 2, bottom: (height + m * scale) / 2 };
    part.place = place;
    const image = new OffscreenCanvas(n, m);
    image.getContext("2d").putImageData(this.image(across, axes), 0, 0);
    context.imageSmoothingEnabled = false;
    context.drawImage(image, place.left, place.bottom - m * scale, n * scale, m * scale);
    const spot = (point) => [place.left + (point[axes[0]] / spacing + 0.5) * scale, place.bottom - (point[axes[1]] / spacing + 0.5) * scale];
    const colours = palette();
    if (entry) this.drawPath(context, entry.path_mm, across, mm, spot, colours, colours.path);
    if (run) {
      this.drawPath(context, run.executed_mm, across, mm, spot, colours, colours.executed);
      this.drawTurns(context, run, across, mm, spot, colours);
    }
    this.drawCross(context, spot(this.at.map((index) => index * spacing)), place, n, m);
    const bar = BARS.findLast((each) => each <= 0.3 * n * spacing) ?? BARS[0];
    const letters = axes.map((axis) => this.volume.letters[axis]);
    drawScale(context, place, bar, (bar / spacing) * scale, colours);
    drawLetters(context, place, n * scale, m * scale, letters, colours);
    const edges = ["left", "right", "bottom", "top"].map((edge, number) => [edge, letters.flat()[number]]);
    const named = edges.filter(([, letter]) => letter).map((each) => each.join(" "));
    canvas.setAttribute("aria-label", [`Slice across ${NAMES[across]}`, ...named, `scale bar ${bar} mm`].join(", "));
  }

  // The path projected on the slice; see `strength`.
  drawPath(context, path, across, mm, spot, colours, colour) {
    const count = path.length / 3;
    const point = (place) => path.subarray(3 * place, 3 * place + 3);
    const strength = (place) => this.strength((path[3 * place + across] + path[3 * place + 3 + across]) / 2, mm);
    context.lineCap = "round";
    context.lineJoin = "round";
    for (const [width, style] of [[5, colours.halo], [2, colour]]) {
      context.lineWidth = width;
      context.strokeStyle = style;
      // Parts of equal strength are one stroke each: short faint strokes would add up where they overlap.
      for (let place = 0; place + 1 < count; ) {
        const alpha = strength(place);
        context.globalAlpha = alpha;
        context.beginPath();
        context.moveTo(...spot(point(place)));
        do context.lineTo(...spot(point(++place)));
        while (place + 1 < count && strength(place) === alpha);
        context.stroke();
      }
    }
    context.globalAlpha = 1;
  }

  // Opacity on a slice: what is farther than two slices from it is faint, because it may lie beside what it covers.
  strength(mm, slice) {
    return Math.abs(mm - slice) <= 2 * this.volume.spacing_mm ? 1 : 0.3;
  }

  // Rotations as circles, and the tip as a disc, projected on the slice.
  drawTurns(context, { executed_mm: executed, turns_mm: turns }, across, mm, spot, colours) {
    const disc = (point, radius, fill) => {
      context.globalAlpha = this.strength(point[across], mm);
      context.beginPath();
      context.arc(...spot(point), radius, 0, 2 * Math.PI);
      context.fillStyle = fill;
      context.fill();
    };
    for (const point of turns) {
      disc(point, 4, colours.turn);
      disc(point, 2, colours.surface);
    }
    if (executed.length) disc(executed.subarray(executed.length - 3), 4.5, colours.executed);
    context.globalAlpha = 1;
  }

  drawCross(context, [x, y], { left, bottom, scale }, n, m) {
    context.strokeStyle = palette().faint;
    context.lineWidth = 1;
    context.setLineDash([3, 3]);
    context.beginPath();
    context.moveTo(x, bottom);
    context.lineTo(x, bottom - m * scale);
    context.moveTo(left, y);
    context.lineTo(left + n * scale, y);
    context.stroke();
    context.setLineDash([]);
  }

  image(across, axes) {
    const { shape, codes, field, label_numbers: numbers, labels } = this.volume;
    const strides = [shape[1] * shape[2], shape[2], 1];
    const [n, m] = axes.map((axis) => shape[axis]);
    const image = new ImageData(n, m);
    const first = this.at[across] * strides[across];
    const colours = palette();
    const table = this.colours(labels, colours);
    for (let j = 0; j < m; j++) {
      for (let i = 0; i < n; i++) {
        const state = first + i * strides[axes[0]] + j * strides[axes[1]];
        const colour = this.colourOf(codes[state], field[state], numbers[state], table);
        image.data.set(colour, 4 * ((m - 1 - j) * n + i));
      }
    }
    return image;
  }

  // Colours of labels and of steps of success, as bytes. Obstacles are as in the 3D view; what is no obstacle is
  // pale, also where it lies in the margin of one.
  colours(labels, colours) {
    const { bodies } = this.volume;
    const pale = (part, index) => Math.round(0.25 * part + 0.75 * hex(colours.surface)[index]);
    return {
      bodies: labels.map((name) => {
        const number = bodies.findIndex((body) => body.kind === "obstacle" && body.name === name);
        return number < 0 ? null : [...hex(bodyColour(name, number)), 255];
      }),
      tissues: labels.map((name, number) => [...hex(bodyColour(name, number)).map(pale), 255]),
      margin: [...hex(colours.faint), 255],
      field: Array.from({ length: 256 }, (_, step) => [...successColour(step / 255).map((part) => Math.round(255 * part)), 255]),
      target: [...hex(colours.target), 255],
      obstacle: [...hex(colours.obstacle), 255],
      outside: [...hex(colours.surface), 255],
      free: [...hex(colours.surface).map((part) => (part > 128 ? part - 20 : part + 20)), 255],
    };
  }

  colourOf(code, success, label, table) {
    if (code === OUTSIDE) return table.outside;
    if (code === TARGET) return table.target;
    if (code === OBSTACLE) return (label === 255 ? table.obstacle : table.bodies[label]) ?? table.margin;
    if (this.show.field) return table.field[success];
    return table.tissues[label] ?? table.free;
  }
}

// Writes a text with a halo, which is readable on all colours.
function write(context, text, x, y, colours) {
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeStyle = colours.halo;
  context.strokeText(text, x, y);
  context.fillStyle = colours.ink;
  context.fillText(text, x, y);
}

// A bar with its length in mm, at the lower left.
function drawScale(context, { left, bottom }, mm, width, colours) {
  const [x, y] = [left + 8, bottom - 8];
  for (const [thick, style] of [[5, colours.halo], [2, colours.ink]]) {
    context.lineWidth = thick;
    context.strokeStyle = style;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + width, y);
    context.stroke();
  }
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "left";
  context.textBaseline = "bottom";
  write(context, `${mm} mm`, x, y - 3, colours);
}

// The anatomical directions at the edges: left and right high up, where the needle seldom is.
function drawLetters(context, { left, bottom }, width, height, [[west, east], [south, north]], colours) {
  context.font = "bold 13px system-ui, sans-serif";
  context.textBaseline = "middle";
  for (const [text, x, y, align] of [
    [west, left + 5, bottom - 0.85 * height, "left"], [east, left + width - 5, bottom - 0.85 * height, "right"],
    [south, left + width / 2, bottom - 11, "center"], [north, left + width / 2, bottom - height + 11, "center"],
  ]) {
    context.textAlign = align;
    write(context, text, x, y, colours);
  }
}

function hex(text) {
  return [1, 3, 5].map((place) => parseInt(text.slice(place, place + 2), 16));
}
