// A guided calibration: which parts of the picture the board was in, what is missing, the error so far, the finished file.
import { $, part } from "./elements.js";

export class Calibration {
  #link;
  #active = false;
  #file = "";

  constructor(link) {
    this.#link = link;
    $("calibration-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#ask(this.#active ? "end" : "begin");
    });
    $("calibration-save").addEventListener("click", () => this.#ask("save"));
    $("calibration-download").addEventListener("click", () => this.#download());
    link.on("calibration", (message) => this.#show(message));
  }

  lost() {
    if (!this.#active) return;
    this.#active = false;
    $("calibration-begin").textContent = "Begin";
    $("calibration-note").textContent = "The connection is lost; begin again to go on.";
  }

  #ask(action) {
    const number = (id) => Number($(id).value);
    this.#link.ask("calibration-note", {
      kind: "calibration", action, board: $("board-kind").value, columns: number("board-columns"), rows: number("board-rows"), square_mm: number("board-square"),
    });
  }

  #show({ active, text, images, views, board_seen, cells, lacks, rms_px, grade, file }) {
    this.#active = active;
    this.#file = file;
    $("calibration-begin").textContent = active ? "End" : "Begin";
    $("calibration-result").hidden = !file;
    if (text || !active) $("calibration-note").textContent = text;
    $("calibration-note").dataset.level = grade === "good" && !active ? "info" : "";
    if (cells === null) return;
    if (active && !text) $("calibration-note").textContent = board_seen ? "" : "The board is not in the picture.";
    $("calibration-progress").hidden = false;
    const error = rms_px === null ? "" : ` · error ${rms_px.toFixed(2)} px · ${grade}`;
    $("calibration-figures").textContent = `${views} views of ${images} images${error}`;
    this.#grid(cells);
    const missing = lacks.length ? lacks : ["nothing is missing"];
    const key = missing.join("|");
    if ($("calibration-lacks").dataset.shown === key) return;
    $("calibration-lacks").dataset.shown = key;
    $("calibration-lacks").replaceChildren(...missing.map((lack) => part("li", lack)));
  }

  #grid(cells) {
    const flat = cells.flat();
    const covered = flat.filter((count) => count > 0).length;
    const grid = $("calibration-grid");
    grid.setAttribute("aria-label", `Parts of the picture that held the board: ${covered} of ${flat.length}`);
    if (grid.children.length !== flat.length) grid.replaceChildren(...flat.map(() => part("i", "")));
    flat.forEach((count, i) => grid.children[i].classList.toggle("held", count > 0));
  }

  #download() {
    const href = URL.createObjectURL(new Blob([this.#file], { type: "application/toml" }));
    part("a", "", { href, download: "camera_calibrated.toml" }).click();
    setTimeout(() => URL.revokeObjectURL(href), 1000);
  }
}
