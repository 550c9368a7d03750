// The way over the pad from one side, to scale: the pad's own regions, the tracks, the contacts, and the drone at the cursor.

class PadView extends Canvas {
  constructor(figure, data, page) {
    super(figure, data, page);
    this.layers = data.layers.map((layer) => ({
      ...layer, t: page.columns[layer.t], x: page.columns[layer.x], y: page.columns[layer.y],
    }));
  }

  // Equal scales in both directions, the pad always in sight.
  frame(width, height) {
    const [left, top, right, bottom] = [46, 10, width - 10, height - 34];
    const r = this.data.span ?? this.data.radius * 1.2;
    let [x0, x1, y0, y1] = [-r, r, this.data.flat ? -0.1 * r : -r, r];
    if (this.data.span === null) {
      for (const layer of this.shown) {
        for (let i = 0; i < layer.t.length; i += 1) {
          if (!Number.isFinite(layer.x[i]) || !Number.isFinite(layer.y[i])) continue;
          [x0, x1] = [Math.min(x0, layer.x[i]), Math.max(x1, layer.x[i])];
          [y0, y1] = [Math.min(y0, layer.y[i]), Math.max(y1, layer.y[i])];
        }
      }
    }
    const perPixel = 1.08 * Math.max((x1 - x0) / (right - left), (y1 - y0) / (bottom - top));
    const [cx, cy] = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.x = (x) => (left + right) / 2 + (x - cx) / perPixel;
    this.y = (y) => (top + bottom) / 2 - (y - cy) / perPixel;
    const halves = [((right - left) / 2) * perPixel, ((bottom - top) / 2) * perPixel];
    return { left, top, right, bottom, x: [cx - halves[0], cx + halves[0]], y: [cy - halves[1], cy + halves[1]] };
  }

  paint(pen, width, height) {
    const frame = this.frame(width, height);
    this.axes(pen, frame, height);
    pen.save();
    pen.beginPath();
    pen.rect(frame.left, frame.top, frame.right - frame.left, frame.bottom - frame.top);
    pen.clip();
    this.pad(pen, frame);
    for (const layer of this.shown) this.track(pen, layer);
    for (const mark of this.data.marks) this.mark(pen, mark);
    pen.restore();
    this.whole = pen.getImageData(0, 0, this.canvas.width, this.canvas.height);
  }

  axes(pen, frame, height) {
    pen.lineWidth = 1;
    pen.strokeStyle = style("--grid");
    pen.fillStyle = style("--soft");
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const [ys, yStep] = ticks(...frame.y, Math.floor((frame.bottom - frame.top) / 36));
    for (const value of ys) {
      const y = Math.round(this.y(value)) + 0.5;
      stroke(pen, [[frame.left, y], [frame.right, y]]);
      pen.fillText(written(value, yStep), frame.left - 6, y);
    }
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    const [xs, xStep] = ticks(...frame.x, Math.floor((frame.right - frame.left) / 56));
    for (const value of xs) {
      const x = Math.round(this.x(value)) + 0.5;
      stroke(pen, [[x, frame.top], [x, frame.bottom]]);
      pen.fillText(written(value, xStep), x, frame.bottom + 14);
    }
    pen.fillText(this.data.xName, (frame.left + frame.right) / 2, height - 4);
    pen.save();
    pen.translate(11, (frame.top + frame.bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(this.data.yName, 0, 0);
    pen.restore();
  }

  pad(pen) {
    if (this.data.flat) {
      pen.strokeStyle = style("--deck");
      pen.lineWidth = 6;
      stroke(pen, [[this.x(-this.data.radius), this.y(0) + 3], [this.x(this.data.radius), this.y(0) + 3]]);
      return;
    }
    pen.globalAlpha = 0.8;
    pen.fillStyle = style("--deck");
    pen.beginPath();
    pen.arc(this.x(0), this.y(0), Math.abs(this.x(1.06 * this.data.radius) - this.x(0)), 0, 7);
    pen.fill();
    for (const region of this.data.regions) {
      pen.fillStyle = region.fill;
      pen.beginPath();
      for (const [x, y] of region.points) pen.lineTo(this.x(x), this.y(y));
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  // Drawn on paints of any colour: each line has a rim of the page's ground.
  track(pen, layer) {
    const ink = layer.colour === "ink" ? style("--ink") : layer.colour;
    pen.lineJoin = "round";
    const passes = layer.wide ? [[5, ink, 0.4]] : [[3.2, style("--card"), 0.9], [1.5, ink, 1]];
    for (const [wide, colour, alpha] of passes) {
      [pen.lineWidth, pen.strokeStyle, pen.globalAlpha] = [wide, colour, alpha];
      pen.beginPath();
      let before = false;
      for (let i = 0; i < layer.t.length; i += 1) {
        const known = Number.isFinite(layer.x[i]) && Number.isFinite(layer.y[i]);
        if (known && before && layer.t[i] - layer.t[i - 1] < 1) pen.lineTo(this.x(layer.x[i]), this.y(layer.y[i]));
        else if (known) pen.moveTo(this.x(layer.x[i]), this.y(layer.y[i]));
        before = known;
      }
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  // A contact: a cross, its number, and a line towards where the nose pointed. A thing: a square of its width.
  mark(pen, mark) {
    const [x, y] = [this.x(mark.x), this.y(mark.y)];
    if (mark.size !== null) {
      const half = Math.abs(this.x(mark.size) - this.x(0)) / 2;
      [pen.lineWidth, pen.strokeStyle] = [2, style("--bad")];
      pen.strokeRect(x - half, y - half, 2 * half, 2 * half);
      return;
    }
    const ink = mark.colour === "ink" ? style("--mark") : mark.colour;
    for (const [wide, colour] of [[5, style("--card")], [2.4, ink]]) {
      [pen.lineWidth, pen.strokeStyle] = [wide, colour];
      stroke(pen, [[x - 6, y - 6], [x + 6, y + 6]]);
      stroke(pen, [[x - 6, y + 6], [x + 6, y - 6]]);
      if (mark.yaw !== null) stroke(pen, [[x, y], [x + 24 * Math.sin(mark.yaw), y - 24 * Math.cos(mark.yaw)]]);
    }
    pen.font = `600 13px ${FONT.slice(FONT.indexOf("system"))}`;
    pen.textAlign = "left";
    [pen.lineWidth, pen.strokeStyle, pen.fillStyle] = [4, style("--card"), ink];
    pen.strokeText(mark.label, x + 9, y + 16);
    pen.fillText(mark.label, x + 9, y + 16);
  }

  cursor() {
    if (!this.whole) return;
    const pen = this.canvas.getContext("2d");
    pen.putImageData(this.whole, 0, 0);
    for (const layer of this.shown) {
      const [x, y] = [layer.x, layer.y].map((values) => valueAt(layer.t, values, this.page.clock.t, 0.3));
      if (x === null || y === null) continue;
      pen.beginPath();
      pen.arc(this.x(x), this.y(y), layer.wide ? 7 : 5, 0, 7);
      pen.fillStyle = layer.colour === "ink" ? style("--ink") : layer.colour;
      pen.globalAlpha = layer.wide ? 0.4 : 1;
      pen.fill();
      pen.globalAlpha = 1;
      [pen.lineWidth, pen.strokeStyle] = [1.5, style("--card")];
      pen.stroke();
    }
  }
}
