// The recordings on the drone's computer: a list, and a download by an address that holds once.
const $ = (id) => document.getElementById(id);

export class RecordingsList {
  #link;

  constructor(link) {
    this.#link = link;
    $("list-recordings").addEventListener("click", () => {
      $("recordings-note").textContent = link.send({ kind: "recordings" }) ? "" : "not asked, the connection is lost";
    });
    link.on("recordings", (message) => this.#show(message));
    link.on("download", (message) => this.#load(message));
  }

  #show({ files, fault }) {
    $("recordings-note").textContent = fault || (files.length ? "" : "there are none");
    $("recordings").replaceChildren(...files.map((file) => this.#line(file)));
  }

  #line({ name, size_bytes, unix_s }) {
    const line = document.createElement("li");
    const button = document.createElement("button");
    button.type = "button";
    button.className = "order small";
    button.textContent = "Download";
    button.setAttribute("aria-label", `Download ${name}`);
    button.addEventListener("click", () => this.#link.send({ kind: "download", name }));
    const about = document.createElement("span");
    const size = size_bytes < 1e6 ? `${(size_bytes / 1e3).toFixed(0)} kB` : `${(size_bytes / 1e6).toFixed(1)} MB`;
    about.textContent = `${new Date(1000 * unix_s).toLocaleString()} · ${size}`;
    about.title = name;
    line.append(about, button);
    return line;
  }

  #load({ name, address, text }) {
    $("recordings-note").textContent = address === null ? `${name}: ${text}` : `${name}: loading`;
    if (address === null) return;
    const anchor = document.createElement("a");
    anchor.href = address;
    anchor.download = name;
    anchor.click();
  }
}
