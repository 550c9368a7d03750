// The recordings on the drone's computer: a list, a download by an address that holds once, and the report of a flight.
import { $ } from "./elements.js";

export class RecordingsList {
  #link;
  #reports = new Map();
  #files = [];

  constructor(link) {
    this.#link = link;
    $("list-recordings").addEventListener("click", () => this.#ask({ kind: "recordings" }));
    link.on("recordings", ({ files, fault }) => this.#show(files, fault));
    link.on("download", (message) => this.#load(message));
    link.on("report", (message) => this.#report(message));
  }

  #ask(request) {
    $("recordings-note").textContent = this.#link.send(request) ? "" : "not sent, the connection is lost";
  }

  #show(files, fault) {
    this.#files = files;
    $("recordings-note").textContent = fault || (files.length ? "" : "there are none");
    this.#draw();
  }

  #draw() {
    $("recordings").replaceChildren(...this.#files.map((file) => this.#line(file)));
  }

  #line({ name, size_bytes, unix_s }) {
    const line = document.createElement("li");
    const about = document.createElement("span");
    const size = size_bytes < 1e6 ? `${(size_bytes / 1e3).toFixed(0)} kB` : `${(size_bytes / 1e6).toFixed(1)} MB`;
    about.textContent = `${new Date(1000 * unix_s).toLocaleString()} · ${size}`;
    about.title = name;
    line.append(about, this.#opening(name), this.#button("Download", name, "download"));
    return line;
  }

  #opening(name) {
    const address = this.#reports.get(name);
    if (address === undefined) return this.#button("Report", name, "report");
    const anchor = document.createElement("a");
    anchor.className = "order small";
    anchor.href = address;
    anchor.target = "_blank";
    anchor.rel = "noopener";
    anchor.textContent = "Open report";
    anchor.setAttribute("aria-label", `Open the report of ${name}`);
    return anchor;
  }

  #button(words, name, kind) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "order small";
    button.textContent = words;
    button.setAttribute("aria-label", `${words} ${name}`);
    button.addEventListener("click", () => this.#ask({ kind, name }));
    return button;
  }

  #load({ name, address, text }) {
    $("recordings-note").textContent = address === null ? `${name}: ${text}` : `${name}: loading`;
    if (address === null) return;
    const anchor = document.createElement("a");
    anchor.href = address;
    anchor.download = name;
    anchor.click();
  }

  #report({ name, address, text }) {
    $("recordings-note").textContent = address === null ? `${name}: the report ${text}` : `${name}: the report is ready`;
    if (address === null) return;
    this.#reports.set(name, address);
    this.#draw();
  }
}
