"use strict";
// The page's data, elements, numbers, and arrays out of their packing (tiler/report/encode.py).

const data = JSON.parse(document.getElementById("data").textContent);

/** An element. Attributes by name, listeners as on..., custom properties as --...; children are elements or text. */
function h(tag, attributes = {}, ...children) {
  const made = tag === "svg" || h.inSvg.has(tag)
    ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name.startsWith("--")) made.style.setProperty(name, value);
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}
h.inSvg = new Set(["g", "path", "line", "text", "circle", "rect"]);

const wholeFormat = new Intl.NumberFormat("en-US");
const partFormat = new Intl.NumberFormat("en-US", { maximumSignificantDigits: 4 });

/** A number as it is read: whole ones in full, others to four digits. */
function show(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  return Number.isInteger(value) ? wholeFormat.format(value) : partFormat.format(value);
}

/** Ratio to the baseline, three digits; nothing where that is 0. */
function ratio(value, baseline) {
  if (!baseline) return "";
  const times = value / baseline;
  return "×" + (times >= 1000 ? wholeFormat.format(Math.round(times)) : String(Number(times.toPrecision(3))));
}

function plural(count, word) {
  return `${show(count)} ${word}${count === 1 ? "" : "s"}`;
}

/** A definition with its names set as code. */
function prose(text) {
  return text.split("`").map((piece, k) => k % 2 ? h("code", {}, piece) : piece);
}

const unpacked = new Map();

/** An array of data.blobs as a typed array; a promise. */
function unpack(number) {
  if (!unpacked.has(number)) unpacked.set(number, unpackNow(data.blobs[number]));
  return unpacked.get(number);
}

async function unpackNow(blob) {
  const packed = Uint8Array.from(atob(blob.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const kind = { u8: Uint8Array, u16: Uint16Array, u32: Uint32Array, f64: Float64Array }[blob.type];
  const width = kind.BYTES_PER_ELEMENT;
  const sorted = new Uint8Array(blob.length * width); // by value again, not by significance
  for (let k = 0; k < width; k++) {
    for (let i = 0; i < blob.length; i++) sorted[i * width + k] = bytes[k * blob.length + i];
  }
  let values = new kind(sorted.buffer);
  if (blob.stride) for (let i = blob.stride; i < blob.length; i++) values[i] += values[i - blob.stride];
  if (blob.low) {
    const from = values;
    values = blob.low >= -2147483648 && blob.type !== "u32" ? new Int32Array(blob.length) : new Float64Array(blob.length);
    for (let i = 0; i < blob.length; i++) values[i] = from[i] + blob.low;
  }
  return values;
}

/** A labelled control. */
function field(label, control, more = {}) {
  return h("label", { class: "field", ...more }, h("span", {}, label), control);
}

/** A select; options are [value, text] or {group, options}. */
function choice(options, value, change, more = {}) {
  const one = ([key, text]) => h("option", { value: key }, text);
  const made = h("select", { onchange: () => change(made.value), ...more },
    options.map((o) => Array.isArray(o) ? one(o) : h("optgroup", { label: o.group }, o.options.map(one))));
  made.value = String(value);
  return made;
}

function tick(label, checked, change) {
  const box = h("input", { type: "checkbox", onchange: () => change(box.checked) });
  box.checked = checked;
  return h("label", { class: "tick" }, box, h("span", {}, label));
}

/** A part of the page with a heading. */
function part(id, title, ...children) {
  return h("section", { id, "aria-labelledby": `${id}-title` }, h("h2", { id: `${id}-title` }, title), children);
}

/** A part that is folded at first; made anew it is as its reader left it. */
function folded(key, title, ...children) {
  return h("details", { open: Boolean(folded.open[key]), ontoggle: (event) => { folded.open[key] = event.target.open; } },
    h("summary", {}, title), children);
}
folded.open = {};

/** Room for what may be wider than the page; the keyboard scrolls it too. */
function scroller(label, ...children) {
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label }, children);
}

/** What the page is about, a switch of themes, and links to the parts. */
function topOfPage(title, about, parts) {
  const theme = choice([["auto", "System theme"], ["light", "Light"], ["dark", "Dark"]], "auto", (chosen) => {
    if (chosen === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = chosen;
  }, { id: "theme", "aria-label": "Theme" });
  return h("header", {},
    h("div", { class: "top" }, h("div", {}, h("h1", {}, title), h("p", { class: "about" }, about)), theme),
    h("nav", { "aria-label": "Parts of the report" }, parts.map((p) => h("a", { href: `#${p.id}` },
      p.querySelector("h2").textContent))));
}

/** Names and texts in two columns. */
function facts(pairs) {
  return h("dl", {}, Object.entries(pairs).map(([name, text]) => [h("dt", {}, name), h("dd", {}, text)]));
}

/** Where the numbers come from, and how to get them again. */
function reproduce(provenance, ...more) {
  const command = provenance.command
    ? [h("p", {}, "The same numbers again, from the same version:"),
      h("pre", { tabindex: "0", "aria-label": "Command" }, h("code", {}, provenance.command))]
    : [];
  return part("reproduce", "Reproduce", command, more,
    facts({ ...provenance.versions, "report made": provenance.made }));
}
