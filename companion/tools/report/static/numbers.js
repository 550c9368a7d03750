// Columns of numbers, and how numbers are found and written.

function columnsOf(texts) {
  return texts.map((text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  });
}

// The index of the newest entry that is not later than t, or -1.
function indexAt(times, t) {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

// The value that is nearest in time, or null where there is none within the gap.
function valueAt(times, values, t, gap) {
  const before = indexAt(times, t);
  let best = null;
  let apart = gap;
  for (const i of [before, before + 1]) {
    if (i < 0 || i >= times.length || !Number.isFinite(values[i])) continue;
    if (Math.abs(times[i] - t) <= apart) [best, apart] = [values[i], Math.abs(times[i] - t)];
  }
  return best;
}

function written(value, step) {
  if (value !== 0 && (Math.abs(value) >= 1e5 || Math.abs(value) < 1e-4)) return value.toExponential(0);
  const digits = Math.max(0, Math.min(6, Math.ceil(-Math.log10(step) - 1e-9)));
  return value.toFixed(digits).replace("-", "\u2212");
}

// A value as it is told at the cursor: three figures are what a plot shows.
function told(value) {
  const size = Math.abs(value);
  if (size !== 0 && size < 0.001) return value.toExponential(1).replace("-", "\u2212");
  const digits = size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3;
  return value.toFixed(digits).replace("-", "\u2212");
}

// Round numbers in a span, at most `most` of them, and their distance.
function ticks(low, high, most) {
  const raw = (high - low) / Math.max(1, most);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) found.push(k * step);
  return [found, step];
}

function powers(low, high, most) {
  const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
  const each = Math.max(1, Math.ceil((last - first + 1) / most));
  const found = [];
  for (let k = first; k <= last; k += each) found.push(10 ** k);
  return found;
}

function clamp(value, low, high) {
  return Math.min(high, Math.max(low, value));
}

function style(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
