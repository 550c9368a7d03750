// Flight by hand: touch, keyboard or gamepad. Positions leave 20 times a second while this page has the hand; when they stop
// (a hidden tab, a lost link) the service holds.
import { $, part, words, write } from "./elements.js";

const EACH_MS = 50;
const DEAD = 0.1;
const ASKED_MS = 1000; // the sticks leave before the state says who has the hand: the service waits for them half a second
const NOTE = "Sticks on the picture, keys W A S D and arrows, or a gamepad. Letting go hovers.";
// The sticks of the thesis: left for height and turning, right for forward and sideways.
const KEYS = {
  KeyW: ["climb", 1], KeyS: ["climb", -1], KeyA: ["turn", -1], KeyD: ["turn", 1],
  ArrowUp: ["forward", 1], ArrowDown: ["forward", -1], ArrowLeft: ["right", -1], ArrowRight: ["right", 1],
};
const AXES = ["forward", "right", "climb", "turn"];
const TYPES = "textarea, input:not([type=checkbox])"; // there a key writes a letter

const typing = () => document.activeElement?.matches(TYPES) === true;

export class Sticks {
  #link;
  #orders;
  #taken = "";
  #host = $("sticks");
  #button = $("by-hand");
  #note = $("hand-note");
  #pads = [new Pad(this.#host, "Height and turning", "turn", "climb"), new Pad(this.#host, "Sideways and forward", "right", "forward")];
  #pressed = new Set();
  #yours = false;
  #asked = -ASKED_MS;

  constructor(link, orders) {
    this.#link = link;
    this.#orders = orders;
    this.#button.addEventListener("click", () => {
      this.#asked = this.#yours ? -ASKED_MS : performance.now();
      orders.give(this.#yours ? "release" : "manual", this.#button);
    });
    // Before any other part of the page: a key that flies does nothing else.
    addEventListener("keydown", (event) => this.#down(event), true);
    addEventListener("keyup", ({ code }) => this.#pressed.delete(code), true);
    // A key may be let go where nothing reports it; one that is still held repeats.
    for (const change of ["blur", "focusin", "visibilitychange"]) addEventListener(change, () => this.#pressed.clear());
    setInterval(() => this.#send(), EACH_MS);
  }

  state(message) {
    if (message.yours && !this.#yours) this.#host.parentElement.scrollIntoView({ block: "nearest" });
    if (message.yours !== this.#yours) this.#freeSlide();
    this.#yours = message.yours;
    this.#host.hidden = !message.yours;
    this.#button.setAttribute("aria-pressed", String(message.yours));
    write("by-hand", words.orders[message.yours ? "release" : "manual"]);
    const why = message.refusals[message.yours ? "release" : "manual"];
    this.#button.setAttribute("aria-disabled", String(why !== null));
    this.#button.title = why ?? "";
    if (!message.yours) this.#centre();
    if (message.hand_taken === this.#taken) return;
    this.#taken = message.hand_taken;
    const link_s = this.#orders.round_s.toFixed(1);
    const late = link_s > ASKED_MS / 2000 && this.#taken.startsWith("nothing received");
    const slow = late ? `your link is too slow to fly by hand (${link_s} s)` : "ended";
    if (this.#taken) this.#orders.tell("fault", `${words.orders.manual}: ${slow}: ${this.#taken}`);
  }

  lost() {
    if (this.#yours) this.#freeSlide();
    this.#yours = false;
    this.#host.hidden = true;
    this.#button.setAttribute("aria-disabled", "true");
    this.#centre();
  }

  #centre() {
    this.#pressed.clear();
    for (const pad of this.#pads) pad.centre();
  }

  // A key that flew a moment ago, or flies from now on, must not find a slide.
  #freeSlide() {
    if (document.activeElement?.matches("[role=slider]")) document.activeElement.blur();
  }

  #down(event) {
    if (!this.#yours || !(event.code in KEYS) || typing()) return;
    event.preventDefault();
    event.stopPropagation();
    this.#pressed.add(event.code);
  }

  #send() {
    $("keys-off").hidden = !this.#yours || !typing();
    const flies = this.#yours || performance.now() - this.#asked < ASKED_MS;
    if (!flies || document.hidden) return;
    const sum = Object.fromEntries(AXES.map((axis) => [axis, 0]));
    for (const code of this.#pressed) sum[KEYS[code][0]] += KEYS[code][1];
    for (const pad of this.#pads) for (const [axis, value] of pad.positions) sum[axis] += value;
    const gamepad = [...(navigator.getGamepads?.() ?? [])].find((one) => one?.connected && one.mapping === "standard");
    if (gamepad) {
      const [x, y, u, v] = gamepad.axes.map((value) => (Math.abs(value) < DEAD ? 0 : (value - Math.sign(value) * DEAD) / (1 - DEAD)));
      for (const [axis, value] of [["turn", x], ["climb", -y], ["right", u], ["forward", -v]]) sum[axis] += value;
    }
    this.#note.textContent = gamepad ? `Gamepad: ${gamepad.id}` : NOTE;
    for (const axis of AXES) sum[axis] = Math.min(1, Math.max(-1, sum[axis]));
    this.#link.send({ kind: "sticks", ...sum });
  }
}

class Pad {
  #knob;
  #axes;
  #at = [0, 0];

  constructor(host, name, horizontal, vertical) {
    this.#axes = [horizontal, vertical];
    const pad = part("div", "", { class: "stick", role: "img", "aria-label": `${name}: touch and drag; or use the keyboard` });
    this.#knob = part("span", "");
    pad.append(this.#knob);
    host.append(pad);
    let box; // where the stick was when it was touched: what changes above moves it, and the thumb stays
    const move = (event) => {
      const reach = box.width * 0.36;
      const [x, y] = [(event.clientX - box.x - box.width / 2) / reach, (event.clientY - box.y - box.height / 2) / reach];
      const far = Math.max(1, Math.hypot(x, y));
      this.#at = [x / far, -y / far];
      this.#show();
    };
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      box = pad.getBoundingClientRect();
      move(event);
    });
    pad.addEventListener("pointermove", (event) => pad.hasPointerCapture(event.pointerId) && move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(end, () => this.centre());
  }

  get positions() {
    return this.#axes.map((axis, i) => [axis, Math.abs(this.#at[i]) < DEAD ? 0 : this.#at[i]]);
  }

  centre() {
    this.#at = [0, 0];
    this.#show();
  }

  #show() {
    this.#knob.style.transform = `translate(${this.#at[0] * 90}%, ${-this.#at[1] * 90}%)`;
  }
}
