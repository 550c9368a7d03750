// The drone's place against the pad, from above (the arrow points up) and from the side (the arrow points to the right).
import { inWords, shown } from "./units.js";

const SPACE = "http://www.w3.org/2000/svg";
const SCALES = [1, 2, 5, 10, 20, 50, 100, 200, 500];
const TRAIL = 200; // states, ten a second
const EDGE = 88; // units of the drawing from its centre to the largest ring
const CHI_95 = 2.448;
const AHEAD_S = [1, 2];
const WIDE_M = 0.4; // drawn width of what is about the pad, whose own is not known

function make(tag, attributes, text = "") {
  const element = document.createElementNS(SPACE, tag);
  put(element, attributes);
  element.textContent = text;
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
  unit = "";

  // The parts of the drawing are named by their classes in the page.
  constructor(svg) {
    this.svg = svg;
    this.parts = Object.fromEntries([...svg.querySelectorAll("[class]")].map((part) => [part.classList[0], part]));
  }

  pad(message) {
    this.drawing = message;
    this.trail = [];
    this.scale_m = null;
  }

  show(state) {
    const place = state.place;
    this.svg.classList.toggle("unknown", place === null);
    const [unit, size_m] = shown("length");
    if (place === null) {
      if (unit === this.unit) return;
      this.unit = "";
      for (const ring of this.svg.querySelectorAll(".ring")) ring.textContent = "";
      return;
    }
    this.trail.push([place.x_m, place.y_m, place.z_m]);
    if (this.trail.length > TRAIL) this.trail.shift();
    // Grow at once, shrink only when there is plenty of room: a scale that flickers cannot be read.
    const reach = this.reach(place, state);
    const scale = SCALES.find((s) => s * size_m >= 1.05 * reach) ?? SCALES.at(-1);
    const wanted = scale * size_m;
    if (this.unit !== unit || this.scale_m === null || wanted > this.scale_m || 1.6 * reach < wanted) {
      [this.unit, this.scale_m] = [unit, wanted];
      this.svg.querySelectorAll(".ring").forEach((ring, i) => (ring.textContent = `${(scale * (i + this.first)) / 2} ${unit}`));
      this.ground(EDGE / wanted);
    }
    this.draw(place, state, EDGE / this.scale_m);
  }
}

export class Above extends View {
  first = 1; // the innermost ring is half of the scale

  reach(place, state) {
    const things = state.things.map(({ x_m, y_m }) => Math.hypot(x_m, y_m) + WIDE_M);
    return Math.max(Math.hypot(place.x_m, place.y_m), 1.3 * this.drawing.pad_radius_m, ...things);
  }

  ground(k) {
    put(this.parts.disc, { r: this.drawing.pad_radius_m * k });
    const drawn = (line) => make("polygon", { class: "pad", points: points(line.map(([x, y]) => [y * k, -x * k])) });
    this.parts.lines.replaceChildren(...this.drawing.pad_lines_m.map(drawn));
  }

  draw(place, state, k) {
    const [x, y] = [place.y_m * k, -place.x_m * k];
    const { things, trail, sigma, way, symbol } = this.parts;
    things.replaceChildren();
    for (const { x_m, y_m, width_m, height_m } of state.things) {
      const half = ((width_m ?? WIDE_M) / 2) * k;
      const what = width_m !== null ? `${inWords("length", width_m)} wide` : height_m > 0 ? `${inWords("length", height_m)} high` : "moves";
      const side = y_m * k < 40 ? 1 : -1; // the words stay within the drawing
      things.append(
        make("rect", { class: "thing", x: y_m * k - half, y: -x_m * k - half, width: 2 * half, height: 2 * half }),
        make("text", { class: "thing-says", x: y_m * k + side * (half + 2), y: -x_m * k + 3, "text-anchor": side > 0 ? "start" : "end" }, what),
      );
    }
    put(trail, { points: points(this.trail.map(([tx, ty]) => [ty * k, -tx * k])) });
    const [xx, xy, yy] = place.cov_m2;
    const mean = (xx + yy) / 2;
    const half = Math.hypot((xx - yy) / 2, xy);
    const turn = (Math.atan2(xy, (xx - yy) / 2) / 2) * (180 / Math.PI) - 90;
    put(sigma, {
      rx: CHI_95 * Math.sqrt(mean + half) * k, ry: CHI_95 * Math.sqrt(Math.max(0, mean - half)) * k,
      transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${turn.toFixed(1)})`,
    });
    put(way, { x1: x, y1: y, x2: x + place.v_m_s[1] * k, y2: y - place.v_m_s[0] * k });
    const heading = place.heading_known ? (place.heading_rad * 180) / Math.PI : 0;
    put(symbol, { transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${heading.toFixed(1)})` });
    const [along, across] = [inWords("length", place.x_m), inWords("length", place.y_m)];
    this.svg.setAttribute("aria-label",
      `From above: the drone is ${along} along the arrow and ${across} to starboard of the pad's centre` +
      (state.things.length ? "; something is on the pad or about it" : ""));
  }
}

export class Side extends View {
  first = 0; // the lowest line is the deck

  reach(place) {
    return Math.max(Math.abs(place.x_m), 0.62 * place.z_m, 1.3 * this.drawing.pad_radius_m);
  }

  ground() {}

  draw(place, state, k) {
    const [x, y] = [place.x_m * k, 60 - place.z_m * k];
    const { deck, trail, sigma, way, symbol, ahead } = this.parts;
    const half = this.drawing.pad_radius_m * k;
    const rise = Math.tan(place.deck_pitch_rad ?? 0) * half;
    put(deck, { x1: -half, y1: 60 + rise, x2: half, y2: 60 - rise });
    this.svg.querySelectorAll(".ghost").forEach((ghost, i) => {
      const found = place.deck_m.find(([at]) => at >= AHEAD_S[i] - 0.01);
      const up = found ? found[1] * k : 0;
      put(ghost, { x1: -half, x2: half, y1: 60 - up, y2: 60 - up, visibility: found ? "visible" : "hidden" });
    });
    const last = place.deck_m.find(([at]) => at >= AHEAD_S.at(-1) - 0.01);
    ahead.textContent = last?.[2] > 0 ? `deck in ${last[0]} s: ${inWords("length", last[1], "+")}, ± ${inWords("length", 1.96 * last[2])}` : "deck ahead: unknown";
    put(trail, { points: points(this.trail.map(([tx, , tz]) => [tx * k, 60 - tz * k])) });
    const half_sigma = 1.96 * place.sigma_z_m * k;
    put(sigma, { x1: x, x2: x, y1: y - half_sigma, y2: y + half_sigma });
    put(way, { x1: x, y1: y, x2: x + place.v_m_s[0] * k, y2: y - place.v_m_s[2] * k });
    const tilt = state.pitch_rad === null || !place.heading_known ? 0 : (-state.pitch_rad * Math.cos(place.heading_rad) * 180) / Math.PI;
    put(symbol, { transform: `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${tilt.toFixed(1)})` });
    this.svg.setAttribute("aria-label", `From the side: the drone is ${inWords("length", place.z_m)} above the pad`);
  }
}
