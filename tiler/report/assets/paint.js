// Values in colours, and figures of a map's values.

const RAMP = Uint8Array.from(data.ramp.match(/../g), (digits) => parseInt(digits, 16));

/** Place of a value among the colours, 0 to 1. */
function place(value, top, log) {
  if (top <= 0) return 0;
  const part = log ? Math.log1p(value) / Math.log1p(top) : value / top;
  return Math.min(1, Math.max(0, part));
}

// The colours as canvases hold them, and clear.
const PIXELS = new Uint32Array(Uint8Array.from({ length: 4 * RAMP.length / 3 },
  (_, i) => i % 4 === 3 ? 255 : RAMP[3 * (i >> 2) + i % 4]).buffer);
const FEW = 1 << 20; // values that a table is made for

/** A map's colours on a canvas of one pixel a value; 0 is left clear. */
function paint(values, width, height, top, log) {
  const canvas = h("canvas", { width, height });
  const image = new ImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const colour = (value) => value ? PIXELS[Math.round(place(value, top, log) * (PIXELS.length - 1))] : 0;
  const known = top < FEW && values.length > top ? Uint32Array.from({ length: top + 1 }, (_, value) => colour(value)) : null;
  for (let i = 0; i < values.length; i++) pixels[i] = known ? known[Math.min(values[i], top)] : colour(values[i]);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

const NOTHING = new Uint8Array(0);
const described = new WeakMap();

/** Figures of a map's values, none below 0, made once: {largest, sum, length, some (not 0), at(part)}. */
function describe(values) {
  if (!described.has(values)) {
    let largest = 0, sum = 0, some = 0;
    for (const value of values) {
      if (value > largest) largest = value;
      sum += value;
      some += value > 0;
    }
    described.set(values, { largest, sum, some, length: values.length, at: quantiles(values, largest) });
  }
  return described.get(values);
}

/** The value that a part of all lie below, as a function; by counting, for a picture has too many pixels to sort. */
function quantiles(values, largest) {
  if (!values.length) return () => 0;
  const rank = (part) => Math.min(values.length - 1, Math.floor(part * values.length));
  let sorted = null, counts = null;
  return (part) => {
    if (largest >= FEW) {
      sorted = sorted || Float64Array.from(values).sort();
      return sorted[rank(part)];
    }
    if (!counts) {
      counts = new Uint32Array(largest + 1);
      for (const value of values) counts[value]++;
    }
    let below = counts[0], value = 0;
    while (below <= rank(part)) below += counts[++value];
    return value;
  };
}
