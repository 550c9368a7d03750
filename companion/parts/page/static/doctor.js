// The doctor's findings: asked for by a button, the most severe first, each with its cure.
import { $, part } from "./elements.js";

const LEVELS = { error: "fault", warning: "warning", advice: "info" };

export class Doctor {
  constructor(link) {
    $("examine").addEventListener("click", () => link.ask("examined", { kind: "examine" }));
    link.on("examined", (message) => this.#show(message));
  }

  lost() {
    $("examine").removeAttribute("aria-busy");
  }

  #show({ text, busy, findings }) {
    $("examine").setAttribute("aria-busy", String(busy));
    const at = new Date().toLocaleTimeString();
    $("examined").textContent = busy ? "Examining: this takes some seconds." : findings === null ? text : `${at}: ${text}`;
    if (findings !== null) $("findings").replaceChildren(...findings.map((finding) => this.#line(finding)));
  }

  #line({ rule, severity, what, fix }) {
    const line = part("li", "", { "data-level": LEVELS[severity] });
    const head = part("p", "");
    head.append(part("b", severity), ` ${what} `, part("code", rule));
    line.append(head, part("p", `Cure: ${fix}`, { class: "cure" }));
    return line;
  }
}
