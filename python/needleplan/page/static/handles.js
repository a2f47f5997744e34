// What a user can drag: buttons above the canvas, so that each can be focused and moved with the arrow keys.

const HEADING_PIXELS = 52; // distance of the handle of the heading from the entry

// Describes the handles of a document: a key, a name, where it is, and how it moves the document.
function describe(document, plane, plan) {
  const found = [];
  const start = document.start ?? plan?.start;
  const { scenario } = document;
  if (start) {
    const at = [start.x_mm, start.y_mm];
    found.push({
      key: "entry", kind: "entry", at, turn: start.heading_deg,
      name: `Entry, x ${mm(at[0])}, y ${mm(at[1])}`,
      move: (edited, to) => {
        const [x_mm, y_mm] = rounded(plane.clamp(to));
        edited.start = { ...start, x_mm, y_mm, bevel: edited.start?.bevel ?? null };
      },
      what: "start",
    });
    const angle = (start.heading_deg * Math.PI) / 180;
    const reach = HEADING_PIXELS / plane.scale;
    found.push({
      key: "heading", kind: "heading", at: [at[0] + reach * Math.cos(angle), at[1] + reach * Math.sin(angle)],
      name: `Heading of the entry, ${start.heading_deg.toFixed(1)} degrees`,
      move: (edited, to) => {
        const heading_deg = Math.round(((Math.atan2(to[1] - at[1], to[0] - at[0]) * 180) / Math.PI) * 10) / 10;
        edited.start = { ...start, heading_deg, bevel: edited.start?.bevel ?? null };
      },
      nudge: (edited, [, up], large) => {
        const heading_deg = start.heading_deg + up * (large ? 10 : 1);
        edited.start = { ...start, heading_deg, bevel: edited.start?.bevel ?? null };
      },
      what: "start",
    });
  }
  const center = scenario.target.center_mm;
  found.push({
    key: "target", kind: "target", at: center, name: `Target, x ${mm(center[0])}, y ${mm(center[1])}`,
    move: (edited, to) => { edited.scenario.target.center_mm = rounded(plane.clamp(to)); },
  });
  (scenario.obstacle ?? []).forEach((obstacle, number) => found.push(...ofObstacle(obstacle, number)));
  return found;
}

function ofObstacle(obstacle, number) {
  const called = obstacle.name ? `obstacle ${obstacle.name}` : `obstacle ${number + 1}`;
  const found = [];
  const points = obstacle.polygon_mm ?? obstacle.ends_mm ?? [obstacle.center_mm];
  const middle = points.reduce(([sx, sy], [x, y]) => [sx + x / points.length, sy + y / points.length], [0, 0]);
  found.push({
    key: `body ${number}`, kind: "body", at: middle, name: `All of ${called}`,
    move: (edited, [x, y]) => {
      const [dx, dy] = [x - middle[0], y - middle[1]];
      const shifted = ([px, py]) => rounded([px + dx, py + dy]);
      const moved = edited.scenario.obstacle[number];
      for (const key of ["polygon_mm", "ends_mm"]) if (moved[key]) moved[key] = moved[key].map(shifted);
      if (moved.center_mm) moved.center_mm = shifted(moved.center_mm);
      if (moved.holes_mm) moved.holes_mm = moved.holes_mm.map((hole) => hole.map(shifted));
    },
  });
  for (const key of ["polygon_mm", "ends_mm"]) {
    (obstacle[key] ?? []).forEach((corner, place) => found.push({
      key: `${key} ${number} ${place}`, kind: "vertex", at: corner,
      name: `Point ${place + 1} of ${called}, x ${mm(corner[0])}, y ${mm(corner[1])}`,
      move: (edited, to) => { edited.scenario.obstacle[number][key][place] = rounded(to); },
    }));
  }
  if (obstacle.center_mm) {
    const [x, y] = obstacle.center_mm;
    found.push({
      key: `radius ${number}`, kind: "vertex", at: [x + obstacle.radius_mm, y],
      name: `Radius of ${called}, ${mm(obstacle.radius_mm)}`,
      move: (edited, to) => {
        edited.scenario.obstacle[number].radius_mm = Math.max(rounded([Math.hypot(to[0] - x, to[1] - y)])[0], 0.1);
      },
    });
  }
  return found;
}

function mm(length) {
  return `${Math.round(length * 100) / 100} mm`;
}

function rounded(numbers) {
  return numbers.map((number) => Math.round(number * 100) / 100);
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

export class Handles {
  constructor(element, plane, store) {
    this.element = element;
    this.plane = plane;
    this.store = store;
    this.buttons = new Map(); // key of a handle -> button
    this.handles = new Map();
    this.dragged = null;
  }

  // Puts the buttons where the handles of the document are, and removes those of handles that are gone.
  place() {
    const described = describe(this.store.document, this.plane, this.store.plan);
    this.handles = new Map(described.map((handle) => [handle.key, handle]));
    for (const [key, button] of this.buttons) {
      if (!this.handles.has(key)) {
        button.remove();
        this.buttons.delete(key);
      }
    }
    for (const handle of described) {
      const button = this.buttons.get(handle.key) ?? this.make(handle);
      const [across, down] = this.plane.at(handle.at);
      button.style.transform = `translate(${across}px, ${down}px)`;
      if (handle.turn !== undefined) button.style.setProperty("--turn", `${-handle.turn}deg`);
      if (button.getAttribute("aria-label") !== handle.name) button.setAttribute("aria-label", handle.name);
    }
  }

  make({ key, kind }) {
    const button = window.document.createElement("button");
    button.className = `handle ${kind}`;
    button.dataset.key = key;
    button.addEventListener("pointerdown", (event) => this.begin(key, button, event));
    button.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) button.addEventListener(end, () => this.end());
    button.addEventListener("keydown", (event) => this.press(key, event));
    this.element.append(button);
    this.buttons.set(key, button);
    return button;
  }

  begin(key, button, event) {
    if (event.button !== 0) return;
    button.setPointerCapture(event.pointerId);
    const at = this.plane.at(this.handles.get(key).at);
    this.dragged = { key, shift: [at[0] - event.clientX, at[1] - event.clientY], gesture: `drag ${performance.now()}` };
    button.classList.add("dragged");
  }

  drag(event) {
    if (!this.dragged) return;
    const { key, shift, gesture } = this.dragged;
    const handle = this.handles.get(key);
    const to = this.plane.position([event.clientX + shift[0], event.clientY + shift[1]]);
    this.store.change(gesture, handle.what ?? "document", (edited) => handle.move(edited, to));
  }

  end() {
    if (!this.dragged) return;
    this.buttons.get(this.dragged.key)?.classList.remove("dragged");
    this.dragged = null;
    this.store.endGesture();
    this.store.tell("rest");
  }

  press(key, event) {
    const way = ARROWS[event.key];
    if (!way || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    const handle = this.handles.get(key);
    const step = event.shiftKey ? 5 : 0.5;
    const to = [handle.at[0] + way[0] * step, handle.at[1] + way[1] * step];
    this.store.change(`keys ${key}`, handle.what ?? "document", (edited) =>
      handle.nudge ? handle.nudge(edited, way, event.shiftKey) : handle.move(edited, to));
  }
}
