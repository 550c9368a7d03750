// The page's beginning: the theme, the login, and who gets which message.
import { Calibration } from "./calibration.js";
import { Doctor } from "./doctor.js";
import { Link } from "./link.js";
import { Picture } from "./picture.js";
import { Orders } from "./orders.js";
import { Plots } from "./plots.js";
import { RecordingsList } from "./recordings.js";
import { SettingsEditor } from "./settings.js";
import { Sticks } from "./sticks.js";
import { Above, placeOf, Side } from "./place.js";
import * as telling from "./telling.js";
import { $, words } from "./elements.js";

const TOKEN = "decklander.token";
const THEME = "decklander.theme";

function theme(name) {
  document.documentElement.dataset.theme = name;
}
const system = matchMedia("(prefers-color-scheme: dark)");
const chosen = () => localStorage.getItem(THEME) ?? (system.matches ? "dark" : "light");
theme(chosen());
system.addEventListener("change", () => theme(chosen()));
$("theme").addEventListener("click", () => {
  localStorage.setItem(THEME, document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  theme(chosen());
});

// A token in the address's fragment never reaches a server or its log; it leaves the address at once.
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given !== null) {
  sessionStorage.setItem(TOKEN, given);
  history.replaceState(null, "", location.pathname);
}

const link = new Link();
const orders = new Orders(link);
const picture = new Picture($("picture"), $("picture-note"), (message) => link.send(message));
const sticks = new Sticks(link, orders, $("sticks"), $("by-hand"), $("hand-note"));
const plots = new Plots();
new RecordingsList(link);
const doctor = new Doctor(link);
new SettingsEditor(link);
const calibration = new Calibration(link);
const views = [new Above($("above")), new Side($("side"))];
$("lines").addEventListener("change", (event) => picture.showLines(event.target.checked));

function askForToken(why) {
  $("flight").hidden = true;
  $("lost").hidden = true;
  $("login").hidden = false;
  $("login-error").textContent = why;
  $("token").focus();
}

$("login-form").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem(TOKEN, $("token").value.trim());
  $("token").value = "";
  $("login-error").textContent = "";
  link.open(sessionStorage.getItem(TOKEN));
});

link.on("welcome", (message) => {
  $("login").hidden = true;
  $("lost").hidden = true;
  $("flight").hidden = false;
  $("flight").classList.remove("stale");
  Object.assign(words, message.words);
  telling.welcome(message);
  telling.chip($("link"), "info", "live");
  picture.camera(...message.camera_px);
  picture.begin(message.h264);
  for (const view of views) view.pad(message);
  orders.enable(true);
});
link.on("state", (message) => {
  message.place = placeOf(message);
  telling.state(message);
  orders.state(message);
  sticks.state(message);
  plots.show(message);
  for (const view of views) view.show(message);
});
link.on("health", (message) => {
  telling.health(message);
  orders.health(message);
});
link.on("event", telling.event);
link.on("answer", ({ number, accepted, text }) => orders.settle(number, accepted ? "info" : "fault", text));
link.on("picture", (header, image) => picture.show(header, image));
link.onQuiet = (quiet_s) => {
  $("flight").classList.toggle("stale", quiet_s !== null);
  $("quiet").hidden = quiet_s === null;
  $("quiet").textContent = `nothing received for ${quiet_s?.toFixed(0)} s: this is old`;
  if (quiet_s !== null) telling.chip($("link"), "fault", "silent");
};
link.onLost = (why) => {
  link.onQuiet(null);
  telling.chip($("link"), "fault", "lost");
  orders.enable(false);
  sticks.lost();
  doctor.lost();
  calibration.lost();
  picture.forget();
  $("flight").classList.add("stale");
  $("lost").hidden = $("flight").hidden;
  $("lost").textContent = `${why}. Trying again. A landing goes on without this page.`;
  if ($("flight").hidden) askForToken(`${why}. Trying again.`);
};
link.onRefused = (why) => {
  sessionStorage.removeItem(TOKEN);
  telling.chip($("link"), "warning", "not connected");
  askForToken(`Refused: ${why}.`);
};

const known = sessionStorage.getItem(TOKEN);
if (known) link.open(known);
else askForToken("");
