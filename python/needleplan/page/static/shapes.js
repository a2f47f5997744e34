// Handles of obstacles and tissues: bodies, corners, ends, radii, holes, and the middles of the edges of the selected
// obstacle; and of layers.

export function mm(length) {
  return `${Math.round(length * 100) / 100} mm`;
}

export function rounded(numbers) {
  return numbers.map((number) => Math.round(number * 100) / 100);
}

export function called(shape, number, list = "obstacle") {
  return `${list} ${shape.name || number + 1}`;
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

// Returns the handles of a shape of the list "obstacle" or "tissue" of a scenario.
export function shapeHandles(shape, number, list, { isSelected, hasCorners, scale }) {
  const name = called(shape, number, list);
  const found = [body(shape, number, name, list)];
  if (hasCorners) {
    for (const key of ["polygon_mm", "ends_mm"]) {
      (shape[key] ?? []).forEach((corner, place) => found.push({
        key: `${key} ${number} ${place}`, kind: "vertex", at: corner,
        name: `Point ${place + 1} of ${name}, x ${mm(corner[0])}, y ${mm(corner[1])}`,
        move: (edited, to) => { edited.scenario[list][number][key][place] = rounded(to); },
        remove: key === "polygon_mm" && shape.polygon_mm.length > 3
          ? (edited) => { edited.scenario[list][number].polygon_mm.splice(place, 1); } : removal(number, list),
      }));
    }
    (shape.holes_mm ?? []).forEach((hole, which) => found.push(...holeHandles(hole, which, number, name, list)));
    if (shape.radius_mm) found.push(radius(shape, number, name, scale, list));
    if (isSelected && shape.polygon_mm) found.push(...middles(shape.polygon_mm, number, name));
  }
  if (list === "obstacle") return found.map((handle) => ({ ...handle, obstacle: number }));
  return found.map((handle) => ({ ...handle, key: `${list} ${handle.key}` }));
}

function removal(number, list) {
  return (edited) => { edited.scenario[list].splice(number, 1); };
}

function holeHandles(hole, which, number, name, list) {
  return hole.map((corner, place) => ({
    key: `holes_mm ${number} ${which} ${place}`, kind: "vertex", at: corner,
    name: `Point ${place + 1} of hole ${which + 1} of ${name}, x ${mm(corner[0])}, y ${mm(corner[1])}`,
    move: (edited, to) => { edited.scenario[list][number].holes_mm[which][place] = rounded(to); },
    remove: (edited) => {
      const holes = edited.scenario[list][number].holes_mm;
      if (hole.length > 3) holes[which].splice(place, 1);
      else holes.splice(which, 1);
    },
  }));
}

// The handle of a layer lies at the lower end of its line, and stays between the layers beside it.
export function layerHandle(layers, number, { width_mm, height_mm }) {
  const { from_mm: from } = layers[number];
  const [low, high] = [(layers[number - 1]?.from_mm ?? -0.1) + 0.1, (layers[number + 1]?.from_mm ?? width_mm) - 0.1];
  return {
    key: `layer ${number}`, kind: "layer", at: [from, height_mm / 16], name: `Begin of layer ${number + 1}, x ${mm(from)}`,
    move: (edited, to) => {
      edited.scenario.needle.layer[number].from_mm = rounded([Math.max(low, Math.min(high, to[0]))])[0];
    },
  };
}

function body(obstacle, number, name, list) {
  const points = obstacle.polygon_mm ?? obstacle.ends_mm ?? [obstacle.center_mm];
  const middle = points.reduce(([sx, sy], [x, y]) => [sx + x / points.length, sy + y / points.length], [0, 0]);
  return {
    key: `body ${number}`, kind: "body", at: middle,
    name: `All of ${name}, x ${mm(middle[0])}, y ${mm(middle[1])}`, remove: removal(number, list),
    move: (edited, [x, y]) => {
      const [dx, dy] = [x - middle[0], y - middle[1]];
      const shifted = ([px, py]) => rounded([px + dx, py + dy]);
      const moved = edited.scenario[list][number];
      for (const key of ["polygon_mm", "ends_mm"]) if (moved[key]) moved[key] = moved[key].map(shifted);
      if (moved.center_mm) moved.center_mm = shifted(moved.center_mm);
      if (moved.holes_mm) moved.holes_mm = moved.holes_mm.map((hole) => hole.map(shifted));
    },
  };
}

// The radius is dragged right of the centre of a disc, beside the first end of a capsule.
function radius(obstacle, number, name, scale, list) {
  const from = obstacle.center_mm ?? obstacle.ends_mm[0];
  const way = obstacle.center_mm ? [1, 0] : across(obstacle.ends_mm);
  return {
    key: `radius ${number}`, kind: "rim", name: `Radius of ${name}, ${mm(obstacle.radius_mm)}`,
    remove: removal(number, list),
    ...rimHandle(from, way, obstacle.radius_mm, scale, (edited, value) => {
      edited.scenario[list][number].radius_mm = value;
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
      key: `middle ${number} ${place}`, kind: "middle", at,
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
