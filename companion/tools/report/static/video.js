// A video that follows the cursor, and leads it while it plays. Its bytes stand in the page.

const KEPT_WITHIN_S = 0.15;

class FlightFilm {
  constructor(element, from) {
    this.element = element;
    this.from = from;
    this.wanted = null;
    const text = document.getElementById(element.dataset.bytes).textContent;
    const bytes = Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));
    element.src = URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
    // One seek at a time: a dragged cursor asks faster than a frame is decoded.
    element.addEventListener("seeked", () => this.settle());
    element.addEventListener("loadedmetadata", () => this.settle());
  }

  get to() {
    return this.from + (this.element.duration || 0);
  }

  get now() {
    return this.from + this.element.currentTime;
  }

  get runs() {
    const e = this.element;
    return !e.paused && !e.ended && !e.seeking && e.readyState > 2;
  }

  covers(t) {
    return t >= this.from && t < this.to - 0.02;
  }

  follow(t) {
    this.wanted = Math.max(0, t - this.from);
    this.settle();
  }

  settle() {
    const e = this.element;
    if (this.wanted === null || e.seeking || !(e.duration > 0)) return;
    const to = Math.min(this.wanted, e.duration);
    this.wanted = null;
    if (Math.abs(e.currentTime - to) > 1e-3) e.currentTime = to;
  }

  play(on, t, rate) {
    const e = this.element;
    e.playbackRate = rate;
    if (on && this.covers(t)) e.play().catch(() => {});
    else e.pause();
  }

  // While another leads: begin when its time has come, and do not drift.
  keep(t, rate) {
    const e = this.element;
    if (!this.covers(t)) {
      if (!e.paused) e.pause();
      return;
    }
    if (!e.seeking && Math.abs(this.now - t) > KEPT_WITHIN_S) this.follow(t);
    if (e.paused) this.play(true, t, rate);
  }
}
