// The settings: what is in force, and a copy to edit that the service checks while it is typed; saved on the ground alone.
import { $, part } from "./elements.js";

const CHECK_MS = 400;
const ANSWER_MS = 8000;

export class SettingsEditor {
  #link;
  #number = 0;
  #waiting = null;
  #again = false;
  #timer = 0;
  #late = 0;
  #shown = null;
  #good = false;

  constructor(link) {
    this.#link = link;
    $("show-settings").addEventListener("click", () => this.#load());
    $("settings-text").addEventListener("input", () => this.#typed());
    $("save-settings").addEventListener("click", () => this.#save());
    $("download-settings").addEventListener("click", () => this.#download());
    link.on("settings", (message) => this.#show(message));
    link.on("checked", (message) => this.#checked(message));
    link.on("saved", (message) => this.#saved(message));
  }

  lost() {
    this.#waiting = null;
    if (this.#shown !== null) this.#tell("fault", "The connection is lost; the text is kept here, and not checked.");
  }

  // After a loss the text that a person typed stays, and is checked again.
  back() {
    if (this.#shown !== null) this.#check();
  }

  #load() {
    const edited = this.#shown !== null && $("settings-text").value !== this.#shown.text;
    if (edited && !confirm("Drop what you have changed here and load the settings again?")) return;
    if (!this.#link.send({ kind: "settings" })) this.#tell("fault", "not sent, the connection is lost");
  }

  #show(message) {
    this.#shown = message;
    $("settings-text").value = message.text;
    $("in-force").textContent = message.in_force;
    $("settings-path").textContent = message.path ? `Settings file ${message.path}` : "Settings of this run";
    $("settings-editor").hidden = false;
    $("show-settings").textContent = "Load again";
    const cure = message.path ? ` Download the text, put it to ${message.path} on the drone's computer, and start the service again.` : " Download the text and start the service with --config FILE.";
    $("settings-refusal").textContent = message.refusal ? `Cannot be saved from here: ${message.refusal}.${cure}` : "";
    $("settings-refusal").hidden = !message.refusal;
    $("save-settings").hidden = Boolean(message.refusal);
    this.#check();
  }

  #typed() {
    this.#good = false;
    this.#offer();
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#check(), CHECK_MS);
  }

  // One check at a time: the next begins when the answer to the last is here.
  #check() {
    if (this.#waiting !== null) {
      this.#again = true;
      return;
    }
    const number = ++this.#number;
    if (!this.#link.send({ kind: "check_settings", number, text: $("settings-text").value })) return;
    this.#waiting = number;
    clearTimeout(this.#late);
    this.#late = setTimeout(() => this.#settled(number), ANSWER_MS);
  }

  #settled(number) {
    if (this.#waiting !== number) return;
    this.#waiting = null;
    clearTimeout(this.#late);
    if (!this.#again) return;
    this.#again = false;
    this.#check();
  }

  #checked({ number, text, faults, changes, remarks }) {
    const current = this.#waiting === number && !this.#again;
    this.#settled(number);
    if (!current) return;
    this.#good = !text && faults.length === 0;
    const count = faults.length === 1 ? "1 fault" : `${faults.length} faults`;
    const next = changes.length ? `${changes.length === 1 ? "1 key differs" : `${changes.length} keys differ`} from what is in force` : "it is what is in force";
    this.#tell(text ? "" : faults.length ? "fault" : "info", text || (faults.length ? count : `No fault; ${next}.`));
    $("settings-faults").replaceChildren(...faults.map((fault) => this.#fault(fault)), ...remarks.map((remark) => this.#remark(remark)));
    $("settings-changes").replaceChildren(...changes.map((change) => this.#change(change)));
    $("settings-next").hidden = changes.length === 0;
    $("settings-text").setAttribute("aria-invalid", String(faults.length > 0));
    this.#offer();
  }

  #fault({ text, line }) {
    const item = part("li", "");
    item.dataset.level = "fault";
    item.append(part("span", text));
    if (line !== null) {
      const go = part("button", `line ${line}`, "order small");
      go.type = "button";
      go.setAttribute("aria-label", `Go to line ${line}`);
      go.addEventListener("click", () => this.#go(line));
      item.prepend(go);
    }
    return item;
  }

  #remark(text) {
    const item = part("li", text);
    item.dataset.level = "warning";
    return item;
  }

  #change({ path, before, after }) {
    const item = part("li", "");
    item.append(part("code", path), ` ${before || "none"} → ${after || "none"}`);
    return item;
  }

  #go(line) {
    const area = $("settings-text");
    const lines = area.value.split("\n");
    const start = lines.slice(0, line - 1).reduce((sum, one) => sum + one.length + 1, 0);
    area.focus();
    area.setSelectionRange(start, start + lines[line - 1].length);
    area.scrollTop = (area.scrollHeight / lines.length) * Math.max(0, line - 4);
  }

  #offer() {
    const same = $("settings-text").value === this.#shown.text;
    $("save-settings").setAttribute("aria-disabled", String(!this.#good || same));
    $("save-settings").title = same ? "nothing was changed" : this.#good ? "" : "the text has a fault or is not checked yet";
  }

  #save() {
    if ($("save-settings").getAttribute("aria-disabled") === "true") {
      this.#tell("fault", `Not saved: ${$("save-settings").title}.`);
      return;
    }
    const sent = { kind: "save_settings", number: ++this.#number, text: $("settings-text").value, revision: this.#shown.revision };
    this.#tell("", this.#link.send(sent) ? "Saving" : "not sent, the connection is lost");
    this.#shown = { ...this.#shown, sent: sent.text };
  }

  #saved({ saved, text, revision }) {
    this.#tell(saved ? "info" : "fault", text);
    if (!saved) return;
    this.#shown = { ...this.#shown, text: this.#shown.sent, revision };
    this.#offer();
  }

  #download() {
    const anchor = document.createElement("a");
    anchor.href = URL.createObjectURL(new Blob([$("settings-text").value], { type: "application/toml" }));
    anchor.download = this.#shown.path.split("/").pop() || "settings.toml";
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(anchor.href), 1000);
    const hidden = anchor.download && $("settings-text").value.includes("***") ? " Where it has *** write the user and password again." : "";
    this.#tell("", `${anchor.download} is downloaded.${hidden}`);
  }

  #tell(level, text) {
    $("settings-note").dataset.level = level;
    $("settings-note").textContent = text;
  }
}
