// What the page says in words and figures: phase and reason, who commands, figures, health and its causes, events.
import { $, chip, part, words, write } from "./elements.js";
import { figure, inUnits, inWords, signed } from "./units.js";

const EVENTS = 100;
const DEGREES = 180 / Math.PI;
const CHI_95 = 2.448; // two dimensions
const ENDED = ["aborted", "refused", "gave up"];

function set(id, text, unit = "", level = "") {
  const element = $(id);
  const key = `${text}|${unit}|${level}`;
  if (element.dataset.shown === key) return;
  element.dataset.shown = key;
  element.dataset.level = level;
  element.replaceChildren(text);
  if (unit) element.append(part("small", unit));
}

export function welcome(message) {
  write("vehicle", message.vehicle);
  $("events").replaceChildren();
}

export function state(message) {
  const phase = words.phases[message.phase] ?? (message.phase || "no decision yet");
  const cuts = ["cutting", "emergency"].includes(message.situation);
  write("phase", cuts ? words.situations[message.situation] : ENDED.includes(phase) || message.flying === null ? `${phase}, ${words.ended[message.flying]}` : phase);
  $("phase").dataset.level = cuts ? "fault" : "";
  write("reason", [message.reason, message.flying === null ? "" : message.advice].filter(Boolean).join(". "));
  const who = message.yours ? "you fly by hand" : message.hand ? `${message.hand} flies by hand` : "";
  const situation = who || (words.situations[message.situation] ?? message.situation);
  write("who", [situation, message.mode && `vehicle: ${message.mode.replaceAll("_", " ")}`].filter(Boolean).join(" · "));
  battery(message.battery_fraction);
  const place = message.place;
  const [high, climbs] = [message.height_m === null ? "–" : inWords("length", message.height_m), place === null ? "–" : inWords("climb", place.v_m_s[2], "+")];
  $("flown").hidden = !message.yours;
  write("flown", `height ${high}, climb ${climbs}`);
  length("height", message.height_m);
  length("lateral", message.lateral_m);
  if (place === null) {
    for (const id of ["climb", "speed", "heading", "deck"]) set(id, "–");
    set("sigma", "unknown");
  } else {
    const level = place.consistent ? "" : "warning";
    const [xx, , yy] = place.cov_m2;
    length("sigma", CHI_95 * Math.max(Math.sqrt(Math.max(xx, yy)), place.sigma_z_m), level);
    set("climb", ...figure("climb", place.v_m_s[2], "+"));
    set("speed", ...figure("speed", Math.hypot(place.v_m_s[0], place.v_m_s[1])));
    set("heading", place.heading_known ? `${signed(place.heading_rad * DEGREES, 0)}°` : "–");
    const tilt = [place.deck_roll_rad, place.deck_pitch_rad];
    set("deck", tilt.includes(null) ? "–" : tilt.map((rad) => `${signed(rad * DEGREES, 1)}°`).join(" / "));
  }
  const delay = message.picture_delay_s;
  set("delay", delay === null ? "–" : String(Math.round(1000 * delay)), delay === null ? "" : "ms", delay > 0.5 ? "warning" : "");
}

function length(id, metres, level = "") {
  if (metres === null) set(id, "–");
  else set(id, ...figure("length", metres), level);
}

function battery(fraction) {
  $("battery").hidden = fraction === null;
  if (fraction === null) return;
  const percent = Math.round(100 * fraction);
  chip($("battery"), percent < 20 ? "fault" : percent < 35 ? "warning" : "info", `battery ${percent} %`);
}

export function health(message) {
  const worst = message.causes.find(({ level }) => level !== "info");
  $("worst").hidden = worst === undefined;
  $("worst").dataset.level = worst?.level ?? "";
  write("worst", worst?.text ?? "");
  chip($("link"), worst?.level ?? "info", "live");
  const causes = message.causes.length ? message.causes : [{ level: "info", text: "everything the flight needs is up" }];
  const key = JSON.stringify(causes.map(({ level, text }) => [level, text.replace(/\d+/g, "")]));
  const list = $("causes");
  if (list.dataset.shown === key) {
    causes.forEach(({ text }, i) => (list.children[i].textContent = text));
  } else {
    list.dataset.shown = key;
    list.replaceChildren(...causes.map(({ level, text }) => part("li", text, { "data-level": level })));
  }
  $("service").replaceChildren(...message.figures.flatMap(([name, value]) => [part("dt", name), part("dd", value)]));
}

function listed(message, given) {
  const line = part("li", "", { "data-level": message.level });
  const tenths = Math.round(10 * message.at_s);
  line.append(part("time", `${Math.floor(tenths / 600)}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`), part("span", message.text, { "data-level": message.level }));
  if (message.advice) line.append(part("small", message.advice));
  line.given = given; // with its figures in metres
  return line;
}

$("units").addEventListener("change", () => {
  for (const line of [...$("events").children]) line.replaceWith(listed(inUnits(line.given), line.given));
});

export function event(message, given = message) {
  $("events").prepend(listed(message, given));
  while ($("events").children.length > EVENTS) $("events").lastChild.remove();
}
