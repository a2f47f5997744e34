// Curves over one axis on a canvas: panels below each other, ticks, a band, and a line at the chosen place.

const MARGIN = { left: 68, right: 16, top: 8, bottom: 40, between: 14 };
const FONT = "12px system-ui, sans-serif";
const TICK_PX = 90; // least distance of ticks along the axis

export class Chart {
  constructor(canvas) {
    this.canvas = canvas;
    this.frame = { left: MARGIN.left, width: 1 };
  }

  // Draws panels of curves over `x`: { values, label, low, high }. A panel is { label, share, lines, band, zero }, with
  // `share` of the height and lines { values, colour, width, dash }. `place` is the number of the sample that is marked.
  draw({ x, panels, place = null, colours }) {
    const { canvas } = this;
    const density = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width || !height) return;
    [canvas.width, canvas.height] = [Math.round(width * density), Math.round(height * density)];
    const context = canvas.getContext("2d");
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = FONT;
    this.frame = { left: MARGIN.left, width: width - MARGIN.left - MARGIN.right };
    this.x = x;
    const room = height - MARGIN.top - MARGIN.bottom - MARGIN.between * (panels.length - 1);
    const total = panels.reduce((sum, panel) => sum + panel.share, 0);
    let top = MARGIN.top;
    for (const panel of panels) {
      const box = { top, height: (room * panel.share) / total };
      this.drawPanel(context, panel, box, colours, place);
      top += box.height + MARGIN.between;
    }
    this.drawTicks(context, height - MARGIN.bottom, colours);
  }

  across(value) {
    const { low, high } = this.x;
    return this.frame.left + ((value - low) / (high - low || 1)) * this.frame.width;
  }

  // Value of the axis at a pixel of the canvas.
  valueAt(pixel) {
    const { low, high } = this.x;
    return low + ((pixel - this.frame.left) / this.frame.width) * (high - low);
  }

  drawPanel(context, panel, { top, height }, colours, place) {
    const [low, high] = this.range(panel);
    const up = (value) => top + height - ((value - low) / (high - low)) * height;
    const { left, width } = this.frame;
    context.save();
    context.beginPath();
    context.rect(left, top, width, height);
    context.clip();
    if (panel.band) {
      context.fillStyle = colours.band;
      context.fillRect(left, up(panel.band[1]), width, up(panel.band[0]) - up(panel.band[1]));
    }
    const steps = ticks(low, high, Math.max(2, Math.floor(height / 34)));
    context.strokeStyle = colours.grid;
    context.lineWidth = 1;
    for (const tick of steps) line(context, left, up(tick), left + width, up(tick));
    for (const each of panel.lines) this.drawLine(context, each, up);
    if (place !== null) {
      context.strokeStyle = colours.ink;
      const at = this.across(this.x.values[place]);
      line(context, at, top, at, top + height);
      for (const { values, colour } of panel.lines) {
        context.fillStyle = colour;
        context.beginPath();
        context.arc(at, up(values[place]), 3.5, 0, 2 * Math.PI);
        context.fill();
      }
    }
    context.restore();
    context.strokeStyle = colours.edge;
    context.strokeRect(left, top, width, height);
    context.fillStyle = colours.faint;
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const tick of steps) context.fillText(written(tick), left - 6, Math.min(Math.max(up(tick), top + 6), top + height - 6));
    context.save();
    context.translate(11, top + height / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(panel.label, 0, 0);
    context.restore();
  }

  // A line through all samples. Where several lie on one pixel, their smallest and largest value are kept, so that no
  // peak is lost.
  drawLine(context, { values, colour, width = 1.25, dash = [] }, up) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.lineJoin = "round";
    context.beginPath();
    let pixel = NaN;
    let [first, least, most, last] = [0, 0, 0, 0];
    const flush = () => {
      if (Number.isNaN(pixel)) return;
      context.lineTo(pixel, up(first));
      if (least !== most) {
        context.lineTo(pixel, up(least));
        context.lineTo(pixel, up(most));
        context.lineTo(pixel, up(last));
      }
    };
    for (let sample = 0; sample < values.length; sample++) {
      const value = values[sample];
      if (!Number.isFinite(value)) continue;
      const here = Math.round(2 * this.across(this.x.values[sample])) / 2;
      if (here === pixel) {
        [least, most, last] = [Math.min(least, value), Math.max(most, value), value];
      } else {
        flush();
        pixel = here;
        first = least = most = last = value;
      }
    }
    flush();
    context.stroke();
    context.setLineDash([]);
  }

  // Smallest and largest value in the shown range of the axis, with a margin.
  range({ lines, band, zero }) {
    let [low, high] = zero ? [0, 0] : [Infinity, -Infinity];
    const { values: places, low: from, high: to } = this.x;
    for (const { values } of lines) {
      for (let sample = 0; sample < values.length; sample++) {
        const value = values[sample];
        if (places[sample] < from || places[sample] > to || !Number.isFinite(value)) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (band) [low, high] = [Math.min(low, band[0]), Math.max(high, band[1])];
    if (!(low <= high)) [low, high] = [0, 1];
    const more = 0.06 * (high - low) || 0.5;
    return [low - more, high + more];
  }

  drawTicks(context, bottom, colours) {
    const { low, high, label } = this.x;
    const { left, width } = this.frame;
    context.strokeStyle = colours.edge;
    context.fillStyle = colours.faint;
    context.textAlign = "center";
    context.textBaseline = "top";
    for (const tick of ticks(low, high, Math.max(2, Math.floor(width / TICK_PX)))) {
      line(context, this.across(tick), bottom, this.across(tick), bottom + 4);
      context.fillText(written(tick), this.across(tick), bottom + 6);
    }
    context.fillText(label, left + width / 2, bottom + 22);
  }
}

// Round numbers from low to high, about `count` of them.
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  if (!(raw > 0) || !Number.isFinite(raw)) return [];
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * ([1, 2, 5, 10].find((each) => each * power >= raw) ?? 10);
  const found = [];
  for (let number = Math.ceil(low / step - 1e-9); number * step <= high + 1e-9 * step; number++) found.push(number * step);
  return found;
}

// A number with up to four digits and a true minus sign.
export function written(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  const text = size && (size < 1e-3 || size >= 1e5) ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  return text.replaceAll("-", "−");
}

function line(context, fromX, fromY, toX, toY) {
  context.beginPath();
  context.moveTo(fromX, fromY);
  context.lineTo(toX, toY);
  context.stroke();
}
