// Figures with their units as a person chose them: metres, or feet and knots. What is ordered, sent and recorded stays in metres.
import { $ } from "./elements.js";

const KEPT = "decklander.units";
// The size of each unit in metres or metres a second, and the digits behind its point; `small` shows a length below one.
const UNITS = {
  metres: { length: ["m", 1, 2], small: ["cm", 0.01, 0], speed: ["m/s", 1, 2], climb: ["m/s", 1, 2] },
  feet: { length: ["ft", 0.3048, 1], small: ["in", 0.0254, 0], speed: ["kn", 1852 / 3600, 2], climb: ["ft/min", 0.3048 / 60, 0] },
};
const IN_TEXTS = { m: ["length", 1], cm: ["length", 0.01], "m/s": ["speed", 1] };
const OF_FLIGHT = ["state", "health", "event", "answer"];
const OF_A_KEY = /_m(_s)?\b/; // what is to be written into the settings stays as it is written there

const box = $("units");
box.value = localStorage.getItem(KEPT) ?? "metres";
box.addEventListener("change", () => localStorage.setItem(KEPT, box.value));

// The name of a unit, its size and its digits.
export const shown = (kind) => UNITS[box.value][kind];

// A number with its sign, as every number of the page is written.
export function signed(value, digits, plus = "+") {
  const text = value.toFixed(digits);
  return Number(text) === 0 ? (0).toFixed(digits) : value > 0 ? plus + text : text.replace("-", "−");
}

// A value in metres or metres a second as a number and the name of its unit.
export function figure(kind, value, plus = "") {
  let [name, size, digits] = shown(kind);
  if (kind === "length" && Math.abs(value) < size) {
    [name, size, digits] = shown("small");
    if (Math.abs(value) < 10 * size) digits = 1;
  }
  return [signed(value / size, digits, plus), name];
}

export const inWords = (...what) => figure(...what).join(" ");

// The texts of a message about the flight, with their figures in the units that are shown.
export function inUnits(message) {
  if (box.value === "metres" || !OF_FLIGHT.includes(message.kind)) return message;
  const converted = (_, number, unit) => inWords(IN_TEXTS[unit][0], number * IN_TEXTS[unit][1]);
  return JSON.parse(JSON.stringify(message), (_, value) =>
    typeof value === "string" && !OF_A_KEY.test(value) ? value.replace(/(\d+(?:\.\d+)?) (m\/s|cm|m)(?![\w/^])/g, converted) : value,
  );
}
