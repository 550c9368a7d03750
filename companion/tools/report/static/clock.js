// The cursor and the span in sight: one of each, for every plot, view and video of the page.

class Clock {
  constructor([begin, end]) {
    [this.begin, this.end] = [begin, end];
    this.t = begin;
    this.view = [begin, end];
    this.playing = false;
    this.rate = 1;
    this.videos = [];
    this.listeners = { cursor: [], view: [], play: [] };
    this.last = 0;
  }

  on(what, listener) {
    this.listeners[what].push(listener);
  }

  tell(what) {
    for (const listener of this.listeners[what]) listener();
  }

  // Move the cursor, as a person does: the videos follow.
  seek(t) {
    this.t = clamp(t, this.begin, this.end);
    for (const video of this.videos) video.follow(this.t);
    this.tell("cursor");
  }

  show(low, high) {
    const least = Math.max(0.05, (this.end - this.begin) / 2000);
    const wide = clamp(high - low, least, this.end - this.begin);
    const from = clamp((low + high - wide) / 2, this.begin, this.end - wide);
    this.view = [from, from + wide];
    this.tell("view");
  }

  zoom(factor, around = this.t) {
    const [low, high] = this.view;
    this.show(around + (low - around) * factor, around + (high - around) * factor);
  }

  pan(share) {
    const [low, high] = this.view;
    this.show(low + share * (high - low), high + share * (high - low));
  }

  whole() {
    this.show(this.begin, this.end);
  }

  get zoomed() {
    return this.view[1] - this.view[0] < 0.999 * (this.end - this.begin);
  }

  play(on = !this.playing) {
    if (on === this.playing) return;
    this.playing = on;
    if (on && this.t >= this.end - 0.01) this.seek(this.begin);
    for (const video of this.videos) video.play(on, this.t, this.rate);
    // Each stops where it is; paused, all show the cursor's instant.
    if (!on) this.seek(this.t);
    this.tell("play");
    this.last = performance.now();
    if (on) requestAnimationFrame((now) => this.step(now));
  }

  hurry(rate) {
    this.rate = rate;
    for (const video of this.videos) video.element.playbackRate = rate;
  }

  // The first video that runs gives the time; where none does, the cursor runs by itself.
  step(now) {
    if (!this.playing) return;
    const leader = this.videos.find((video) => video.runs);
    const free = this.t + Math.max(0, now - this.last) * 1e-3 * this.rate;
    const t = leader ? leader.now : free;
    this.last = now;
    this.t = Math.min(t, this.end);
    for (const video of this.videos) if (video !== leader) video.keep(this.t, this.rate);
    this.tell("cursor");
    if (this.t >= this.end) this.play(false);
    else requestAnimationFrame((next) => this.step(next));
  }
}
