// What a hand does on a plot: click or touch moves the cursor, drag zooms, wheel and pinch zoom, two clicks show all.

const STILL_PX = 5;

function gestures(plot, clock) {
  const canvas = plot.canvas;
  const box = plot.figure.querySelector(".selected");
  const fingers = new Map();
  let from = null;
  let pinch = null;
  const at = (event) => event.clientX - canvas.getBoundingClientRect().left;

  const select = (a, b) => {
    box.hidden = a === b;
    box.style.left = `${Math.max(plot.left, Math.min(a, b))}px`;
    box.style.width = `${Math.abs(b - a)}px`;
  };
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { middle: (a + b) / 2, apart: Math.max(10, Math.abs(a - b)) };
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    canvas.setPointerCapture(event.pointerId);
    if (event.pointerType === "touch") {
      fingers.set(event.pointerId, at(event));
      if (fingers.size === 2) pinch = { ...spread(), view: clock.view, t: plot.t(spread().middle) };
      else if (fingers.size === 1) clock.seek(plot.t(at(event)));
      return;
    }
    from = at(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (fingers.has(event.pointerId)) {
      fingers.set(event.pointerId, at(event));
      if (pinch && fingers.size === 2) {
        const factor = pinch.apart / spread().apart;
        const [low, high] = pinch.view;
        clock.show(pinch.t + (low - pinch.t) * factor, pinch.t + (high - pinch.t) * factor);
      } else if (!pinch) clock.seek(plot.t(at(event)));
      return;
    }
    if (from !== null && Math.abs(at(event) - from) > STILL_PX) select(from, at(event));
  });
  const end = (event) => {
    if (fingers.delete(event.pointerId)) {
      if (!fingers.size) pinch = null;
      return;
    }
    if (from === null) return;
    const to = at(event);
    if (event.type === "pointerup") {
      if (Math.abs(to - from) > STILL_PX) clock.show(...[plot.t(from), plot.t(to)].sort((a, b) => a - b));
      else clock.seek(plot.t(to));
    }
    from = null;
    select(0, 0);
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("dblclick", () => clock.whole());
  // A bare wheel scrolls the page; over a plot that was clicked, or with Ctrl or Shift, it zooms.
  canvas.addEventListener(
    "wheel",
    (event) => {
      const wanted = event.ctrlKey || event.shiftKey || document.activeElement === canvas;
      if (!wanted) return;
      event.preventDefault();
      const turned = event.deltaY || event.deltaX;
      const aside = Math.abs(event.deltaX) > Math.abs(event.deltaY) && !event.shiftKey;
      if (aside) clock.pan(clamp(event.deltaX / 600, -0.5, 0.5));
      else clock.zoom(Math.exp(clamp(turned, -240, 240) / 400), plot.t(at(event)));
    },
    { passive: false },
  );
}

// Keys for the whole page, where no field takes them.
function keys(clock) {
  const steps = { ArrowLeft: -1, ArrowRight: 1 };
  document.addEventListener("keydown", (event) => {
    const inField = event.target.closest("input, select, textarea, summary, button, video");
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === " " && !inField) clock.play();
    else if (event.key in steps && !inField) clock.seek(clock.t + steps[event.key] * (event.shiftKey ? 1 : 1 / 30));
    else if (event.key === "+" || event.key === "=") clock.zoom(0.5);
    else if (event.key === "-") clock.zoom(2);
    else if (event.key === "0") clock.whole();
    else if (event.key === "Home" && !inField) clock.seek(clock.begin);
    else if (event.key === "End" && !inField) clock.seek(clock.end);
    else return;
    event.preventDefault();
  });
}
