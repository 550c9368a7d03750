// The page: plots, views, films, figures and events under one cursor.

const data = JSON.parse(document.getElementById("data").textContent);
const page = { data, columns: columnsOf(data.columns), clock: new Clock(data.span), hidden: new Set() };
const clock = page.clock;

const plots = [...document.querySelectorAll("figure.plot")].map((f) => new TimePlot(f, data.plots[f.dataset.plot], page));
const views = [...document.querySelectorAll("figure.view")].map((f) => new PadView(f, data.views[f.dataset.view], page));
const drawings = [...plots, ...views];
for (const plot of plots) gestures(plot, clock);
keys(clock);
for (const film of document.querySelectorAll("video")) {
  clock.videos.push(new FlightFilm(film, data.flights[film.dataset.flight].video));
}

// Only what is in sight is drawn again; each was drawn once, for a picture of the whole page.
const seen = new IntersectionObserver(
  (entries) => {
    for (const { target, isIntersecting } of entries) {
      const drawing = drawings.find((one) => one.canvas === target);
      drawing.inSight = isIntersecting;
      if (isIntersecting) drawing.draw();
    }
  },
  { rootMargin: "300px" },
);
for (const { canvas } of drawings) seen.observe(canvas);
drawings.forEach((drawing, k) => setTimeout(() => drawing.draw(true), 20 * k));
// Paper has no window: everything is drawn before it, and as wide.
function paper(on) {
  document.body.classList.toggle("paper", on);
  for (const drawing of drawings) drawing.draw(on);
}
addEventListener("beforeprint", () => {
  for (const closed of document.querySelectorAll("details")) closed.open = true;
  paper(true);
});
addEventListener("afterprint", () => paper(false));
const redraw = () => drawings.forEach((drawing) => drawing.draw());
new ResizeObserver(redraw).observe(document.body);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

// Series are switched for all plots at once.
for (const box of document.querySelectorAll(".key input")) {
  const apply = () => page.hidden[box.checked ? "delete" : "add"](box.value);
  box.addEventListener("change", () => {
    apply();
    redraw();
  });
  apply();
}

// The figures at the cursor.
const figures = [...document.querySelectorAll("dl.figures")].map((list) => ({ list, flight: data.flights[list.dataset.flight] }));
const dash = "\u2013";
function tellFigures() {
  for (const { list, flight } of figures) {
    const texts = flight.kinds.map(({ t, texts }) => texts[indexAt(page.columns[t], clock.t + 1e-4)] ?? dash);
    for (const { t, y, digits, unit } of flight.figures) {
      const value = valueAt(page.columns[t], page.columns[y], clock.t, 0.3);
      texts.push(value === null ? dash : `${value.toFixed(digits).replace("-", "\u2212")} ${unit}`.replace(" \u00b0", "\u00b0"));
    }
    list.querySelectorAll("dd").forEach((cell, k) => {
      if (cell.textContent !== texts[k]) cell.textContent = texts[k];
    });
  }
}

// Transport: the slider is the cursor.
const slider = document.getElementById("slider");
const play = document.getElementById("play");
const time = document.getElementById("time");
[slider.min, slider.max, slider.step] = [clock.begin, clock.end, "any"];
slider.addEventListener("input", () => clock.seek(Number(slider.value)));
slider.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
  if (!step) return;
  event.preventDefault();
  clock.seek(clock.t + step * (event.shiftKey ? 1 : 1 / 30));
});
play.addEventListener("click", () => clock.play());
document.getElementById("rate").addEventListener("change", (event) => clock.hurry(Number(event.target.value)));
document.getElementById("closer").addEventListener("click", () => clock.zoom(0.5));
document.getElementById("wider").addEventListener("click", () => clock.zoom(2));
document.getElementById("all").addEventListener("click", () => clock.whole());
for (const film of document.querySelectorAll("video")) film.addEventListener("click", () => clock.play());

// Events: a click seeks; the one that holds is marked.
const events = [...document.querySelectorAll("[data-t]")];
for (const one of events) one.addEventListener("click", () => clock.seek(Number(one.dataset.t)));
const listed = [...document.querySelectorAll("ol.events")].map((list) => [list, [...list.querySelectorAll("button")]]);
function tellEvents() {
  for (const [list, buttons] of listed) {
    const last = buttons.findLast((one) => Number(one.dataset.t) <= clock.t + 1e-3);
    for (const one of buttons) {
      if (one === last) one.setAttribute("aria-current", "true");
      else one.removeAttribute("aria-current");
    }
    if (last && clock.playing) list.scrollTop = last.offsetTop - list.offsetTop - list.clientHeight / 2;
  }
}

clock.on("cursor", () => {
  for (const drawing of drawings) if (drawing.inSight) drawing.cursor();
  slider.value = clock.t;
  time.textContent = `${clock.t.toFixed(2).replace("-", "\u2212")} s`;
  slider.setAttribute("aria-valuetext", time.textContent);
  tellFigures();
  tellEvents();
});
clock.on("view", () => {
  redraw();
  document.body.classList.toggle("zoomed", clock.zoomed);
});
clock.on("play", () => {
  play.textContent = clock.playing ? "Pause" : "Play";
});
clock.hurry(1);
// It opens with the newest figures at the touchdown, else with the first; without figures with the first picture.
const instants = page.columns[data.flights[0].figures[0]?.t] ?? [clock.videos[0]?.from ?? clock.begin];
const touched = document.querySelector("tr:last-child [data-t]");
clock.seek(instants[touched ? Math.max(0, indexAt(instants, Number(touched.dataset.t))) : 0] ?? clock.begin);
