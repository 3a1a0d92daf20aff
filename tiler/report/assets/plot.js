// Lines over an axis, each with a colour, a mark and a dash of its own: told apart without colour too.

const MARKS = [
  (x, y) => `M${x - 4},${y}a4,4 0 1,0 8,0a4,4 0 1,0 -8,0`, (x, y) => `M${x - 4},${y - 4}h8v8h-8z`,
  (x, y) => `M${x},${y - 5}l5,9h-10z`, (x, y) => `M${x},${y - 5.5}l5.5,5.5l-5.5,5.5l-5.5,-5.5z`,
  (x, y) => `M${x},${y + 5}l5,-9h-10z`, (x, y) => `M${x - 5},${y - 1.6}h3.4v-3.4h3.2v3.4h3.4v3.2h-3.4v3.4h-3.2v-3.4h-3.4z`,
  (x, y) => `M${x - 3},${y - 5}h6v10h-6z`,
];
const DASHES = ["", "7 4", "2 3", "9 3 2 3", "12 4", "4 2", "1 4"];

const narrow = window.matchMedia("(max-width: 640px)");

/** Round values that cover low to high. */
function ticks(low, high, count) {
  const raw = (high - low) / count || 1;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = size * [1, 2, 5, 10].find((k) => size * k >= raw);
  const made = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + step * 1e-6; v += step) made.push(Number(v.toPrecision(12)));
  return made;
}

function short(value) {
  for (const [size, sign] of [[1e9, " G"], [1e6, " M"], [1e3, " k"]]) {
    if (Math.abs(value) >= size) return `${Number((value / size).toPrecision(4))}${sign}`;
  }
  return String(Number(value.toPrecision(4)));
}

/** lines: [{name, points: [[x, y]]}], x numbers, or texts in `categories`. */
function linePlot({ lines, categories, xTitle, yTitle, log }) {
  const [wide, high, left, right, top, bottom] = narrow.matches ? [390, 320, 58, 10, 12, 50] : [980, 420, 76, 18, 14, 52];
  const xs = categories ? categories.map((_, k) => k) : [...new Set(lines.flatMap((l) => l.points.map((p) => p[0])))];
  const ys = lines.flatMap((l) => l.points.map((p) => p[1])).filter((y) => !log || y > 0);
  if (!ys.length) return h("p", { class: "quiet" }, "No value to plot.");
  let [x0, x1] = [Math.min(...xs), Math.max(...xs)];
  if (x0 === x1) [x0, x1] = [x0 - 0.5, x1 + 0.5];
  const most = Math.max(...ys), least = Math.min(...ys);
  const decades = [];
  if (log) for (let e = Math.floor(Math.log10(least)); e <= Math.ceil(Math.log10(most)); e++) decades.push(10 ** e);
  const yTicks = log ? (decades.length > 1 ? decades : [decades[0], decades[0] * 10]) : ticks(Math.min(0, least), most || 1, 5);
  const y0 = log ? Math.log10(yTicks[0]) : Math.min(0, least), y1 = log ? Math.log10(yTicks.at(-1)) : Math.max(most, yTicks.at(-1)) || 1;
  const px = (x) => left + (wide - left - right) * (x - x0) / (x1 - x0);
  const py = (y) => high - bottom - (high - top - bottom) * ((log ? Math.log10(y) : y) - y0) / (y1 - y0);
  const xTicks = categories ? xs : xs.length <= 10 ? xs : ticks(x0, x1, 8);
  return h("svg", { class: narrow.matches ? "plot" : "plot wide", viewBox: `0 0 ${wide} ${high}`, role: "img", "aria-label": `${yTitle} over ${xTitle}` },
    yTicks.map((y) => [h("line", { class: "rule", x1: left, x2: wide - right, y1: py(y), y2: py(y) }),
      h("text", { x: left - 8, y: py(y) + 4, "text-anchor": "end" }, short(y))]),
    xTicks.map((x) => h("text", { x: px(x), y: high - bottom + 20, "text-anchor": "middle" }, categories ? categories[x] : short(x))),
    h("text", { class: "axis-title", x: (left + wide - right) / 2, y: high - 8, "text-anchor": "middle" }, xTitle),
    lines.map((line, k) => {
      const points = line.points.filter((p) => !log || p[1] > 0).map(([x, y]) => [px(x), py(y)]);
      return h("g", {},
        h("path", { class: "curve", d: points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)},${y.toFixed(1)}`).join(""),
          "stroke-dasharray": DASHES[k % 7] || null, stroke: `var(--s${k % 7})` }),
        points.map(([x, y]) => h("path", { class: "dot", d: MARKS[k % 7](Number(x.toFixed(1)), Number(y.toFixed(1))), fill: `var(--s${k % 7})` })));
    }));
}

function plotKeys(lines) {
  return h("ul", { class: "keys-of-plot" }, lines.map((line, k) => h("li", {},
    h("svg", { viewBox: "0 0 34 12", "aria-hidden": "true" },
      h("path", { class: "curve", d: "M0,6H34", stroke: `var(--s${k % 7})`, "stroke-dasharray": DASHES[k % 7] || null }),
      h("path", { class: "dot", d: MARKS[k % 7](17, 6), fill: `var(--s${k % 7})` })), line.name)));
}
