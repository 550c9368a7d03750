// The recordings on the drone's computer: a list, a download by an address that holds once, and the report of a flight.
import { $, part } from "./elements.js";

export class RecordingsList {
  #link;
  #reports = new Map();
  #files = [];

  constructor(link) {
    this.#link = link;
    $("list-recordings").addEventListener("click", () => link.ask("recordings-note", { kind: "recordings" }));
    link.on("recordings", ({ files, fault }) => this.#show(files, fault));
    link.on("download", (message) => this.#load(message));
    link.on("report", (message) => this.#report(message));
  }

  #show(files, fault) {
    this.#files = files;
    this.#draw(fault || (files.length ? "" : "there are none"));
  }

  #draw(note) {
    $("recordings-note").textContent = note;
    $("recordings").replaceChildren(...this.#files.map((file) => this.#line(file)));
  }

  #line({ name, size_bytes, unix_s }) {
    const line = part("li", "");
    const size = size_bytes < 1e6 ? `${(size_bytes / 1e3).toFixed(0)} kB` : `${(size_bytes / 1e6).toFixed(1)} MB`;
    const about = part("span", `${new Date(1000 * unix_s).toLocaleString()} · ${size}`, { title: name });
    line.append(about, this.#opening(name), this.#button("Download", name, "download"));
    return line;
  }

  #opening(name) {
    const href = this.#reports.get(name);
    if (href === undefined) return this.#button("Report", name, "report");
    const label = `Open the report of ${name}`;
    return part("a", "Open report", { class: "order small", href, target: "_blank", rel: "noopener", "aria-label": label });
  }

  #button(words, name, kind) {
    const button = part("button", words, { type: "button", class: "order small", "aria-label": `${words} ${name}` });
    button.addEventListener("click", () => this.#link.ask("recordings-note", { kind, name }));
    return button;
  }

  #load({ name, address, text }) {
    $("recordings-note").textContent = address === null ? `${name}: ${text}` : `${name}: loading`;
    if (address !== null) part("a", "", { href: address, download: name }).click();
  }

  #report({ name, address, text }) {
    if (address !== null) this.#reports.set(name, address);
    this.#draw(address === null ? `${name}: the report ${text}` : `${name}: the report is ready`);
  }
}
