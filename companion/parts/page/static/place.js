// The drone's place against the pad, from above (the arrow points up) and from the side (the arrow points to the right).
const SPACE = "http://www.w3.org/2000/svg";
const SCALES = [1, 2, 5, 10, 20, 50, 100, 200];
const TRAIL = 200; // states, ten a second
const EDGE = 88; // units of the drawing from its centre to the largest ring
const CHI_95 = 2.448;
const AHEAD_S = [1, 2];
const WIDE_M = 0.4; // drawn width of what is about the pad, whose own is not known

function make(parent, tag, attributes = {}) {
  const element = document.createElementNS(SPACE, tag);
  put(element, attributes);
  parent.append(element);
  return element;
}

function put(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, typeof value === "number" ? value.toFixed(2) : value);
}

// The place of the drone in the pad's axes: x along the arrow, y to starboard of it, z up. The estimate has the pad in the drone's
// own level axes; its forward points to (cos yaw, sin yaw), or along the arrow if the heading against it is not known.
export function placeOf({ belief, deck }) {
  if (belief === null) return null;
  const heading_rad = belief.yaw_rad ?? 0;
  const [c, s] = [Math.cos(heading_rad), Math.sin(heading_rad)];
  const turned = ([forward, right]) => [s * right - c * forward, -s * forward - c * right];
  const [x_m, y_m] = turned(belief.d_body_pad_level);
  const [xx, xy, yy] = [belief.cov[0], belief.cov[1], belief.cov[8]];
  return {
    x_m, y_m, z_m: belief.height_m, heading_rad, heading_known: belief.yaw_rad !== undefined, consistent: belief.consistent,
    v_m_s: [...turned(belief.v_pad_level), belief.v_pad_level[2]],
    cov_m2: [c * c * xx - 2 * c * s * xy + s * s * yy, c * s * (xx - yy) + (c * c - s * s) * xy, s * s * xx + 2 * c * s * xy + c * c * yy],
    sigma_z_m: Math.sqrt(Math.max(0, belief.cov[16])),
    deck_roll_rad: deck?.roll_rad[0] ?? null,
    deck_pitch_rad: deck?.pitch_rad[0] ?? null,
    deck_m: deck?.horizons_s.map((ahead_s, i) => [ahead_s, deck.height_m[i] - deck.height_m[0], deck.sigma_height_m[i]]) ?? [],
  };
}

const points = (list) => list.map(([x, y]) => `${x.toFixed(2)},${y.toFixed(2)}`).join(" ");

class View {
  trail = [];
  scale_m = null;

  constructor(svg) {
    this.svg = svg;
    svg.classList.add("unknown");
  }

  pad(message) {
    this.drawing = message;
    this.trail = [];
    this.scale_m = null;
  }

  show(state) {
    const place = state.place;
    this.svg.classList.toggle("unknown", place === null);
    if (place === null || !this.drawing) return;
    this.trail.push([place.x_m, place.y_m, place.z_m]);
    if (this.trail.length > TRAIL) this.trail.shift();
    // Grow at once, shrink only when there is plenty of room: a scale that flickers cannot be read.
    const reach = this.reach(place, state);
    const wanted = SCALES.find((s) => s >= 1.05 * reach) ?? SCALES.at(-1);
    if (this.scale_m === null || wanted > this.scale_m || 1.6 * reach < wanted) {
      if (wanted !== this.scale_m) this.ground((this.scale_m = wanted));
    }
    this.draw(place, state, EDGE / this.scale_m);
  }
}

export class Above extends View {
  reach(place, state) {
    const things = state.things.map(({ x_m, y_m }) => Math.hypot(x_m, y_m) + WIDE_M);
    return Math.max(Math.hypot(place.x_m, place.y_m), 1.3 * this.drawing.pad_radius_m, ...things);
  }

  ground(scale_m) {
    const k = EDGE / scale_m;
    this.svg.replaceChildren();
    for (const part of [0.5, 1]) {
      make(this.svg, "circle", { class: "grid", r: EDGE * part });
      make(this.svg, "text", { x: 2, y: 8 - EDGE * part }).textContent = `${scale_m * part} m`;
    }
    make(this.svg, "path", { class: "grid", d: "M-98 0H98M0-98V98" });
    make(this.svg, "circle", { class: "disc", r: this.drawing.pad_radius_m * k });
    for (const line of this.drawing.pad_lines_m) {
      make(this.svg, "polygon", { class: "pad", points: points(line.map(([x, y]) => [y * k, -x * k])) });
    }
    this.things = make(this.svg, "g");
    this.line = make(this.svg, "polyline", { class: "trail" });
    const body = make(this.svg, "g", { class: "body" });
    this.sigma = make(body, "ellipse", { class: "sigma" });
    this.way = make(body, "line", { class: "way" });
    this.symbol = make(body, "g");
    make(this.symbol, "path", { class: "arm", d: "M-5-5L5 5M-5 5L5-5" });
    for (const [x, y] of [[-5, -5], [5, 5], [-5, 5], [5, -5]]) make(this.symbol, "circle", { class: "arm", cx: x, cy: y, r: 3 });
    make(this.symbol, "path", { class: "drone", d: "M0-11L3-5H-3Z" });
  }

  draw(place, state, k) {
    const [x, y] = [place.y_m * k, -place.x_m * k];
    this.things.replaceChildren();
    for (const { x_m, y_m, width_m, height_m } of state.things) {
      const half = ((width_m ?? WIDE_M) / 2) * k;
      const what = width_m !== null ? `${Math.round(100 * width_m)} cm wide` : height_m > 0 ? `${Math.round(100 * height_m)} cm high` : "moves";
      make(this.things, "rect", { class: "thing", x: y_m * k - half, y: -x_m * k - half, width: 2 * half, height: 2 * half });
      make(this.things, "text", { class: "thing-says", x: y_m * k + half + 2, y: -x_m * k + 3 }).textContent = what;
    }
    put(this.line, { points: points(this.trail.map(([tx, ty]) => [ty * k, -tx * k])) });
    const [xx, xy, yy] = place.cov_m2;
    const mean = (xx + yy) / 2;
    const half = Math.hypot((xx - yy) / 2, xy);
    const turn = (Math.atan2(xy, (xx - yy) / 2) / 2) * (180 / Math.PI) - 90;
    put(this.sigma, {
      rx: CHI_95 * Math.sqrt(mean + half) * k, ry: CHI_95 * Math.sqrt(Math.max(0, mean - half)) * k,
      transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${turn.toFixed(1)})`,
    });
    put(this.way, { x1: x, y1: y, x2: x + place.v_m_s[1] * k, y2: y - place.v_m_s[0] * k });
    const heading = place.heading_known ? (place.heading_rad * 180) / Math.PI : 0;
    put(this.symbol, { transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${heading.toFixed(1)})` });
    this.svg.setAttribute("aria-label",
      `From above: the drone is ${place.x_m.toFixed(1)} m along the arrow and ${place.y_m.toFixed(1)} m to starboard of the pad's centre` +
      (state.things.length ? "; something is on the pad or about it" : ""));
  }
}

export class Side extends View {
  reach(place) {
    return Math.max(Math.abs(place.x_m), 0.62 * place.z_m, 1.3 * this.drawing.pad_radius_m);
  }

  ground(scale_m) {
    this.svg.replaceChildren();
    for (let part = 0; part <= 1.5; part += 0.5) {
      make(this.svg, "path", { class: "grid", d: `M-98 ${(60 - EDGE * part).toFixed(2)}H98` });
      make(this.svg, "text", { x: -97, y: 58 - EDGE * part }).textContent = `${scale_m * part} m`;
    }
    this.ghosts = AHEAD_S.map(() => make(this.svg, "line", { class: "ghost" }));
    this.deck = make(this.svg, "line", { class: "deck" });
    this.line = make(this.svg, "polyline", { class: "trail" });
    const body = make(this.svg, "g", { class: "body" });
    this.sigma = make(body, "line", { class: "sigma" });
    this.way = make(body, "line", { class: "way" });
    this.symbol = make(body, "g");
    make(this.symbol, "path", { class: "arm", d: "M-8-2.5H8M-8-2.5V-4.5M8-2.5V-4.5M-11.5-4.5H-4.5M4.5-4.5H11.5M-4-1L-5 2.5M4-1L5 2.5" });
    make(this.symbol, "rect", { class: "drone", x: -4, y: -4, width: 8, height: 4, rx: 1 });
    this.ahead = make(this.svg, "text", { x: -97, y: 96 });
  }

  draw(place, state, k) {
    const [x, y] = [place.x_m * k, 60 - place.z_m * k];
    const half = this.drawing.pad_radius_m * k;
    const rise = Math.tan(place.deck_pitch_rad ?? 0) * half;
    put(this.deck, { x1: -half, y1: 60 + rise, x2: half, y2: 60 - rise });
    AHEAD_S.forEach((s, i) => {
      const found = place.deck_m.find(([at]) => at >= s - 0.01);
      const up = found ? found[1] * k : 0;
      put(this.ghosts[i], { x1: -half, x2: half, y1: 60 - up, y2: 60 - up, visibility: found ? "visible" : "hidden" });
    });
    const last = place.deck_m.find(([at]) => at >= AHEAD_S.at(-1) - 0.01);
    this.ahead.textContent = last ? `deck in ${last[0]} s: ${last[1] >= 0 ? "+" : "−"}${Math.abs(100 * last[1]).toFixed(0)} cm, ± ${(196 * last[2]).toFixed(0)}` : "";
    put(this.line, { points: points(this.trail.map(([tx, , tz]) => [tx * k, 60 - tz * k])) });
    const sigma = 1.96 * place.sigma_z_m * k;
    put(this.sigma, { x1: x, x2: x, y1: y - sigma, y2: y + sigma });
    put(this.way, { x1: x, y1: y, x2: x + place.v_m_s[0] * k, y2: y - place.v_m_s[2] * k });
    const tilt = state.pitch_rad === null || !place.heading_known ? 0 : (-state.pitch_rad * Math.cos(place.heading_rad) * 180) / Math.PI;
    put(this.symbol, { transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${tilt.toFixed(1)})` });
    this.svg.setAttribute("aria-label", `From the side: the drone is ${place.z_m.toFixed(1)} m above the pad`);
  }
}
