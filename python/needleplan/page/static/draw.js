// Draws the scene, the field, the executions and the path on a plane.

import { palette, ramp } from "./colours.js";
import { drawNeedle, newest } from "./sensed.js";

export function draw(plane, { document, plan, executions, shown, replay }) {
  const { scenario } = document;
  const colours = palette();
  const context = plane.fit(scenario.workspace);
  const frame = [...plane.at([0, scenario.workspace.height_mm]), ...size(plane, scenario.workspace)];
  context.lineJoin = context.lineCap = "round";
  context.save();
  context.beginPath();
  context.rect(...frame);
  context.clip();
  context.fillStyle = colours.surface;
  context.fillRect(...frame);
  if (plan && shown.field) drawField(context, plane, plan, colours);
  for (const layer of scenario.needle.layer ?? []) drawLayer(context, plane, layer, scenario.workspace, colours);
  for (const tissue of scenario.tissue ?? []) drawTissue(context, plane, tissue, colours);
  for (const obstacle of scenario.obstacle ?? []) drawObstacle(context, plane, obstacle, colours);
  context.restore();
  drawAxes(context, plane, scenario.workspace, frame, colours);
  drawTarget(context, plane, scenario.target, colours);
  if (executions && shown.executions) drawExecutions(context, plane, executions, shown.steps, colours);
  if (plan) drawPath(context, plane, plan, colours);
  if (replay) {
    drawTrack(context, plane, replay, colours);
    drawNeedle(context, plane, replay, colours);
  }
}

// The path of the tip in a recording up to the shown time, its end, and the decisions to rotate.
function drawTrack(context, plane, { track, time_s }, colours) {
  const last = newest(track.tip_time_s, time_s);
  context.beginPath();
  for (let row = 0; row <= last; row++) context.lineTo(...plane.at([track.tip[3 * row], track.tip[3 * row + 1]]));
  context.strokeStyle = colours.executed;
  context.lineWidth = 2.25;
  context.stroke();
  context.lineWidth = 2;
  for (const { time_s: when, x_mm, y_mm, action } of track.decisions) {
    if (when <= time_s && action.startsWith("rotate")) cross(context, plane.at([x_mm, y_mm]), 3);
  }
  context.beginPath();
  context.arc(...plane.at([track.tip[3 * last], track.tip[3 * last + 1]]), 5, 0, 2 * Math.PI);
  context.fillStyle = colours.executed;
  context.fill();
}

function size(plane, { width_mm, height_mm }) {
  return [width_mm * plane.scale, height_mm * plane.scaleY];
}

// The image of a field is made once for each answer and each theme.
const images = new WeakMap();

function fieldImage(field, colours) {
  const known = images.get(field);
  if (known?.colours === colours) return known.image;
  const [nx, ny] = field.shape;
  const image = new OffscreenCanvas(nx, ny);
  const pixels = new ImageData(nx, ny);
  const words = new Uint32Array(pixels.data.buffer);
  const steps = new Uint32Array(ramp(colours).buffer);
  for (let x = 0, at = 0; x < nx; x++) {
    for (let y = ny - 1; y >= 0; y--, at++) words[y * nx + x] = steps[field[x * ny + (ny - 1 - y)] >> 8];
  }
  image.getContext("2d").putImageData(pixels, 0, 0);
  images.set(field, { image, colours });
  return image;
}

function drawField(context, plane, plan, colours) {
  const [nx, ny] = plan.success.shape;
  const [dx, dy] = plan.spacing_mm;
  const [left, top] = plane.at([-dx / 2, (ny - 0.5) * dy]);
  context.imageSmoothingEnabled = true;
  context.drawImage(fieldImage(plan.success, colours), left, top, nx * dx * plane.scale, ny * dy * plane.scaleY);
}

// Adds the outline of a shape (polygon with holes, disc or capsule), widened by `more_mm` for discs and capsules.
function outline(context, plane, shape, more_mm = 0) {
  const radius = (shape.radius_mm ?? 0) + more_mm;
  plane.trace(context, () => {
    if (shape.center_mm) {
      context.arc(...shape.center_mm, radius, 0, 2 * Math.PI);
    } else if (shape.ends_mm) {
      const [[ax, ay], [bx, by]] = shape.ends_mm;
      const angle = Math.atan2(by - ay, bx - ax);
      context.arc(ax, ay, radius, angle + Math.PI / 2, angle - Math.PI / 2);
      context.arc(bx, by, radius, angle - Math.PI / 2, angle + Math.PI / 2);
      context.closePath();
    } else {
      for (const ring of [shape.polygon_mm, ...(shape.holes_mm ?? [])]) {
        ring.forEach((corner, number) => context[number ? "lineTo" : "moveTo"](...corner));
        context.closePath();
      }
    }
  });
}

function drawObstacle(context, plane, obstacle, colours) {
  if (obstacle.margin_mm) {
    outline(context, plane, obstacle, obstacle.margin_mm);
    context.fillStyle = context.strokeStyle = colours.margin;
    context.lineWidth = obstacle.polygon_mm ? 2 * obstacle.margin_mm * plane.scale : 0.01;
    context.fill("evenodd");
    if (obstacle.polygon_mm) context.stroke();
  }
  outline(context, plane, obstacle);
  context.fillStyle = colours.obstacle;
  context.fill("evenodd");
  context.fillStyle = hatching(context, colours);
  context.fill("evenodd");
  context.strokeStyle = colours.obstacleEdge;
  context.lineWidth = 1.25;
  context.stroke();
}

const patterns = new Map();

// Diagonal lines: obstacles are told from the field by more than their colour.
function hatching(context, colours) {
  if (!patterns.has(colours.hatch)) {
    const tile = new OffscreenCanvas(8, 8);
    const pen = tile.getContext("2d");
    pen.strokeStyle = colours.hatch;
    pen.lineWidth = 1.5;
    for (const shift of [-8, 0, 8]) {
      pen.moveTo(shift, 8);
      pen.lineTo(shift + 8, 0);
    }
    pen.stroke();
    patterns.set(colours.hatch, context.createPattern(tile, "repeat"));
  }
  return patterns.get(colours.hatch);
}

function drawTissue(context, plane, tissue, colours) {
  outline(context, plane, tissue);
  context.strokeStyle = colours.tissue;
  context.lineWidth = 1.5;
  context.setLineDash([6, 4]);
  context.stroke();
  context.setLineDash([]);
  const points = tissue.polygon_mm ?? tissue.ends_mm ?? [tissue.center_mm];
  const [x, y] = points.reduce((best, point) => (point[1] > best[1] ? point : best));
  const text = `${tissue.name ? `${tissue.name}, ` : ""}${radiusText(tissue)}`;
  note(context, plane, [x, y + (tissue.radius_mm ?? 0)], text, colours, -14);
}

function radiusText({ curvature_radius_mm }) {
  return curvature_radius_mm === "inf" ? "straight" : `R ${label(curvature_radius_mm)} mm`;
}

// A small text beside a line, within the workspace; its halo keeps it legible on the field.
function note(context, plane, place, text, colours, below) {
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "left";
  context.textBaseline = "top";
  const right = plane.at([plane.size.width_mm, 0])[0] - context.measureText(text).width - 5;
  const [x, y] = plane.at(place);
  const corner = [Math.max(Math.min(x + 5, right), plane.left + 5), Math.max(y + below, plane.at([0, plane.size.height_mm])[1] + 4)];
  context.strokeStyle = colours.halo;
  context.lineWidth = 3;
  context.strokeText(text, ...corner);
  context.fillStyle = colours.tissue;
  context.fillText(text, ...corner);
}

function drawLayer(context, plane, layer, workspace, colours) {
  context.beginPath();
  context.moveTo(...plane.at([layer.from_mm, 0]));
  context.lineTo(...plane.at([layer.from_mm, workspace.height_mm]));
  context.strokeStyle = colours.tissue;
  context.lineWidth = 1.5;
  context.setLineDash([2, 5]);
  context.stroke();
  context.setLineDash([]);
  note(context, plane, [layer.from_mm, workspace.height_mm], radiusText(layer), colours, 6);
}

function drawTarget(context, plane, target, colours) {
  outline(context, plane, target);
  context.fillStyle = colours.targetFill;
  context.fill();
  context.strokeStyle = colours.target;
  context.lineWidth = 2;
  context.stroke();
}

// Draws the first `steps` steps of each execution; a part of a step is drawn along its chord, with a dot for the tip.
function drawExecutions(context, plane, { points, ends, outcomes }, steps, colours) {
  let begin = 0;
  ends.forEach((end, number) => {
    const last = Math.min(begin + Math.floor(steps), end - 1);
    const spot = (point) => plane.at([points[2 * point], points[2 * point + 1]]);
    context.beginPath();
    for (let point = begin; point <= last; point++) context.lineTo(...spot(point));
    let tip = null;
    if (last + 1 < end) {
      const part = steps % 1;
      tip = plane.at([0, 1].map((axis) => (1 - part) * points[2 * last + axis] + part * points[2 * last + 2 + axis]));
      context.lineTo(...tip);
    }
    const reached = outcomes[number] === 1;
    context.strokeStyle = reached ? colours.reached : colours.failed;
    context.lineWidth = reached ? 1 : 1.5;
    context.setLineDash(reached ? [] : [4, 3]);
    context.stroke();
    context.setLineDash([]);
    if (tip) {
      context.beginPath();
      context.arc(...tip, 2.5, 0, 2 * Math.PI);
      context.fillStyle = colours.path;
      context.fill();
    } else if (!reached) cross(context, plane.at(plane.clamp([points[2 * end - 2], points[2 * end - 1]])), 3.5);
    begin = end;
  });
}

function cross(context, [x, y], reach) {
  context.beginPath();
  for (const way of [-1, 1]) {
    context.moveTo(x - reach, y - way * reach);
    context.lineTo(x + reach, y + way * reach);
  }
  context.stroke();
}

function drawPath(context, plane, { poses, actions, reached }, colours) {
  const points = [];
  for (let row = 0; row < poses.shape[0]; row++) points.push(plane.at([poses[4 * row], poses[4 * row + 1]]));
  context.beginPath();
  for (const point of points) context.lineTo(...point);
  for (const [colour, width] of [[colours.halo, 6], [colours.path, 2.75]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
  }
  drawEntry(context, points[0], plane.turned(poses[2]), colours);
  actions.forEach((action, number) => {
    if (action !== 1) return;
    context.beginPath();
    context.arc(...points[number], 4, 0, 2 * Math.PI);
    context.fillStyle = colours.surface;
    context.fill();
    context.strokeStyle = colours.turn;
    context.lineWidth = 2;
    context.stroke();
  });
  if (!reached) {
    context.strokeStyle = colours.failed;
    context.lineWidth = 3;
    cross(context, plane.at(plane.clamp([poses.at(-4), poses.at(-3)])), 6);
  }
}

// An arrow in the direction of the entry; where the entry can be dragged, its handle covers the arrow.
function drawEntry(context, [x, y], angle, colours) {
  context.save();
  context.translate(x, y);
  context.rotate(-angle);
  context.beginPath();
  for (const [across, down] of [[-9, -9], [9, 0], [-9, 9], [-5, 0]]) context.lineTo(across, down);
  context.closePath();
  context.fillStyle = colours.path;
  context.fill();
  context.restore();
}

function drawAxes(context, plane, workspace, [left, top, width, height], colours) {
  context.strokeStyle = colours.edge;
  context.lineWidth = 1;
  context.strokeRect(left, top, width, height);
  context.fillStyle = colours.faint;
  context.font = "12px system-ui, sans-serif";
  const step = tickStep(80 / plane.scale);
  context.textBaseline = "top";
  context.textAlign = "center";
  for (let x = 0; x <= workspace.width_mm + 1e-9; x += step) {
    const [across, down] = plane.at([x, 0]);
    line(context, [across, down], [across, down + 5]);
    context.fillText(label(x), across, down + 8);
  }
  context.fillText("x in mm, along the insertion", left + width / 2, top + height + 24);
  context.textBaseline = "middle";
  context.textAlign = "right";
  const stepY = tickStep((plane.stretch > 1 ? 40 : 80) / plane.scaleY);
  for (let y = 0; y <= workspace.height_mm + 1e-9; y += stepY) {
    const [across, down] = plane.at([0, y]);
    line(context, [across, down], [across - 5, down]);
    context.fillText(label(y), across - 8, down);
  }
  context.save();
  context.translate(left - 38, top + height / 2);
  context.rotate(-Math.PI / 2);
  context.textAlign = "center";
  context.fillText(plane.stretch > 1 ? `y in mm, ${label(Math.round(plane.stretch * 10) / 10)} times larger` : "y in mm", 0, 0);
  context.restore();
}

function label(number) {
  return String(Math.round(number * 1e6) / 1e6);
}

// Distance of ticks: 1, 2 or 5 times a power of ten, at least `least`.
function tickStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((each) => each * power).find((each) => each >= least);
}

function line(context, from, to) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}
