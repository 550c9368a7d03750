// The buttons, the slides that confirm what cannot be taken back, and the answers of the service.
import { alarm } from "./alarms.js";
import { chip, words, write } from "./elements.js";

const ANSWER_MS = 3000;
const SHOWN_MS = { info: 10_000, warning: 30_000, fault: 30_000 };
const KNOB_PX = 62;
const CONFIRMED = 0.95;
const EMPTIES_MS = 5000; // from a slide's newest key
// Orders that leave over a silent connection too: what is seen of the drone itself counts for them, and not the screen.
const STOPS = ["hold", "abort", "emergency"];
// Orders that are kept while the page is out of touch, until it is back or closed: a stop stays one, however late.
const KEPT = ["hold", "abort"];
// Orders that a slide confirms; it says what comes of them.
const ASKS = {
  land: { verb: "to land here", says: ({ flying, below }) => (flying === false ? "It stands already." : `Lands ${below}.`) },
  clear: { verb: "to land although it is there", says: ({ bars }) => `Ignores for a minute, in this attempt alone: ${bars}.` },
  takeoff: { verb: "to take off", says: ({ flying }) => (flying ? "Stops the landing and hovers." : "The propellers start.") },
  reset: {
    verb: "to leave the emergency state",
    says: ({ situation }) => (situation === "cutting" ? "The cut is not confirmed, and is then sent no more." : "The motors stay off."),
  },
};

export class Orders {
  #link;
  #number = 0;
  #waiting = new Map();
  #buttons = [...document.querySelectorAll("[data-order]")];
  #begin = document.querySelector('[data-order="begin"]');
  #answer = document.getElementById("answer");
  #state = null;
  #kept = null; // the newest of `KEPT` that did not leave, or was not answered: then with what was seen when it left
  #cutting = false; // the motors are to be cut
  #passing = false; // the answer that is shown is of a connection that is lost or silent
  #fades; // takes the answer away that is shown
  round_s = 0; // from the newest order until its answer
  #fit = false; // nothing is missing or wrong that a landing needs
  #asked = null; // the button whose order waits for its slide
  #asks = document.getElementById("asks");
  #slide;
  #confirm;

  constructor(link) {
    this.#link = link;
    for (const button of this.#buttons) button.addEventListener("click", () => this.#press(button));
    this.#slide = new Slide(document.getElementById("emergency"), "to cut the motors", () => this.give("emergency"));
    this.#confirm = new Slide(document.getElementById("confirm"), "", () => this.give(this.#asked.dataset.order, this.#asked));
    addEventListener("keydown", (event) => event.key === "Escape" && this.#ask(null), true);
    this.enable(false);
  }

  #press(button) {
    const { order } = button.dataset;
    const why = this.#state?.refusals[order];
    if (!(order in ASKS) || this.#state === null) this.give(order, button);
    else if (why) this.tell("fault", `${words.orders[order]}: refused: ${why}`);
    else this.#ask(this.#asked === button ? null : button);
  }

  // Opens the slide of an order; any other order, Escape or a second press closes it.
  #ask(button) {
    const by = this.#asked;
    this.#asked?.setAttribute("aria-expanded", "false");
    this.#asked = button;
    this.#asks.hidden = button === null;
    if (button === null) {
      if (this.#asks.contains(document.activeElement)) by.focus();
      return;
    }
    button.setAttribute("aria-expanded", "true");
    this.#confirm.name(ASKS[button.dataset.order].verb);
    this.#say();
    this.tell("", "");
    if (!this.#state.yours) document.getElementById("confirm").focus(); // the arrow keys fly
  }

  #say() {
    write("asks-says", ASKS[this.#asked.dataset.order].says(this.#state));
  }

  // An order that is likely to be refused is given all the same: the service's answer says why.
  give(order, button = null) {
    this.#ask(null);
    const number = ++this.#number;
    if (!this.#link.send({ kind: "order", number, order, seen_at_s: this.#state?.at_s }, !STOPS.includes(order))) {
      this.#unsent({ order, seen_s: Infinity }, `not sent, the connection is ${this.#link.live ? "silent" : "lost"}`);
      return;
    }
    this.#kept = null;
    button?.setAttribute("aria-busy", "true");
    this.tell("", `${words.orders[order]}: sent`);
    const late = setTimeout(() => this.settle(number, "fault", "no answer"), ANSWER_MS);
    this.#waiting.set(number, { order, button, late, at: performance.now(), seen_s: this.#state?.at_s ?? 0 });
  }

  // Shows the orders of a connection, and a notice of it; off when it is lost.
  enable(on, notice = "") {
    if (notice || (!on && this.#state !== null && this.#answer.dataset.level !== "fault")) this.tell("warning", notice);
    document.getElementById("emergency").setAttribute("aria-disabled", String(!on));
    if (on) {
      for (const button of this.#buttons) button.textContent = words.orders[button.dataset.order];
    } else {
      for (const button of this.#buttons) button.setAttribute("aria-disabled", String(!KEPT.includes(button.dataset.order)));
      for (const number of [...this.#waiting.keys()]) this.#unsent(this.#take(number), "no answer, the connection is lost");
      this.#ask(null);
      [this.#state, this.#fit] = [null, false];
    }
  }

  // One that left after the state of `seen_s` may have arrived: the events of the next connection say so.
  #unsent({ order, seen_s }, why) {
    const keeps = KEPT.includes(order);
    if (keeps) this.#kept = { order, seen_s };
    const says = keeps ? [] : [`${words.orders[order]}: ${why}`];
    const will = this.#kept?.seen_s === Infinity ? "will be sent" : "no answer; will be sent again, if it did not arrive,";
    if (this.#kept !== null) says.push(`${words.orders[this.#kept.order]}: ${will} when the connection is back`);
    this.tell(keeps ? "warning" : "fault", says.join(". "));
    this.#passing = true;
  }

  // What is ordered by others makes an answer old; a connection begins with the newest events.
  event({ at_s, text }) {
    if (this.#state !== null && text.startsWith("you: ") && text.includes("not obeyed")) this.tell("fault", text.slice(5));
    const stop = STOPS.find((order) => text.includes(`: ${words.orders[order]}: accepted`));
    if (this.#state !== null && stop && !text.startsWith("you: ")) {
      this.tell("warning", `${text.split(": ")[0]} ordered: ${words.orders[stop]}`);
      alarm("stopped");
    }
    if (!text.endsWith(": accepted")) return;
    if (this.#kept !== null && at_s >= this.#kept.seen_s && text.endsWith(`: ${words.orders[this.#kept.order]}: accepted`)) {
      this.tell("info", `${words.orders[this.#kept.order]}: obeyed`);
      this.#kept = null;
    } else if (!text.startsWith("you") && this.#answer.dataset.level === "info") this.tell("", "");
  }

  // The first health of a connection follows its events.
  health(message) {
    if (this.#kept !== null) this.give(this.#kept.order);
    this.#fit = message.causes.every(({ level }) => level === "info");
  }

  state(message) {
    if (this.#cutting && message.situation === "emergency") this.tell("info", `${words.orders.emergency}: obeyed`);
    this.#cutting = message.situation === "cutting";
    this.#state = message;
    // That an order was not sent stays for a while, also when the connection is back at once.
    if (this.#passing) this.tell(...(this.#answer.dataset.level === "fault" ? ["fault", this.#answer.textContent, true] : ["", ""]));
    const asked = this.#asked?.dataset.order;
    if (message.refusals[asked]) {
      this.#ask(null);
      this.tell("warning", `${words.orders[asked]}: not given: ${message.refusals[asked]}`);
    } else if (asked) this.#say();
    for (const button of this.#buttons) {
      const why = message.refusals[button.dataset.order];
      button.setAttribute("aria-disabled", String(why !== null));
      button.title = why ?? "";
    }
    this.#begin.classList.toggle("primary", this.#fit && !message.landing);
    document.getElementById("reset").hidden = !["cutting", "emergency"].includes(message.situation);
    document.getElementById("emergency").classList.toggle("done", message.situation === "emergency"); // its place stays
  }

  #take(number) {
    const waiting = this.#waiting.get(number);
    this.#waiting.delete(number);
    clearTimeout(waiting?.late);
    waiting?.button?.removeAttribute("aria-busy");
    return waiting;
  }

  settle(number, level, text) {
    const waiting = this.#take(number);
    if (waiting === undefined) return;
    this.#cutting ||= level === "info" && waiting.order === "emergency";
    this.round_s = (performance.now() - waiting.at) / 1000;
    this.tell(level === "info" && waiting.order === "emergency" ? "warning" : level, `${words.orders[waiting.order]}: ${text}`);
  }

  tell(level, text, again = false) {
    this.#passing = false;
    clearTimeout(this.#fades);
    if (level in SHOWN_MS) this.#fades = setTimeout(() => this.#passing || this.tell("", ""), SHOWN_MS[level]);
    chip(this.#answer, level, text);
    if (level === "fault" && !again) alarm("refused");
  }
}

// It confirms only at its end: a tap, a slip or one key does nothing, and letting go before the end goes back. A pointer never
// leaves the focus with it: the next arrow key may be meant for the drone.
class Slide {
  #element;
  #verb;
  #confirmed;
  #from = null;
  #at = 0;
  #empties;

  constructor(element, verb, confirmed) {
    this.#element = element;
    this.name(verb);
    this.#confirmed = confirmed;
    const knob = element.querySelector(".knob");
    knob.addEventListener("pointerdown", (event) => {
      knob.setPointerCapture(event.pointerId);
      this.#from = event.clientX;
    });
    knob.addEventListener("pointermove", (event) => {
      if (this.#from !== null) this.#move((event.clientX - this.#from) / (element.clientWidth - KNOB_PX));
    });
    knob.addEventListener("pointerup", () => this.#let());
    knob.addEventListener("pointercancel", () => this.#back());
    element.addEventListener("pointerup", () => element.blur());
    element.addEventListener("mousedown", (event) => event.preventDefault());
    element.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.#back();
      const step = { ArrowRight: 0.1, ArrowUp: 0.1, ArrowLeft: -0.1, ArrowDown: -0.1 }[event.key];
      if (step === undefined || event.repeat) return;
      event.preventDefault();
      this.#move(this.#at + step);
      clearTimeout(this.#empties);
      this.#empties = setTimeout(() => this.#back(), EMPTIES_MS);
      if (this.#at >= CONFIRMED) this.#let();
    });
    element.addEventListener("blur", () => this.#back());
  }

  name(verb) {
    this.#verb = verb;
    this.#element.querySelector(".text").textContent = `Slide ${verb}`;
    this.#element.setAttribute("aria-label", `Slide to the end ${verb}, or press the right arrow ten times.`);
  }

  #move(at) {
    this.#element.classList.remove("back");
    this.#at = Math.min(1, Math.max(0, at));
    this.#show();
  }

  #let() {
    if (this.#at >= CONFIRMED) this.#confirmed();
    this.#back();
  }

  #back() {
    clearTimeout(this.#empties);
    this.#from = null;
    this.#at = 0;
    this.#element.classList.add("back");
    this.#show();
    this.#element.blur();
  }

  #show() {
    this.#element.style.setProperty("--at", String(this.#at));
    const percent = Math.round(100 * this.#at);
    this.#element.setAttribute("aria-valuenow", String(percent));
    this.#element.setAttribute("aria-valuetext", percent ? `${percent} percent of the way ${this.#verb}` : "not confirmed");
  }
}
