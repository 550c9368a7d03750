// Tones and vibration for who looks at the drone and not at the page. Off until a person wants them.
import { $ } from "./elements.js";

const KEPT = "decklander.alarms";
// Tones of some hertz, each for some milliseconds and with a pause behind it; a phone vibrates as long as they sound.
const TONES = {
  refused: [[620, 120, 60], [440, 240, 0]],
  stopped: [[880, 150, 80], [880, 150, 80], [880, 150, 0]],
  lost: [[440, 400, 100], [330, 400, 100], [220, 800, 0]],
};
const on = () => localStorage.getItem(KEPT) === "on";
let sound = null;

function show() {
  $("alarms-ask").hidden = localStorage.getItem(KEPT) !== null;
  $("alarms").setAttribute("aria-pressed", String(on()));
}

// A browser lets a page sound only after a person has pressed something on it.
async function wake() {
  if (on()) await (sound ??= new AudioContext()).resume();
}

async function choose(choice) {
  localStorage.setItem(KEPT, choice);
  show();
  await wake();
  alarm("refused");
}

export function alarm(name) {
  if (!on()) return;
  navigator.vibrate?.(TONES[name].flatMap(([, ms, pause_ms]) => [ms, pause_ms]));
  if (sound?.state !== "running") return; // a tone that waited would sound at the next press
  let at_s = sound.currentTime;
  for (const [frequency, ms, pause_ms] of TONES[name]) {
    const tone = new OscillatorNode(sound, { frequency, type: "triangle" });
    tone.connect(sound.destination);
    tone.start(at_s);
    tone.stop(at_s + ms / 1000);
    at_s += (ms + pause_ms) / 1000;
  }
}

show();
$("alarms").addEventListener("click", () => choose(on() ? "off" : "on"));
for (const button of $("alarms-ask").querySelectorAll("button")) button.addEventListener("click", () => choose(button.value));
for (const gesture of ["click", "keydown"]) addEventListener(gesture, wake);
