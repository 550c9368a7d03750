// One plot over time on a canvas: layers, axes, and what each layer reads at the cursor.

const LEFT = 52;
const RIGHT = 8;
const TOP = 8;
const BOTTOM = 20;

const FONT = '11px system-ui, -apple-system, "Segoe UI", "Noto Sans", "DejaVu Sans", sans-serif';

// A canvas of the page.
class Canvas {
  constructor(figure, data, page) {
    this.data = data;
    this.page = page;
    this.canvas = figure.querySelector("canvas");
    this.inSight = false;
  }

  get shown() {
    return this.layers.filter((layer) => !this.page.hidden.has(layer.name));
  }

  // Not where the page leaves it no pixel: an empty canvas has no image to keep.
  draw(anyway = false) {
    const [width, height, ratio] = [this.canvas.clientWidth, this.canvas.clientHeight, Math.max(anyway ? 2 : 1, Math.min(3, devicePixelRatio))];
    if (!(anyway || this.inSight) || width < 1 || height < 1) return;
    [this.canvas.width, this.canvas.height] = [Math.ceil(width * ratio), Math.ceil(height * ratio)];
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = FONT;
    this.paint(pen, width, height);
    // Chromium prints the lines of a canvas, and too small, unless it was given an image.
    if (anyway) pen.putImageData(pen.getImageData(0, 0, this.canvas.width, this.canvas.height), 0, 0);
    this.cursor();
  }
}

function stroke(pen, points) {
  pen.beginPath();
  for (const [x, y] of points) pen.lineTo(x, y);
  pen.stroke();
}

class TimePlot extends Canvas {
  constructor(figure, data, page) {
    super(figure, data, page);
    this.figure = figure;
    this.line = figure.querySelector(".cursor");
    this.value = figure.querySelector(".value");
    this.layers = data.layers.map((layer) => ({
      ...layer,
      t: page.columns[layer.t],
      y: page.columns[layer.y],
      upper: layer.upper === undefined ? null : page.columns[layer.upper],
    }));
  }

  get width() {
    return this.canvas.clientWidth;
  }

  x(t) {
    const [low, high] = this.page.clock.view;
    return LEFT + ((t - low) / (high - low)) * (this.width - LEFT - RIGHT);
  }

  t(x) {
    const [low, high] = this.page.clock.view;
    return low + ((x - LEFT) / (this.width - LEFT - RIGHT)) * (high - low);
  }

  paint(pen, width, height) {
    this.left = LEFT;
    const layers = this.shown;
    const [low, high] = this.limits(layers);
    this.scale = this.scaleOf(low, high, TOP, height - BOTTOM);
    this.axes(pen, width, height, low, high);
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, TOP - 1, width - LEFT - RIGHT, height - TOP - BOTTOM + 2);
    pen.clip();
    this.phases(pen, height);
    for (const kind of ["band", "wide", "dots", "line", "level"]) {
      for (const layer of layers) {
        const is = layer.wide ? "wide" : layer.style === "step" ? "line" : layer.style;
        if (is === kind) this.layer(pen, layer);
      }
    }
    pen.restore();
  }

  // The values in sight decide: a wild one of a layer that does not fit is left outside.
  limits(layers) {
    if (this.data.names.length) return [this.data.names.length - 0.5, -0.5];
    let [low, high] = [Infinity, -Infinity];
    for (const only of [true, false]) {
      for (const layer of layers) {
        if (only && !layer.fits) continue;
        const [from, to] = this.inView(layer);
        for (let i = from; i <= to; i += 1) {
          const [least, most] = [layer.y[i], layer.upper ? layer.upper[i] : layer.y[i]];
          if (least < low) low = least;
          if (most > high) high = most;
        }
      }
      if (low <= high) break;
    }
    if (low > high) return this.data.log ? [0.1, 10] : [-1, 1];
    if (this.data.log) return [low / 1.3, high * 1.3];
    if (this.data.zero) [low, high] = [Math.min(low, 0), Math.max(high, 0)];
    const least = Math.max(this.data.least, 1e-6);
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    const room = 0.06 * (high - low);
    return [low - room, high + room];
  }

  inView(layer) {
    const [low, high] = this.page.clock.view;
    return [Math.max(0, indexAt(layer.t, low)), Math.min(layer.t.length - 1, indexAt(layer.t, high) + 1)];
  }

  scaleOf(low, high, top, bottom) {
    if (this.data.log) {
      const [a, b] = [Math.log10(low), Math.log10(high)];
      return (value) => bottom - ((Math.log10(value) - a) / (b - a)) * (bottom - top);
    }
    return (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
  }

  axes(pen, width, height, low, high) {
    pen.lineWidth = 1;
    pen.strokeStyle = style("--grid");
    pen.fillStyle = style("--soft");
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    const most = Math.max(2, Math.floor((height - TOP - BOTTOM) / 26));
    let marks;
    if (this.data.names.length) marks = this.data.names.map((name, k) => [k, name]);
    else if (this.data.log) {
      const wide = powers(low, high, most);
      const found = wide.length > 1 ? wide : ticks(low, high, 3)[0].filter((value) => value > 0);
      marks = found.map((value) => [value, written(value, value)]);
    } else {
      const [found, step] = ticks(low, high, most);
      marks = found.map((value) => [value, written(value, step)]);
    }
    for (const [value, text] of marks) {
      const y = Math.round(this.scale(value)) + 0.5;
      stroke(pen, [[LEFT, y], [width - RIGHT, y]]);
      pen.fillText(text, LEFT - 6, y, LEFT - 8);
    }
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    const [found, step] = ticks(...this.page.clock.view, Math.floor((width - LEFT - RIGHT) / 64));
    for (const value of found) {
      const x = Math.round(this.x(value)) + 0.5;
      stroke(pen, [[x, TOP], [x, height - BOTTOM]]);
      const text = `${written(value, step)} s`;
      const half = pen.measureText(text).width / 2;
      pen.fillText(text, clamp(x, half, width - half), height - 5);
    }
  }

  phases(pen, height) {
    pen.strokeStyle = style("--phase");
    pen.setLineDash([2, 3]);
    for (const flight of this.page.data.flights) {
      if (this.page.data.flights.length > 1) pen.strokeStyle = flight.colour;
      for (const [t] of flight.phases) stroke(pen, [[this.x(t), TOP], [this.x(t), height - BOTTOM]]);
    }
    pen.setLineDash([]);
  }

  layer(pen, layer) {
    const ink = layer.colour === "ink" ? style("--ink") : layer.colour;
    const [from, to] = this.inView(layer);
    pen.strokeStyle = pen.fillStyle = ink;
    pen.globalAlpha = layer.style === "band" ? 0.2 : layer.wide ? 0.32 : layer.style === "dots" ? 0.8 : 1;
    pen.lineWidth = layer.wide ? 5 : 1.5;
    pen.lineJoin = "round";
    if (layer.style === "level") pen.setLineDash([6, 4]);
    if (layer.style === "dots") this.dots(pen, layer, from, to);
    else for (const [first, last] of this.runs(layer, from, to)) this.run(pen, layer, first, last);
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  dots(pen, layer, from, to) {
    const size = to - from > 1500 ? 1.8 : 2.6;
    for (let i = from; i <= to; i += 1) {
      const y = this.scale(layer.y[i]);
      if (Number.isFinite(y)) pen.fillRect(this.x(layer.t[i]) - size / 2, y - size / 2, size, size);
    }
  }

  // Pieces without a gap: where nothing was known there is no line.
  runs(layer, from, to) {
    const found = [];
    let first = -1;
    for (let i = from; i <= to; i += 1) {
      const known = Number.isFinite(layer.y[i]);
      const after = first >= 0 && layer.style !== "level" && layer.t[i] - layer.t[i - 1] > layer.gap;
      if (first >= 0 && (!known || after)) {
        found.push([first, i - 1]);
        first = -1;
      }
      if (known && first < 0) first = i;
    }
    if (first >= 0) found.push([first, to]);
    return found;
  }

  run(pen, layer, first, last) {
    pen.beginPath();
    for (let i = first; i <= last; i += 1) {
      if (layer.style === "step" && i > first) pen.lineTo(this.x(layer.t[i]), this.scale(layer.y[i - 1]));
      pen.lineTo(this.x(layer.t[i]), this.scale(layer.y[i]));
    }
    if (layer.style !== "band") {
      pen.stroke();
      return;
    }
    for (let i = last; i >= first; i -= 1) pen.lineTo(this.x(layer.t[i]), this.scale(layer.upper[i]));
    pen.fill();
  }

  cursor() {
    const { t, view } = this.page.clock;
    this.line.hidden = t < view[0] - 1e-6 || t > view[1] + 1e-6;
    this.line.style.transform = `translateX(${this.x(t).toFixed(1)}px)`;
    const read = new Map();
    for (const layer of this.shown) {
      if (!layer.read) continue;
      const value = valueAt(layer.t, layer.y, t, layer.style === "dots" ? 0.1 : layer.gap);
      if (value !== null) read.set(layer.name, { value, colour: layer.colour });
    }
    this.value.replaceChildren(
      ...[...read].map(([name, { value, colour }]) => {
        const one = document.createElement("span");
        const dot = document.createElement("i");
        dot.style.background = colour === "ink" ? "var(--ink)" : colour;
        const number = document.createElement("b");
        number.textContent = told(value);
        one.append(dot, `${name.replaceAll("_", " ")} `, number);
        return one;
      }),
    );
  }
}
