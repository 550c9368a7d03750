// The live picture with the estimate's lines over it. A picture is drawn as soon as it is decoded, and the service is told so.
import { $ } from "./elements.js";
import { VideoPictures } from "./video.js";

const INK = { pad: "#f0e442", seen: "#cc79a7", sigma: "#ff6f3c", ahead: "#56b4e9" };
const DASH = { sigma: [4, 3], ahead: [6, 4] };
const OLD_MS = 1000;

export class Picture {
  #canvas = $("picture");
  #note = $("picture-note");
  #send;
  #video;
  #newest = null;
  #at = null;
  #lines = true;
  #camera = [640, 360];

  constructor(send) {
    this.#send = send;
    this.#video = new VideoPictures(
      (header, frame) => this.#take(header, frame),
      (codec) => send({ kind: "picture", codec }),
    );
    new ResizeObserver(() => this.#draw()).observe(this.#canvas);
    setInterval(() => this.#age(), 250);
  }

  // A new connection: the service sends JPEG until it is asked for H.264.
  begin({ camera_px, h264 }) {
    this.#camera = camera_px;
    this.#canvas.parentElement.style.setProperty("--aspect", camera_px.join(" / "));
    this.#video.begin(h264);
  }

  showLines(on) {
    this.#lines = on;
    this.#draw();
  }

  forget() {
    this.#at = null;
    this.#age();
  }

  async show(header, image) {
    if (header.codec !== "jpeg") {
      this.#video.decode(header, image);
      return;
    }
    try {
      this.#take(header, await createImageBitmap(new Blob([image], { type: "image/jpeg" })));
    } catch {
      this.#drawn(header);
    }
  }

  #take(header, bitmap) {
    this.#newest?.bitmap.close();
    this.#newest = { bitmap, header };
    this.#at = performance.now();
    this.#canvas.dataset.codec = header.codec === "jpeg" ? "jpeg" : "h264";
    try {
      this.#draw();
      this.#age();
    } finally {
      this.#drawn(header);
    }
  }

  #drawn(header) {
    this.#send({ kind: "drawn", number: header.number });
  }

  #age() {
    const age = this.#at === null ? null : performance.now() - this.#at;
    this.#note.hidden = age !== null && age < OLD_MS;
    this.#note.textContent = age === null ? (this.#newest ? "this picture is old" : "no picture yet") : `no picture for ${Math.round(age / 1000)} s`;
  }

  #draw() {
    if (this.#newest === null) return;
    const { bitmap, header } = this.#newest;
    const canvas = this.#canvas;
    const scale = devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * scale);
    const height = Math.round(canvas.clientHeight * scale);
    if (width === 0) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const pen = canvas.getContext("2d", { alpha: false });
    pen.drawImage(bitmap, 0, 0, width, height);
    if (!this.#lines) return;
    pen.lineJoin = "round";
    // The centre of pixel 0 sits half a pixel in.
    const k = [width / this.#camera[0], height / this.#camera[1]];
    for (const line of header.lines) {
      const path = new Path2D();
      for (let i = 0; i < line.uv_px.length; i += 2) {
        path[i ? "lineTo" : "moveTo"]((line.uv_px[i] + 0.5) * k[0], (line.uv_px[i + 1] + 0.5) * k[1]);
      }
      const thick = (line.kind === "pad" ? 2 : 1.5) * scale;
      pen.setLineDash([]);
      if (line.kind === "pad") {
        pen.strokeStyle = "rgb(0 0 0 / 0.55)";
        pen.lineWidth = thick + 2 * scale;
        pen.stroke(path);
      }
      pen.setLineDash((DASH[line.kind] ?? []).map((d) => d * scale));
      pen.strokeStyle = INK[line.kind];
      pen.lineWidth = thick;
      pen.stroke(path);
    }
  }
}
