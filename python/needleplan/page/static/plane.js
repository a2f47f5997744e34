// The plane of a scenario on a canvas: which pixel is which position in mm, sharp on screens of any density.

const FLATTEST = 6; // ratio of width to height above which the plane is stretched in y, as in the figures

const MARGIN = { left: 52, right: 20, top: 18, bottom: 44 }; // pixels around the workspace, for the axes

export class Plane {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.size = { width_mm: 1, height_mm: 1 };
    this.scale = 1; // pixels per mm along x
    this.scaleY = 1; // pixels per mm along y
    this.stretch = 1; // their ratio
    this.left = 0;
    this.bottom = 0;
  }

  // Fits the workspace into the element. Returns the drawing context, with CSS pixels as its unit.
  fit(workspace) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const density = window.devicePixelRatio || 1;
    const pixels = [Math.round(width * density), Math.round(height * density)];
    if (this.canvas.width !== pixels[0] || this.canvas.height !== pixels[1]) [this.canvas.width, this.canvas.height] = pixels;
    this.size = workspace;
    const room = [width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom];
    this.stretch = Math.max(workspace.width_mm / workspace.height_mm / FLATTEST, 1);
    this.scale = Math.max(Math.min(room[0] / workspace.width_mm, room[1] / workspace.height_mm / this.stretch), 0.01);
    this.scaleY = this.scale * this.stretch;
    const drawn = [workspace.width_mm * this.scale, workspace.height_mm * this.scaleY];
    this.left = MARGIN.left + (room[0] - drawn[0]) / 2;
    this.bottom = MARGIN.top + (room[1] - drawn[1]) / 2 + drawn[1];
    this.context.setTransform(density, 0, 0, density, 0, 0);
    this.context.clearRect(0, 0, width, height);
    return this.context;
  }

  // Pixel of a position in mm.
  at([x, y]) {
    return [this.left + x * this.scale, this.bottom - y * this.scaleY];
  }

  // Adds a path whose coordinates are in mm; lines that are drawn along it keep their width.
  trace(context, add) {
    context.save();
    context.translate(this.left, this.bottom);
    context.scale(this.scale, -this.scaleY);
    context.beginPath();
    add();
    context.restore();
  }

  // Angle on the screen (rad, counter-clockwise) of a direction in the plane.
  turned(angle) {
    return Math.atan2(Math.sin(angle) * this.stretch, Math.cos(angle));
  }

  // Position in mm of a pixel of the element.
  position([across, down]) {
    return [(across - this.left) / this.scale, (this.bottom - down) / this.scaleY];
  }

  contains([x, y]) {
    return x >= 0 && y >= 0 && x <= this.size.width_mm && y <= this.size.height_mm;
  }

  clamp([x, y]) {
    return [Math.min(Math.max(x, 0), this.size.width_mm), Math.min(Math.max(y, 0), this.size.height_mm)];
  }
}
