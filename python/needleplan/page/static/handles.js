// What a user can drag: buttons above the canvas, so that each can be focused and moved with the arrow keys.

import { layerHandle, mm, rimHandle, rounded, shapeHandles } from "./shapes.js";

const HEADING_PIXELS = 52; // distance of the handle of the heading from the entry
const MOST_CORNERS = 150; // with more corners, only those of the selected obstacle have handles
const SNAP_PIXELS = 10; // an entry closer to an edge of the workspace is put on the edge

// Describes the handles of a document: a key, a name, where they are, and how they change the document.
function describe({ document, plan, selected }, plane) {
  const { scenario } = document;
  const start = document.start ?? plan?.start;
  const found = start ? startHandles(document, start, plane) : [];
  const { center_mm: center, radius_mm: radius } = scenario.target;
  found.push({
    key: "target", kind: "target", at: center, name: `Target, x ${mm(center[0])}, y ${mm(center[1])}`,
    move: (edited, to) => { edited.scenario.target.center_mm = rounded(plane.clamp(to)); },
  }, {
    key: "target radius", kind: "rim", name: `Radius of the target, ${mm(radius)}`,
    ...rimHandle(center, [1, 0], radius, plane.scale, (edited, value) => { edited.scenario.target.radius_mm = value; }),
  });
  const [obstacles, tissues, layers] = [scenario.obstacle ?? [], scenario.tissue ?? [], scenario.needle.layer ?? []];
  const corners = (shape) => (shape.polygon_mm?.length ?? 2) + (shape.holes_mm ?? []).flat().length;
  const isCrowded = [...obstacles, ...tissues].reduce((sum, shape) => sum + corners(shape), 0) > MOST_CORNERS;
  obstacles.forEach((each, number) => {
    const isSelected = number === selected;
    const hasCorners = isCrowded ? isSelected && corners(each) <= MOST_CORNERS : true;
    found.push(...shapeHandles(each, number, "obstacle", { isSelected, hasCorners, scale: plane.scale }));
  });
  tissues.forEach((each, number) => {
    found.push(...shapeHandles(each, number, "tissue", { hasCorners: !isCrowded, scale: plane.scale }));
  });
  layers.forEach((_, number) => found.push(layerHandle(layers, number, scenario.workspace)));
  return found;
}

function startHandles(document, start, plane) {
  const at = [start.x_mm, start.y_mm];
  const place = (edited, change) => { edited.start = { ...start, bevel: document.start?.bevel ?? null, ...change }; };
  const angle = plane.turned((start.heading_deg * Math.PI) / 180);
  const turned = (degrees) => ({ heading_deg: Math.round(degrees * 10) / 10 });
  return [{
    key: "entry", kind: "entry", what: "start", at, turn: angle, name: `Entry, x ${mm(at[0])}, y ${mm(at[1])}`,
    move: (edited, to, isDragged) => {
      const [x_mm, y_mm] = rounded(isDragged ? snapped(plane.clamp(to), plane) : plane.clamp(to));
      place(edited, { x_mm, y_mm });
    },
  }, {
    key: "heading", kind: "heading", what: "start",
    at: [
      at[0] + (HEADING_PIXELS / plane.scale) * Math.cos(angle), at[1] + (HEADING_PIXELS / plane.scaleY) * Math.sin(angle),
    ],
    name: `Heading of the entry, ${start.heading_deg.toFixed(1)} degrees`,
    move: (edited, to) => place(edited, turned((Math.atan2(to[1] - at[1], to[0] - at[0]) * 180) / Math.PI)),
    nudge: (edited, [across, up], isLarge) => {
      const degrees = start.heading_deg + (up - across) * (isLarge ? 10 : 1);
      place(edited, turned(degrees - 360 * Math.round(degrees / 360)));
    },
  }];
}

function snapped([x, y], { size, scale, scaleY }) {
  const onEdge = (value, most, near) => (value < near ? 0 : value > most - near ? most : value);
  return [onEdge(x, size.width_mm, SNAP_PIXELS / scale), onEdge(y, size.height_mm, SNAP_PIXELS / scaleY)];
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
    const described = describe(this.store, this.plane);
    this.handles = new Map(described.map((handle) => [handle.key, handle]));
    for (const [key, button] of this.buttons) {
      if (this.handles.has(key)) continue;
      button.remove();
      this.buttons.delete(key);
    }
    let before = null;
    for (const handle of described) {
      const button = this.buttons.get(handle.key) ?? this.make(handle);
      const [across, down] = this.plane.at(handle.at);
      button.style.transform = `translate(${across}px, ${down}px)`;
      if (handle.turn !== undefined) button.style.setProperty("--turn", `${-handle.turn}rad`);
      if (button.getAttribute("aria-label") !== handle.name) button.setAttribute("aria-label", handle.name);
      // The order of the buttons is that of the Tab key.
      if (before ? before.nextSibling !== button : this.element.firstChild !== button) {
        this.element.insertBefore(button, before ? before.nextSibling : this.element.firstChild);
      }
      before = button;
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
    button.addEventListener("click", (event) => { if (event.detail === 0) this.insert(key); });
    button.addEventListener("focus", () => this.select(this.handles.get(key)?.obstacle ?? null));
    this.buttons.set(key, button);
    return button;
  }

  select(obstacle) {
    if (this.store.selected === obstacle) return;
    this.store.selected = obstacle;
    this.store.tell("shown");
  }

  // Inserts the point for which a handle in the middle of an edge stands; returns the key of the new handle.
  insert(key, gesture = null) {
    const { insert, becomes } = this.handles.get(key) ?? {};
    if (!insert) return key;
    this.store.change(gesture, "document", insert);
    this.place();
    this.buttons.get(becomes)?.focus();
    return becomes;
  }

  begin(key, button, event) {
    if (event.button !== 0) return;
    event.preventDefault();
    button.focus({ focusVisible: false });
    const gesture = `drag ${performance.now()}`;
    const held = this.insert(key, gesture);
    this.buttons.get(held).setPointerCapture(event.pointerId);
    const at = this.plane.at(this.handles.get(held).at);
    this.dragged = { key: held, shift: [at[0] - event.clientX, at[1] - event.clientY], gesture };
    this.buttons.get(held).classList.add("dragged");
  }

  drag(event) {
    if (!this.dragged) return;
    const { key, shift, gesture } = this.dragged;
    const handle = this.handles.get(key);
    const to = this.plane.position([event.clientX + shift[0], event.clientY + shift[1]]);
    this.store.change(gesture, handle.what ?? "document", (edited) => handle.move(edited, to, true));
    this.place(); // the next move starts from here, also before the next frame
  }

  end() {
    if (!this.dragged) return;
    this.buttons.get(this.dragged.key)?.classList.remove("dragged");
    this.dragged = null;
    this.store.endGesture();
  }

  press(key, event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const handle = this.handles.get(key);
    if (event.key === "Delete" || event.key === "Backspace") {
      event.preventDefault();
      this.remove(key);
    }
    const way = ARROWS[event.key];
    if (!way || !handle.move) return;
    event.preventDefault();
    const step = event.shiftKey ? 5 : 0.5;
    const to = [handle.at[0] + way[0] * step, handle.at[1] + way[1] * step];
    this.store.change(`keys ${key}`, handle.what ?? "document", (edited) =>
      handle.nudge ? handle.nudge(edited, way, event.shiftKey) : handle.move(edited, to, false));
    this.place();
  }

  // Removes what a handle stands for, and puts the focus on what is next.
  remove(key) {
    const { remove } = this.handles.get(key) ?? {};
    if (!remove) return;
    const place = [...this.handles.keys()].indexOf(key);
    this.store.change(null, "document", remove);
    this.place();
    const left = [...this.handles.keys()];
    this.buttons.get(this.handles.has(key) ? key : left[Math.min(place, left.length - 1)])?.focus();
  }
}
