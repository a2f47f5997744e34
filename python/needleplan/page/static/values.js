// Values under the pointer: position, success, heading and cost of the nearest grid point.

import { make, percent } from "./texts.js";

export class Values {
  constructor(section, element, plane, store) {
    this.element = element;
    this.plane = plane;
    this.store = store;
    this.lines = ["", "", ""].map(() => element.appendChild(make("div")));
    section.addEventListener("pointermove", (event) => this.show(event, section.getBoundingClientRect()));
    section.addEventListener("pointerleave", () => { element.hidden = true; });
  }

  show({ clientX, clientY, buttons }, box) {
    const pixel = [clientX - box.left, clientY - box.top];
    const [x, y] = this.plane.position(pixel);
    const { plan } = this.store;
    this.element.hidden = !plan || buttons > 0 || !this.plane.contains([x, y]);
    if (this.element.hidden) return;
    const { shape: [nx, ny] } = plan.success;
    const [i, j] = [Math.min(Math.round(x / plan.spacing_mm[0]), nx - 1), Math.min(Math.round(y / plan.spacing_mm[1]), ny - 1)];
    const at = i * ny + j;
    const state = plan.state[at];
    const degrees = ((Math.floor(state / 2) * 360) / plan.shape[2] + 180) % 360 - 180;
    const texts = [
      `x ${x.toFixed(1)}, y ${y.toFixed(1)} mm`,
      `success ${percent(plan.success[at] / 65535)}, cost ${Number(plan.costs[at].toPrecision(4))}`,
      `heading ${Number(degrees.toFixed(1))}°, bevel ${state % 2 ? "+1" : "−1"}`,
    ];
    this.lines.forEach((line, number) => { line.textContent = texts[number]; });
    const [across, down] = [pixel[0] > box.width - 220 ? -1 : 1, pixel[1] > box.height - 100 ? -1 : 1];
    this.element.style.transform = `translate(${pixel[0] + across * 16}px, ${pixel[1] + down * 16}px)`
      + ` translate(${across < 0 ? "-100%" : "0"}, ${down < 0 ? "-100%" : "0"})`;
  }
}
