// The 3D view: bodies, entry points coloured by success, path and executions, in WebGL.

import { isDark, palette } from "./colours.js";
import { ball, joined, normalsOf, projected, tube, viewMatrix } from "./mesh.js";

const VERTEX = `#version 300 es
uniform mat4 matrix; uniform vec3 eye; uniform float size;
layout(location = 0) in vec3 position; layout(location = 1) in vec3 normal; layout(location = 2) in vec3 tint;
out vec3 shade;
void main() {
  gl_Position = matrix * vec4(position, 1.0);
  gl_PointSize = size;
  float facing = size > 0.0 ? 1.0 : abs(dot(normalize(normal), eye));
  shade = tint * (0.45 + 0.55 * facing);
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
uniform float opacity; in vec3 shade; out vec4 colour;
void main() { colour = vec4(shade * opacity, opacity); }`;

// Radii (mm) of the tubes: a needle of 1.2 mm, and thinner executions that do not hide it.
const PATH_MM = 0.6;
const RUN_MM = 0.2;
// Radii (mm) of the path of a recorded insertion, of its tip, and of its rotations.
const EXECUTED_MM = 0.5;
const SHAPE_MM = 0.8;
const TIP_MM = 1.6;
const TURN_MM = 1.0;
// Distance (pixels) up to which a click takes an entry point.
const CLICK_PX = 14;
const OPACITY = 0.45;

export class Scene {
  constructor(canvas, choose) {
    this.canvas = canvas;
    this.camera = { turn: -0.6, tilt: 0.45, zoom: 1.35 };
    this.show = { obstacle: true, runs: true, entries: true };
    this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    this.layers = [];
    this.listen(choose);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { this.program = null; this.load(this.volume); this.loadEntry(this.entry); });
  }

  // Loads bodies and entry points.
  load(volume) {
    this.volume = volume;
    if (!this.gl || !volume) return;
    this.drop("target", "other target", "obstacle", "entries");
    const { shape, spacing_mm: spacing } = volume;
    this.center = shape.map((count) => ((count - 1) * spacing) / 2);
    this.size = Math.hypot(...shape.map((count) => count * spacing));
    const colours = palette();
    volume.bodies.forEach(({ kind, name }, number) => {
      const [positions, triangles] = [volume[`vertices${number}`], volume[`triangles${number}`]];
      const tint = { target: colours.target, "other target": colours.faint }[kind] ?? bodyColour(name, number);
      this.add(kind, { positions, normals: normalsOf(positions, triangles), triangles }, tint);
    });
    const tints = new Float32Array(volume.success.length * 3);
    volume.success.forEach((share, place) => tints.set(successColour(share), 3 * place));
    this.add("entries", { positions: volume.points_mm, normals: volume.points_mm, triangles: null }, tints);
    this.draw();
  }

  // Loads path and executions of an entry.
  loadEntry(entry) {
    this.entry = entry;
    if (!this.gl || !entry) return;
    this.drop("path", "runs");
    const colours = palette();
    this.add("path", tube(entry.path_mm, PATH_MM), colours.path);
    for (const reached of [0, 1]) {
      const meshes = [];
      entry.ends.forEach((end, run) => {
        const first = run ? entry.ends[run - 1] : 0;
        if (entry.reached[run] === reached) meshes.push(tube(entry.runs_mm.subarray(3 * first, 3 * end), RUN_MM));
      });
      if (meshes.length) this.add("runs", joined(meshes), reached ? "#0072b2" : "#d55e00");
    }
    this.draw();
  }

  // Loads the executed path of a recorded insertion up to its tip, its rotations, the shape of the needle by its sensors and
  // the positions in images; points are in mm.
  loadRun({ executed_mm: executed, turns_mm: turns, shape_mm: shape, seen_mm: seen }) {
    if (!this.gl) return;
    this.drop("executed", "tip", "turns", "shape", "seen");
    const colours = palette();
    if (executed.length) {
      this.add("executed", tube(executed, EXECUTED_MM), colours.executed);
      this.add("tip", ball(executed.subarray(executed.length - 3), TIP_MM), colours.executed);
    }
    if (shape.length > 3) this.add("shape", tube(shape, SHAPE_MM), colours.after);
    if (seen.length) this.add("seen", joined(seen.map((point) => ball(point, EXECUTED_MM))), colours.tissue);
    if (turns.length) this.add("turns", joined(turns.map((point) => ball(point, TURN_MM))), colours.turn);
  }

  // Removes layers of these kinds, with their memory in the graphics card.
  drop(...kinds) {
    for (const { kind, array, buffers } of this.layers) {
      if (!kinds.includes(kind)) continue;
      this.gl.deleteVertexArray(array);
      for (const buffer of buffers) this.gl.deleteBuffer(buffer);
    }
    this.layers = this.layers.filter(({ kind }) => !kinds.includes(kind));
  }

  add(kind, { positions, normals, triangles }, tint) {
    const { gl } = this;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const tints = typeof tint === "string" ? null : tint;
    const buffers = [];
    const bind = (target, data) => {
      buffers.push(gl.createBuffer());
      gl.bindBuffer(target, buffers.at(-1));
      gl.bufferData(target, data, gl.STATIC_DRAW);
    };
    [positions, normals, tints].forEach((data, place) => {
      if (!data) return;
      bind(gl.ARRAY_BUFFER, data);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
    });
    if (triangles) bind(gl.ELEMENT_ARRAY_BUFFER, triangles);
    gl.bindVertexArray(null);
    this.layers.push({ kind, array, buffers, tint: tints ? null : rgb(tint), count: triangles?.length ?? positions.length / 3, points: !triangles });
  }

  draw() {
    const { gl, canvas } = this;
    if (!gl || !this.center) return;
    const scale = devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.program ??= makeProgram(gl);
    const place = (name) => gl.getUniformLocation(this.program, name);
    const { matrix, eye } = this.matrix();
    gl.viewport(0, 0, width, height);
    gl.clearColor(...rgb(palette().surface), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(this.program);
    gl.uniformMatrix4fv(place("matrix"), false, matrix);
    gl.uniform3fv(place("eye"), eye);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    // What is opaque first; what is behind a body stays visible through it.
    for (const layer of [...this.layers].sort((a, b) => (a.kind === "obstacle") - (b.kind === "obstacle"))) {
      if (this.show[layer.kind] === false) continue;
      const solid = layer.kind !== "obstacle";
      gl[solid ? "disable" : "enable"](gl.BLEND);
      gl.depthMask(solid);
      gl.uniform1f(place("opacity"), solid ? 1 : OPACITY);
      gl.uniform1f(place("size"), layer.points ? this.pointSize() * scale : 0);
      gl.bindVertexArray(layer.array);
      if (layer.tint) gl.vertexAttrib3fv(2, layer.tint);
      if (layer.points) gl.drawArrays(gl.POINTS, 0, layer.count);
      else gl.drawElements(gl.TRIANGLES, layer.count, gl.UNSIGNED_INT, 0);
    }
    gl.depthMask(true);
    gl.bindVertexArray(null);
  }

  matrix() {
    const { clientWidth, clientHeight } = this.canvas;
    return viewMatrix(this.camera, this.center, this.size, clientWidth / clientHeight);
  }

  // Entry points are squares that just touch each other.
  pointSize() {
    const least = Math.min(this.canvas.clientWidth, this.canvas.clientHeight);
    return Math.max(2, (0.9 * this.volume.spacing_mm * this.camera.zoom * least) / this.size);
  }

  listen(choose) {
    const { canvas, camera } = this;
    let from = null;
    let moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      moved = 0;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [dx, dy] = [event.clientX - from[0], event.clientY - from[1]];
      from = [event.clientX, event.clientY];
      moved += Math.hypot(dx, dy);
      this.turn(-dx * 0.008, dy * 0.008);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from && moved < 4) this.pick(event, choose);
      from = null;
    });
    canvas.addEventListener("pointercancel", () => { from = null; });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("keydown", ({ key }) => {
      const turns = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
      if (turns[key]) this.turn(...turns[key]);
      else if (key === "+" || key === "=") this.zoom(1.15);
      else if (key === "-") this.zoom(1 / 1.15);
      else return;
      event.preventDefault();
    });
    this.camera = camera;
  }

  turn(around, over) {
    this.camera.turn += around;
    this.camera.tilt = Math.max(-1.5, Math.min(1.5, this.camera.tilt + over));
    requestAnimationFrame(() => this.draw());
  }

  zoom(factor) {
    this.camera.zoom = Math.max(0.3, Math.min(12, this.camera.zoom * factor));
    requestAnimationFrame(() => this.draw());
  }

  // Chooses the entry point that is nearest to the click on the screen.
  pick(event, choose) {
    if (!this.volume || !this.show.entries) return;
    const box = this.canvas.getBoundingClientRect();
    const { matrix } = this.matrix();
    const points = this.volume.points_mm;
    let [best, least] = [-1, CLICK_PX];
    for (let place = 0; place < points.length / 3; place++) {
      const [x, y] = projected(matrix, points.subarray(3 * place, 3 * place + 3));
      const across = ((x + 1) / 2) * box.width + box.left - event.clientX;
      const down = ((1 - y) / 2) * box.height + box.top - event.clientY;
      const far = Math.hypot(across, down);
      if (far < least) [best, least] = [place, far];
    }
    if (best >= 0) choose(best);
  }
}

// Colours of obstacles by name: vessels red, bone bright, others from a list that the colour-blind can tell apart.
const OTHERS = ["#8da0cb", "#66a61e", "#7570b3", "#a6761d", "#999999"];

export function bodyColour(name, number) {
  if (/vessel|arter|vein|vena|aort/i.test(name)) return "#b5483a";
  if (/bone|rib|skull/i.test(name)) return isDark() ? "#d8d2c0" : "#9c9480";
  return OTHERS[number % OTHERS.length];
}

// From dark blue (0) over teal to yellow (1), evenly brighter, as viridis; shares of red, green and blue.
const STEPS = [[0.267, 0.005, 0.329], [0.231, 0.322, 0.546], [0.129, 0.569, 0.551], [0.369, 0.789, 0.383], [0.993, 0.906, 0.144]];

export function successColour(share) {
  const place = Math.max(0, Math.min(0.9999, share)) * (STEPS.length - 1);
  const [low, part] = [Math.floor(place), place % 1];
  return STEPS[low].map((value, index) => value + part * (STEPS[low + 1][index] - value));
}

function rgb(text) {
  return [1, 3, 5].map((place) => parseInt(text.slice(place, place + 2), 16) / 255);
}

function makeProgram(gl) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return program;
}
