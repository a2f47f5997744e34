// Handles of the obstacles: their bodies, corners, ends, radii, and the middles of the edges of the selected one.

export function mm(length) {
  return `${Math.round(length * 100) / 100} mm`;
}

export function rounded(numbers) {
  return numbers.map((number) => Math.round(number * 100) / 100);
}

export function called(obstacle, number) {
  return obstacle.name ? `obstacle ${obstacle.name}` : `obstacle ${number + 1}`;
}

// Pixels from a rim to its handle, so that the handle of a small disc does not cover that of its centre.
const RIM_PIXELS = 20;

// How the handle of a radius lies beside its rim, in the direction (dx, dy), and how it changes the radius.
export function rimHandle([x, y], [dx, dy], radius_mm, scale, set) {
  const gap = RIM_PIXELS / scale;
  return {
    at: [x + dx * (radius_mm + gap), y + dy * (radius_mm + gap)],
    move: (edited, to) => set(edited, Math.max(rounded([Math.hypot(to[0] - x, to[1] - y) - gap])[0], 0.1)),
    nudge: (edited, [across, up], isLarge) =>
      set(edited, Math.max(rounded([radius_mm + (across + up) * (isLarge ? 5 : 0.5)])[0], 0.1)),
  };
}

export function obstacleHandles(obstacle, number, { isSelected, hasCorners, scale }) {
  const name = called(obstacle, number);
  const found = [body(obstacle, number, name)];
  if (!hasCorners) return found;
  for (const key of ["polygon_mm", "ends_mm"]) {
    (obstacle[key] ?? []).forEach((corner, place) => found.push({
      key: `${key} ${number} ${place}`, kind: "vertex", at: corner, obstacle: number,
      name: `Point ${place + 1} of ${name}, x ${mm(corner[0])}, y ${mm(corner[1])}`,
      move: (edited, to) => { edited.scenario.obstacle[number][key][place] = rounded(to); },
      remove: key === "polygon_mm" && obstacle.polygon_mm.length > 3
        ? (edited) => { edited.scenario.obstacle[number].polygon_mm.splice(place, 1); } : removal(number),
    }));
  }
  if (obstacle.radius_mm) found.push(radius(obstacle, number, name, scale));
  if (isSelected && obstacle.polygon_mm) found.push(...middles(obstacle.polygon_mm, number, name));
  return found;
}

function removal(number) {
  return (edited) => { edited.scenario.obstacle.splice(number, 1); };
}

function body(obstacle, number, name) {
  const points = obstacle.polygon_mm ?? obstacle.ends_mm ?? [obstacle.center_mm];
  const middle = points.reduce(([sx, sy], [x, y]) => [sx + x / points.length, sy + y / points.length], [0, 0]);
  return {
    key: `body ${number}`, kind: "body", at: middle, obstacle: number,
    name: `All of ${name}, x ${mm(middle[0])}, y ${mm(middle[1])}`, remove: removal(number),
    move: (edited, [x, y]) => {
      const [dx, dy] = [x - middle[0], y - middle[1]];
      const shifted = ([px, py]) => rounded([px + dx, py + dy]);
      const moved = edited.scenario.obstacle[number];
      for (const key of ["polygon_mm", "ends_mm"]) if (moved[key]) moved[key] = moved[key].map(shifted);
      if (moved.center_mm) moved.center_mm = shifted(moved.center_mm);
      if (moved.holes_mm) moved.holes_mm = moved.holes_mm.map((hole) => hole.map(shifted));
    },
  };
}

// The radius is dragged right of the centre of a disc, beside the first end of a capsule.
function radius(obstacle, number, name, scale) {
  const from = obstacle.center_mm ?? obstacle.ends_mm[0];
  const way = obstacle.center_mm ? [1, 0] : across(obstacle.ends_mm);
  return {
    key: `radius ${number}`, kind: "rim", obstacle: number, name: `Radius of ${name}, ${mm(obstacle.radius_mm)}`,
    remove: removal(number),
    ...rimHandle(from, way, obstacle.radius_mm, scale, (edited, value) => {
      edited.scenario.obstacle[number].radius_mm = value;
    }),
  };
}

function across([[ax, ay], [bx, by]]) {
  const length = Math.hypot(bx - ax, by - ay) || 1;
  return [(ay - by) / length, (bx - ax) / length];
}

function middles(polygon, number, name) {
  return polygon.map(([x, y], place) => {
    const next = polygon[(place + 1) % polygon.length];
    const at = [(x + next[0]) / 2, (y + next[1]) / 2];
    return {
      key: `middle ${number} ${place}`, kind: "middle", at, obstacle: number,
      name: `Add a point to ${name} between points ${place + 1} and ${((place + 1) % polygon.length) + 1}`,
      becomes: `polygon_mm ${number} ${place + 1}`,
      insert: (edited) => { edited.scenario.obstacle[number].polygon_mm.splice(place + 1, 0, rounded(at)); },
    };
  });
}

// A new obstacle in the middle of the workspace, a sixth as large.
export function newObstacle(kind, { width_mm, height_mm }) {
  const [x, y] = [width_mm / 2, height_mm / 2];
  const reach = Math.max(Math.round(Math.min(width_mm, height_mm) / 12), 0.5);
  if (kind === "disc") return { center_mm: [x, y], radius_mm: reach };
  if (kind === "capsule") return { ends_mm: [[x - reach, y], [x + reach, y]], radius_mm: reach / 2 };
  return { polygon_mm: [[x - reach, y - reach], [x + reach, y - reach], [x + reach, y + reach], [x - reach, y + reach]] };
}
