// The last minute: height, distance from the centre and climb, with the bands of the estimate's own error.
import { shown, signed } from "./units.js";

const SPAN_S = 60;
const DRAWN_MS = 250;
const PLOTS = [
  { id: "plot-height", name: "Height", kind: "length", of: (p) => p.z_m, half: (p) => 1.96 * p.sigma_z_m, least: 1, floor: 0 },
  {
    id: "plot-lateral", name: "Off centre", kind: "length", of: (p) => Math.hypot(p.x_m, p.y_m),
    half: (p) => 2.448 * Math.sqrt(Math.max(p.cov_m2[0], p.cov_m2[2])), least: 0.4, floor: 0,
  },
  { id: "plot-climb", name: "Climb", kind: "climb", of: (p) => p.v_m_s[2], half: () => 0, least: 0.5, floor: null },
];
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200];

export class Plots {
  #states = [];
  #phases = [];
  #drawn = 0;

  show(state) {
    const last = this.#states.at(-1);
    if (last && state.at_s < last.at_s) [this.#states, this.#phases] = [[], []];
    this.#states.push({ at_s: state.at_s, place: state.place });
    if (this.#phases.at(-1)?.phase !== state.phase) this.#phases.push({ at_s: state.at_s, phase: state.phase });
    const from = state.at_s - SPAN_S;
    while (this.#states[0].at_s < from) this.#states.shift();
    while (this.#phases.length > 1 && this.#phases[1].at_s < from) this.#phases.shift();
    const now = performance.now();
    if (now - this.#drawn < DRAWN_MS) return;
    this.#drawn = now;
    for (const plot of PLOTS) this.#draw(plot, state.at_s);
  }

  #draw(plot, now_s) {
    const canvas = document.getElementById(plot.id);
    const [unit, size, digits] = shown(plot.kind);
    canvas.previousElementSibling.textContent = `${plot.name}, ${unit}`;
    const scale = devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (width === 0) return;
    if (canvas.width !== Math.round(width * scale)) Object.assign(canvas, { width: Math.round(width * scale), height: Math.round(height * scale) });
    const pen = canvas.getContext("2d");
    const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, height);
    const known = this.#states.filter(({ place }) => place !== null).map(({ at_s, place }) => ({ at_s, value: plot.of(place) / size, half: plot.half(place) / size }));
    let low = plot.floor ?? -plot.least / size;
    let high = plot.least / size;
    for (const { value } of known) [low, high] = [Math.min(low, value), Math.max(high, value)];
    const step = STEPS.find((s) => (high - low) / s <= 3.2) ?? 500;
    [low, high] = [Math.floor(low / step - 0.02) * step, Math.ceil(high / step + 0.02) * step];
    if (plot.floor !== null) low = Math.max(low, plot.floor);
    const [left, top, bottom] = [34, 6, height - 16];
    const x = (at_s) => left + (width - left - 4) * (1 - (now_s - at_s) / SPAN_S);
    const y = (value) => bottom - ((bottom - top) * (value - low)) / (high - low);
    pen.font = "11px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.strokeStyle = ink("--grid");
    pen.fillStyle = ink("--soft");
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let value = low; value <= high + 1e-9; value += step) {
      pen.stroke(new Path2D(`M${left} ${y(value)}H${width - 4}`));
      pen.fillText(step < 1 ? value.toFixed(1) : value.toFixed(0), left - 5, y(value));
    }
    pen.textBaseline = "alphabetic";
    for (const ago of width < 280 ? [60, 0] : [60, 40, 20, 0]) {
      pen.textAlign = ago === 60 ? "left" : ago === 0 ? "right" : "center";
      pen.fillText(ago ? `−${ago} s` : "now", x(now_s - ago), height - 3);
    }
    pen.save();
    pen.beginPath();
    pen.rect(left, top, width - left - 4, bottom - top);
    pen.clip();
    pen.strokeStyle = ink("--ahead");
    pen.setLineDash([2, 3]);
    for (const { at_s } of this.#phases.slice(1)) pen.stroke(new Path2D(`M${x(at_s)} ${top}V${bottom}`));
    pen.setLineDash([]);
    pen.fillStyle = pen.strokeStyle = ink("--drone");
    pen.lineWidth = 1.8;
    for (const run of runs(known)) {
      const path = (of) => new Path2D(`M${of.map(({ at_s, value }) => `${x(at_s)} ${y(value)}`).join("L")}`);
      const edge = (side) => run.map(({ at_s, value, half }) => ({ at_s, value: value + side * half }));
      pen.globalAlpha = 0.18;
      pen.fill(path([...edge(1), ...edge(-1).reverse()]));
      pen.globalAlpha = 1;
      pen.stroke(path(run));
    }
    pen.restore();
    const newest = known.at(-1);
    canvas.setAttribute("aria-label", `${plot.name} in the last minute; ${newest ? `${signed(newest.value, digits, "")} ${unit} at its end` : "not known"}`);
  }
}

// Pieces without a gap: where the pad was not known there is no line.
function runs(known) {
  const found = [];
  for (const one of known) {
    const run = found.at(-1);
    if (run && one.at_s - run.at(-1).at_s < 0.5) run.push(one);
    else found.push([one]);
  }
  return found;
}
