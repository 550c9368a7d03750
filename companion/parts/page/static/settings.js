// The settings: what is in force, and the settings file to edit, which the service checks and saves on the ground alone.
import { $, chip } from "./elements.js";

export class SettingsEditor {
  #link;
  #shown = null;
  #sent = "";

  constructor(link) {
    this.#link = link;
    $("show-settings").addEventListener("click", () => this.#load());
    $("save-settings").addEventListener("click", () => this.#save());
    link.on("settings", (message) => this.#show(message));
    link.on("saved", (message) => this.#saved(message));
  }

  #load() {
    const edited = this.#shown !== null && $("settings-text").value !== this.#shown.text;
    if (edited && !confirm("Drop what you have changed here and load the settings again?")) return;
    this.#link.ask("settings-note", { kind: "settings" });
  }

  #show(message) {
    this.#shown = message;
    $("settings-text").value = message.text;
    $("in-force").textContent = message.in_force;
    $("settings-path").textContent = message.path ? `Settings file ${message.path}` : "Settings of this run";
    $("settings-editor").hidden = false;
    $("show-settings").textContent = "Load again";
    $("settings-refusal").textContent = message.refusal ? `Cannot be saved from here: ${message.refusal}.` : "";
    $("settings-refusal").hidden = !message.refusal;
    $("save-settings").hidden = Boolean(message.refusal);
    chip($("settings-note"), "", "");
  }

  #save() {
    this.#sent = $("settings-text").value;
    this.#link.ask("settings-note", { kind: "save_settings", text: this.#sent, revision: this.#shown.revision }, "Saving");
  }

  #saved({ saved, text, line, revision }) {
    chip($("settings-note"), saved ? "info" : "fault", line === null ? text : `Line ${line}: ${text}`);
    $("settings-text").setAttribute("aria-invalid", String(!saved));
    if (saved) this.#shown = { ...this.#shown, text: this.#sent, revision };
    if (line !== null) this.#select(line);
  }

  #select(line) {
    const area = $("settings-text");
    const lines = area.value.split("\n");
    const start = lines.slice(0, line - 1).reduce((sum, one) => sum + one.length + 1, 0);
    area.focus();
    area.setSelectionRange(start, start + lines[line - 1].length);
    area.scrollTop = (area.scrollHeight / lines.length) * Math.max(0, line - 4);
  }
}
