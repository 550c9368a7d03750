// The buttons, the slide that cuts the motors, and the answers of the service.
const ANSWER_MS = 3000;
const KNOB_PX = 62;
const CONFIRMED = 0.95;
const NAMES = {
  takeoff: "Take off", begin: "Begin landing", stay: "Stay over the pad", hold: "Hold", land: "Land here", abort: "Abort", emergency: "Emergency",
  clear: "Call the pad clear", reset: "Leave the emergency state", manual: "Fly by hand", release: "Give the hand back",
};

export class Orders {
  #link;
  #number = 0;
  #waiting = new Map();
  #buttons = [...document.querySelectorAll("[data-order]")];
  #begin = document.querySelector('[data-order="begin"]');
  #answer = document.getElementById("answer");
  #slide;

  constructor(link) {
    this.#link = link;
    for (const button of this.#buttons) button.addEventListener("click", () => this.give(button.dataset.order, button));
    this.#slide = new Slide(document.getElementById("emergency"), () => this.give("emergency"));
    this.enable(false);
  }

  // An order that is likely to be refused is given all the same: the service's answer says why.
  give(order, button = null) {
    const number = ++this.#number;
    if (!this.#link.send({ kind: "order", number, order })) {
      this.#tell("fault", `${NAMES[order]}: not sent, the connection is lost`);
      return;
    }
    button?.setAttribute("aria-busy", "true");
    this.#tell("", `${NAMES[order]}: sent`);
    const late = setTimeout(() => this.#settle(number, "fault", "no answer"), ANSWER_MS);
    this.#waiting.set(number, { order, button, late });
  }

  answered(message) {
    this.#settle(message.number, message.accepted ? "info" : "fault", message.text);
  }

  enable(on) {
    if (!on) {
      for (const button of this.#buttons) button.setAttribute("aria-disabled", "true");
      for (const number of [...this.#waiting.keys()]) this.#settle(number, "fault", "no answer, the connection is lost");
    }
    this.#slide.enable(on);
  }

  state(message) {
    for (const button of this.#buttons) {
      const why = message.refusals[button.dataset.order];
      button.setAttribute("aria-disabled", String(why !== null));
      button.title = why ?? "";
    }
    this.#begin.classList.toggle("primary", !message.landing);
    document.getElementById("reset").hidden = message.situation !== "emergency";
    document.getElementById("emergency").hidden = message.situation === "emergency";
  }

  #settle(number, level, text) {
    const waiting = this.#waiting.get(number);
    if (waiting === undefined) return;
    this.#waiting.delete(number);
    clearTimeout(waiting.late);
    waiting.button?.removeAttribute("aria-busy");
    this.#tell(level, `${NAMES[waiting.order]}: ${text}`);
  }

  #tell(level, text) {
    this.#answer.dataset.level = level;
    this.#answer.textContent = text;
  }
}

// It confirms only at its end: a tap, a slip or one key does nothing, and letting go before the end goes back.
class Slide {
  #element;
  #confirmed;
  #from = null;
  #at = 0;
  #on = false;

  constructor(element, confirmed) {
    this.#element = element;
    this.#confirmed = confirmed;
    const knob = element.querySelector(".knob");
    knob.addEventListener("pointerdown", (event) => {
      if (!this.#on) return;
      knob.setPointerCapture(event.pointerId);
      this.#from = event.clientX;
    });
    knob.addEventListener("pointermove", (event) => {
      if (this.#from !== null) this.#move((event.clientX - this.#from) / (element.clientWidth - KNOB_PX));
    });
    knob.addEventListener("pointerup", () => this.#let());
    knob.addEventListener("pointercancel", () => this.#back());
    element.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 0.1, ArrowUp: 0.1, ArrowLeft: -0.1, ArrowDown: -0.1 }[event.key];
      if (step === undefined || !this.#on || event.repeat) return;
      event.preventDefault();
      this.#move(this.#at + step);
      if (this.#at >= CONFIRMED) this.#let();
    });
    element.addEventListener("blur", () => this.#back());
  }

  enable(on) {
    this.#on = on;
    this.#element.setAttribute("aria-disabled", String(!on));
    this.#back();
  }

  #move(at) {
    this.#element.classList.remove("back");
    this.#at = Math.min(1, Math.max(0, at));
    this.#show();
  }

  #let() {
    if (this.#at >= CONFIRMED && this.#on) this.#confirmed();
    this.#back();
  }

  #back() {
    this.#from = null;
    this.#at = 0;
    this.#element.classList.add("back");
    this.#show();
  }

  #show() {
    this.#element.style.setProperty("--at", String(this.#at));
    const percent = Math.round(100 * this.#at);
    this.#element.setAttribute("aria-valuenow", String(percent));
    this.#element.setAttribute("aria-valuetext", percent ? `${percent} percent of the way to cutting the motors` : "not confirmed");
  }
}
