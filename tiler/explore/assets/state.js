// What the page shows, all of it in one object, which the address keeps after its #: a page loaded again shows the same.

const base = data.presets["as started"];
const state = {
  frame: 0, camera: null, // {eye, target}; null: the scene's own path
  scene: {}, machine: {}, // what differs from the scene and the machine that the explorer was started with
  map: "queue_entries", opacity: 0.75, log: false, grid: false,
  point: null, // 0..1 from the left and the top: the tile there is looked into
  patches: [], bounds: [], // whose boxes are drawn, and by which bounds beside the machine's own
};
const INITIAL = structuredClone(state);
const SCENE_FIELDS = ["factor", "samples", "shading"];

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
const numbers = (text, count) => {
  const found = text.split(",").map(Number);
  return found.length === count && found.every(Number.isFinite) ? found : null;
};

/** The machine that is asked for, all fields. */
function machineNow() {
  return { ...base, ...state.machine };
}

/** Set a field of the machine; one that is as it was at the start is forgotten. */
function setField(name, value) {
  if (same(value, base[name])) delete state.machine[name];
  else state.machine[name] = value;
}

/** The state as text for the address; what is as at the start is left out. */
function stateText() {
  const told = new URLSearchParams();
  if (state.frame) told.set("frame", state.frame);
  if (state.camera) {
    const short = (point) => point.map((v) => Number(v.toPrecision(9))).join(",");
    told.set("eye", short(state.camera.eye));
    told.set("target", short(state.camera.target));
  }
  for (const [name, value] of Object.entries(state.scene)) told.set(`scene.${name}`, JSON.stringify(value));
  for (const [name, value] of Object.entries(state.machine)) told.set(`machine.${name}`, JSON.stringify(value));
  for (const name of ["map", "opacity", "log", "grid"]) if (state[name] !== INITIAL[name]) told.set(name, JSON.stringify(state[name]));
  if (state.point) told.set("point", state.point.map((v) => v.toFixed(4)).join(","));
  if (state.patches.length) told.set("patches", state.patches.join(","));
  if (state.bounds.length) told.set("bounds", state.bounds.join(","));
  return told.toString();
}

/** Take the state from the address; what makes no sense there is passed over, and the server checks the rest. */
function readState(text) {
  Object.assign(state, structuredClone(INITIAL));
  const told = new URLSearchParams(text);
  const value = (name, fallback) => {
    try {
      return JSON.parse(told.get(name));
    } catch {
      return fallback;
    }
  };
  const frame = Number(told.get("frame"));
  if (Number.isFinite(frame) && frame > 0) state.frame = frame;
  const [eye, target] = ["eye", "target"].map((name) => numbers(told.get(name) || "", 3));
  if (eye && target) state.camera = { eye, target };
  for (const name of told.keys()) {
    const [kind, field] = name.split(".");
    if (kind === "scene" && SCENE_FIELDS.includes(field)) state.scene[field] = value(name, null);
    if (kind === "machine" && Object.hasOwn(base, field)) setField(field, value(name, base[field]));
  }
  if (told.has("map") && (value("map", "") === "" || Object.hasOwn(data.maps, value("map", "")))) state.map = value("map", "");
  if (told.has("opacity")) state.opacity = Math.min(1, Math.max(0, Number(value("opacity", 0.75)) || 0));
  for (const name of ["log", "grid"]) if (told.has(name)) state[name] = value(name, false) === true;
  const point = numbers(told.get("point") || "", 2);
  if (point && point.every((v) => v >= 0 && v <= 1)) state.point = point;
  state.patches = (told.get("patches") || "").split(",").filter((v) => /^\d+$/.test(v)).map(Number).filter((v) => v < data.patches).slice(0, 16);
  const bounds = data.form.find((field) => field.name === "bounds").choices;
  state.bounds = (told.get("bounds") || "").split(",").filter((name) => bounds.includes(name));
}

function keepState() {
  clearTimeout(keepState.later);
  keepState.later = setTimeout(() => history.replaceState(null, "", `#${stateText()}`), 150); // browsers allow it only so often
}

// The camera, as vectors.
const add = (a, b, times = 1) => a.map((v, k) => v + times * b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (a, k) => a.map((v) => v * k);
const unit = (a) => times(a, 1 / Math.hypot(...a));
const UP = unit(data.camera.up);
const FAR = Math.hypot(...add(data.camera.eye, data.camera.target, -1)); // the first view's distance
const STEEPEST = 88 * Math.PI / 180;

/** The camera turned about its target, by angles to the right and upwards. */
function orbit({ eye, target }, right, upwards) {
  const offset = add(eye, target, -1), distance = Math.hypot(...offset);
  const height = Math.min(1, Math.max(-1, dot(offset, UP) / distance));
  let flat = add(offset, UP, -dot(offset, UP));
  if (Math.hypot(...flat) < 1e-6 * distance) flat = cross(UP, Math.abs(UP[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
  flat = unit(flat);
  const angle = Math.min(STEEPEST, Math.max(-STEEPEST, Math.asin(height) + upwards));
  const turned = add(times(flat, Math.cos(right)), cross(UP, flat), Math.sin(right));
  return { target, eye: add(target, add(times(turned, Math.cos(angle)), UP, Math.sin(angle)), distance) };
}

/** Nearer or farther. */
function zoom({ eye, target }, factor) {
  const offset = add(eye, target, -1), distance = Math.hypot(...offset);
  const wanted = Math.min(20 * FAR, Math.max(0.02 * FAR, distance * factor));
  return { target, eye: add(target, offset, wanted / distance) };
}

/** Eye and target moved across the view, by parts of the picture's height. */
function pan({ eye, target }, right, upwards) {
  const offset = add(eye, target, -1), back = unit(offset);
  const side = unit(cross(UP, back)), above = cross(back, side);
  const size = 2 * Math.tan(data.camera.fov * Math.PI / 360) * Math.hypot(...offset);
  const by = add(times(side, right * size), above, upwards * size);
  return { eye: add(eye, by), target: add(target, by) };
}
