// The page's beginning: the theme, the login, and who gets which message.
import { alarm } from "./alarms.js";
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
import { $, chip, words } from "./elements.js";

const TOKEN = "decklander.token";
const THEME = "decklander.theme";
const THEMES = ["light", "dark", "night"];
const UNKNOWN = "What the drone does now is not known here: a landing may go on, or the service has ended and left the drone to itself.";

const system = matchMedia("(prefers-color-scheme: dark)");
const shown = document.documentElement.dataset;
function theme() {
  shown.theme = localStorage.getItem(THEME) ?? (system.matches ? "dark" : "light");
  $("browser-bar").content = getComputedStyle(document.documentElement).getPropertyValue("--card");
}
theme();
system.addEventListener("change", theme);
$("theme").addEventListener("click", () => {
  localStorage.setItem(THEME, THEMES[(THEMES.indexOf(shown.theme) + 1) % THEMES.length]);
  theme();
});

// A token in the address's fragment never reaches a server or its log; it leaves the address at once.
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given !== null) {
  sessionStorage.setItem(TOKEN, given);
  history.replaceState(null, "", location.pathname);
}
// A browser does not load a page again whose address changes behind the # alone.
addEventListener("hashchange", () => new URLSearchParams(location.hash.slice(1)).has("token") && location.reload());

const link = new Link();
const orders = new Orders(link);
const picture = new Picture((message) => link.send(message));
const sticks = new Sticks(link, orders);
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

// The page is old from a loss until the first state of a new connection, which may be to another run of the service. The reason
// that a service gave for its end stays shown, whatever errors the tries to connect again meet.
let [old, ended, run] = [false, "", null];

link.on("welcome", (message) => {
  $("login").hidden = true;
  $("lost").hidden = true;
  $("flight").hidden = false;
  Object.assign(words, message.words);
  telling.welcome(message);
  const again = run !== null && run !== message.run ? "the service started again" : "";
  [run, ended] = [message.run, ""];
  if (again) telling.event({ at_s: 0, level: "warning", text: again });
  picture.begin(message);
  for (const view of views) view.pad(message);
  orders.enable(true, again);
});
link.on("state", (message) => {
  old = false;
  message.place = placeOf(message);
  telling.state(message);
  orders.state(message);
  sticks.state(message);
  plots.show(message);
  for (const view of views) view.show(message);
});
link.on("health", telling.health);
link.on("health", (message) => orders.health(message));
link.on("event", telling.event);
link.on("event", (message) => orders.event(message));
link.on("answer", ({ number, accepted, text }) => orders.settle(number, accepted ? "info" : "fault", text));
link.on("picture", (header, image) => picture.show(header, image));
link.onQuiet = (quiet_s) => {
  $("flight").classList.toggle("stale", old || quiet_s !== null);
  $("quiet").hidden = quiet_s === null;
  $("quiet").textContent = `nothing received for ${quiet_s?.toFixed(0)} s: this is old`;
  if (quiet_s !== null) chip($("link"), "fault", "silent");
};
link.onLost = (why, ends) => {
  if (!old && run !== null) alarm("lost");
  [old, ended] = [true, ended || (ends ? why : "")];
  link.onQuiet(null);
  chip($("link"), "fault", "lost");
  orders.enable(false);
  sticks.lost();
  doctor.lost();
  calibration.lost();
  picture.forget();
  $("lost").hidden = $("flight").hidden;
  $("lost").textContent = `${ended || why}. Trying again. ${ended ? "" : UNKNOWN}`;
  if ($("flight").hidden) askForToken(`${why}. Trying again.`);
};
link.onRefused = (why) => {
  sessionStorage.removeItem(TOKEN);
  chip($("link"), "warning", "not connected");
  askForToken(`Refused: ${why}. A demo that was started again has another: open the new link from its terminal.`);
};

const known = sessionStorage.getItem(TOKEN);
if (known) link.open(known);
else askForToken("");
