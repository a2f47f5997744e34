// Colours by theme. The field is a ramp of lightness in one hue, which readers of all kinds of colour vision can order;
// the marks are colours of Okabe and Ito.

const LIGHT = {
  surface: "#ffffff", ink: "#15212b", faint: "#66727c", grid: "rgba(21, 33, 43, .10)", edge: "#8b97a1",
  low: [126, 147, 168], high: [252, 250, 245],
  obstacle: "#4b4540", obstacleEdge: "#2b2723", hatch: "rgba(255, 255, 255, .10)", label: "#f4efe8",
  margin: "rgba(75, 69, 64, .28)", tissue: "#8a6d3b",
  path: "#0b3a5b", halo: "rgba(255, 255, 255, .85)", reached: "rgba(0, 114, 178, .30)",
  failed: "rgba(213, 94, 0, .75)", turn: "#009e73", executed: "#aa3377", target: "#d55e00", targetFill: "rgba(230, 159, 0, .28)",
  measured: "#7d8790", before: "#d55e00", after: "#0072b2", band: "rgba(21, 33, 43, .13)",
};

const DARK = {
  surface: "#10171d", ink: "#e6edf2", faint: "#93a1ac", grid: "rgba(230, 237, 242, .09)", edge: "#5d6b76",
  low: [11, 16, 21], high: [58, 88, 112],
  obstacle: "#8d8378", obstacleEdge: "#c9beb1", hatch: "rgba(0, 0, 0, .16)", label: "#17120d",
  margin: "rgba(160, 150, 138, .30)", tissue: "#d0a85c",
  path: "#ffffff", halo: "rgba(8, 14, 19, .75)", reached: "rgba(86, 180, 233, .42)",
  failed: "rgba(255, 140, 66, .85)", turn: "#2fd6a4", executed: "#f29ac5", target: "#ffb454", targetFill: "rgba(255, 180, 84, .25)",
  measured: "#93a1ac", before: "#ff9a57", after: "#56b4e9", band: "rgba(230, 237, 242, .16)",
};

export function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

export function palette() {
  return isDark() ? DARK : LIGHT;
}

// Returns the bytes (red, green, blue, opacity) of 256 steps of the field.
export function ramp({ low, high }) {
  const bytes = new Uint8ClampedArray(256 * 4);
  for (let step = 0; step < 256; step++) {
    for (let part = 0; part < 3; part++) bytes[4 * step + part] = low[part] + ((high[part] - low[part]) * step) / 255;
    bytes[4 * step + 3] = 255;
  }
  return bytes;
}
