// Curvature sensors along the needle and positions of the tip in images: over time, and on the plane.

const MARGIN = { left: 52, right: 12, top: 8, bottom: 8 };
const MARKS = 14; // height (px) of the marks of the images below the curves
const DASHES = [[], [6, 3], [2, 3], [8, 3, 2, 3]]; // by sensor, the nearest to the tip first

export function isSensed(track) {
  return Boolean(track.sensed_per_m || track.image_mm);
}

// Texts about the sensors at a time (s).
export function sensedTexts(track, time_s) {
  const parts = [];
  if (track.sensed_per_m) {
    const row = newest(track.sensed_time_s, time_s) * track.sensors_mm.length;
    parts.push(`curvature ${signed(track.sensed_per_m[row])} 1/m at ${track.sensors_mm[0]} mm behind the tip`);
  }
  if (track.image_mm && track.image_time_s[0] <= time_s) {
    const seen = Number.isFinite(track.image_mm[newest(track.image_time_s, time_s) * track.image_mm.shape[1]]);
    parts.push(seen ? "tip in the image" : "tip not in the image");
  }
  return parts;
}

// Draws the curvature of each sensor over time, and below it a mark for each image; returns texts, colours and styles.
export function drawSensed(canvas, track, time_s, colours) {
  const density = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  [canvas.width, canvas.height] = [Math.round(width * density), Math.round(height * density)];
  const context = canvas.getContext("2d");
  context.scale(density, density);
  const x = (time) => MARGIN.left + (time / track.duration_s) * (width - MARGIN.left - MARGIN.right);
  const bottom = height - MARGIN.bottom - (track.image_mm ? MARKS : 0);
  const parts = track.sensed_per_m ? drawCurvatures(context, track, { x, bottom }, colours) : [];
  if (track.image_mm) parts.push(...drawImages(context, track, { x, top: bottom, bottom: height - MARGIN.bottom }, colours));
  context.setLineDash([]);
  context.strokeStyle = colours.edge;
  context.lineWidth = 1;
  context.strokeRect(MARGIN.left, MARGIN.top, width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom);
  context.strokeStyle = colours.ink;
  context.lineWidth = 1.5;
  stroke(context, [[x(time_s), MARGIN.top], [x(time_s), height - MARGIN.bottom]]);
  return parts;
}

function drawCurvatures(context, track, { x, bottom }, colours) {
  const { sensed_per_m: values, sensed_time_s: times, sensors_mm: sensors } = track;
  const known = values.filter(Number.isFinite);
  const [low, high] = [known.reduce((a, b) => Math.min(a, b), 0), known.reduce((a, b) => Math.max(a, b), 1)];
  const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - MARGIN.top);
  context.strokeStyle = colours.grid;
  context.lineWidth = 1;
  stroke(context, [[x(0), y(0)], [x(track.duration_s), y(0)]]);
  context.strokeStyle = colours.after;
  context.lineWidth = 1.25;
  sensors.forEach((_, sensor) => {
    context.setLineDash(DASHES[sensor % DASHES.length]);
    context.globalAlpha = 1 - 0.6 * (sensor / Math.max(sensors.length - 1, 1));
    const points = [];
    times.forEach((time, row) => {
      const value = values[row * sensors.length + sensor];
      if (Number.isFinite(value)) points.push([x(time), y(value)]);
    });
    stroke(context, points);
  });
  context.globalAlpha = 1;
  context.setLineDash([]);
  context.fillStyle = colours.faint;
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "right";
  context.textBaseline = "middle";
  context.fillText(signed(high), MARGIN.left - 6, MARGIN.top + 6);
  context.fillText(signed(low), MARGIN.left - 6, bottom - 6);
  const styles = ["solid", "dashed", "dotted", "dashed"];
  const named = sensors.map((mm, sensor) => [`${mm} mm`, colours.after, styles[sensor % styles.length]]);
  const what = track.shape_mm.shape[2] === 3 ? "curvature in 1/m" : "curvature to the left in 1/m";
  named[0][0] = `${what}, by the place behind the tip: ${named[0][0]}`;
  return [...named, ["shape of the needle by all readings, in the view", colours.after, "dashed"]];
}

function drawImages(context, track, { x, top, bottom }, colours) {
  const across = track.image_mm.shape[1];
  track.image_time_s.forEach((time, row) => {
    const seen = Number.isFinite(track.image_mm[row * across]);
    context.strokeStyle = seen ? colours.turn : colours.failed;
    context.lineWidth = 1.5;
    stroke(context, seen ? [[x(time), top + 3], [x(time), bottom]] : [[x(time), bottom - 4], [x(time), bottom]]);
  });
  return [["tip in the image (long mark; circle in the view)", colours.turn, "solid"], ["missed (short mark)", colours.failed, "solid"]];
}

// Draws the shape of the needle by its sensors at a time on a plane, and the positions in images up to this time.
export function drawNeedle(context, plane, { track, time_s }, colours) {
  if (track.image_mm) {
    const last = newest(track.image_time_s, time_s);
    context.strokeStyle = colours.tissue;
    context.lineWidth = 1.25;
    for (let row = 0; row <= last && track.image_time_s[row] <= time_s; row++) {
      const [across, down] = [track.image_mm[2 * row], track.image_mm[2 * row + 1]];
      if (!Number.isFinite(across)) continue;
      context.beginPath();
      context.arc(...plane.at([across, down]), 2.5, 0, 2 * Math.PI);
      context.stroke();
    }
  }
  if (track.shape_mm && track.sensed_time_s[0] <= time_s) {
    const points = shapeAt(track, time_s);
    const line = [];
    for (let place = 0; place < points.length; place += 2) line.push(plane.at([points[place], points[place + 1]]));
    for (const [colour, width, dash] of [[colours.halo, 4, []], [colours.after, 2.25, [7, 3]]]) {
      context.setLineDash(dash);
      context.strokeStyle = colour;
      context.lineWidth = width;
      stroke(context, line);
    }
    context.setLineDash([]);
  }
}

// Points (mm) of the needle by its sensors at a time, from the entry to the first sensor.
export function shapeAt(track, time_s) {
  const size = track.shape_mm.shape[1] * track.shape_mm.shape[2];
  const row = newest(track.sensed_time_s, time_s);
  const points = track.shape_mm.subarray(row * size, (row + 1) * size);
  const end = points.findIndex(Number.isNaN);
  return end < 0 ? points : points.subarray(0, end);
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

function signed(value) {
  return Number(value.toPrecision(3)).toString().replace("-", "−");
}

function stroke(context, points) {
  context.beginPath();
  for (const point of points) context.lineTo(...point);
  context.stroke();
}
