// The page: puts its parts together, asks the server for what the state says, and shows what comes back.

const TOKEN = new URLSearchParams(location.search).get("token") || "";
const PAGE_NAME = Array.from(crypto.getRandomValues(new Uint8Array(10)), (v) => (v % 36).toString(36)).join("");
const IDLE = 120; // milliseconds without a change, after which the full size is drawn
const ONE_SIZE = same(data.size, data.draft);

/** A reply taken apart: JSON, and typed arrays where it names them. */
function takeApart(buffer) {
  const long = new DataView(buffer).getUint32(0, true), begin = 4 + long;
  const view = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, long)));
  const kinds = { u8: Uint8Array, i32: Int32Array, f64: Float64Array };
  const array = ({ type, at, length }) => new kinds[type](buffer, begin + at, length);
  view.picture = array(view.picture);
  view.under = array(view.under);
  for (const name of Object.keys(view.maps)) view.maps[name] = array(view.maps[name]);
  return view;
}

function request(full) {
  const { frame, camera, scene, machine, map, point, patches, bounds } = state;
  return { page: PAGE_NAME, full, frame, camera, scene, machine, map, point: full ? point : null, patches, bounds };
}

function explorer() {
  let version = 0; // of the state
  let since = null; // when the oldest change that is not yet answered was made
  let drafting = false, dragging = false, later = 0, slow = 0;
  const status = h("p", { class: "status", role: "status", id: "status" }, "starting");
  const alert = h("pre", { class: "alert", role: "alert", id: "alert", hidden: true });

  const tell = (text) => { status.textContent = text; };
  function fail(text) {
    alert.textContent = text;
    alert.hidden = false;
    tell("the last picture that could be drawn");
  }

  async function ask(full) {
    const asked = version;
    clearTimeout(slow);
    slow = setTimeout(() => tell("drawing; kernels used for the first time are compiled, which can take a minute"), 2500);
    if (full) tell("drawing the full size");
    let reply;
    try {
      reply = await fetch("/view", { method: "POST", headers: { "Content-Type": "application/json", "X-Tiler-Token": TOKEN }, body: JSON.stringify(request(full)) });
      if (reply.status === 409) return "superseded";
      if (!reply.ok) {
        const text = await reply.text();
        if (asked === version) fail(text.startsWith("{") ? JSON.parse(text).error : text);
        return "failed";
      }
      const view = takeApart(await reply.arrayBuffer());
      if (full && asked !== version) return "superseded";
      showView(view, asked);
      return "shown";
    } catch (error) {
      if (error instanceof TypeError) fail("The explorer's server does not answer: it was ended, or this computer slept. Start it again, then change something here.");
      else { fail(`This page has a fault: ${error.message}`); throw error; }
      return "failed";
    } finally {
      clearTimeout(slow);
    }
  }

  function showView(view, asked) {
    alert.hidden = !view.violations.length;
    alert.textContent = view.violations.join("\n");
    stage.show(view);
    queue.show(view.queue, view);
    patches.show(view);
    queue.mark();
    counters.show(view);
    const took = since === null ? null : performance.now() - since;
    if (took !== null && asked === version) {
      stage.stage.dataset[view.full ? "fullLatency" : "draftLatency"] = took.toFixed(1);
      if (!view.full && !("firstLatency" in stage.stage.dataset)) stage.stage.dataset.firstLatency = took.toFixed(1);
      if (view.full) since = null;
    }
    tell(`${view.size.join(" × ")}${view.full ? "" : " draft"} · simulated in ${show(Math.round(1e3 * view.seconds))} ms${took === null ? "" : ` · shown after ${show(Math.round(took))} ms`}`);
    stage.stage.dataset.full = String(view.full);
    stage.stage.dataset.shown = String(asked);
    stage.stage.dataset.settled = String(view.full && asked === version);
    if (view.full) stage.stage.dataset.ready = "true";
  }

  /** The newest state as a draft; then, when nothing changes any more, in full. */
  async function draft() {
    if (drafting) return;
    drafting = true;
    try {
      for (;;) {
        const asked = version;
        const end = await ask(false);
        if (asked === version) {
          if (end === "shown") refine();
          return;
        }
      }
    } finally {
      drafting = false;
    }
  }

  function refine(wait = IDLE) {
    clearTimeout(later);
    later = setTimeout(() => {
      if (dragging || drafting) refine();
      else ask(true);
    }, wait);
  }

  /** The state was changed. whole : only what is looked at, not what is drawn, so that no draft is needed. */
  function changed(whole = false) {
    version++;
    if (since === null) since = performance.now();
    stage.stage.dataset.version = String(version);
    stage.stage.dataset.settled = "false";
    keepState();
    clearTimeout(later);
    if (whole === true || ONE_SIZE) {
      if (!drafting) refine(0);
    } else draft();
  }

  const stage = makeStage({
    moved: () => changed(),
    moving: (now) => { dragging = now; },
    chosen: (point, patch, more) => {
      state.point = point;
      choosePatch(patch, more);
    },
  });
  function choosePatch(patch, more) {
    if (patch < 0) state.patches = more ? state.patches : [];
    else if (!more) state.patches = [patch];
    else state.patches = state.patches.includes(patch) ? state.patches.filter((p) => p !== patch) : [...state.patches, patch].slice(-16);
    if (stage.view()) stage.draw();
    changed(true);
  }
  const queue = queueView({
    choose: choosePatch,
    tileTyped: (column, row) => {
      const view = stage.view();
      if (!view || !Number.isInteger(column) || !Number.isInteger(row)) return;
      const [columns, rows] = view.grid, inside = (v, most) => Math.min(most - 1, Math.max(0, v));
      const middle = (v, k) => Math.min(1 - 0.5 / view.size[k], (v + 0.5) * view.tile / view.size[k]);
      state.point = [middle(inside(column, columns), 0), middle(inside(row, rows), 1)];
      // A tile that the border cuts has its middle outside: its first pixel is always inside.
      const first = [inside(column, columns) * view.tile, inside(row, rows) * view.tile];
      if (stage.tileAt(state.point).join() !== [inside(column, columns), inside(row, rows)].join()) state.point = first.map((v, k) => (v + 0.5) / view.size[k]);
      stage.draw();
      changed(true);
    },
  });
  const patches = patchView({ changed: () => changed(true), drop: (patch) => { state.patches = state.patches.filter((p) => p !== patch); stage.draw(); changed(true); } });
  const counters = counterView();
  const machine = machineForm(() => changed()), scene = sceneForm(() => changed());

  const groups = new Map();
  for (const [name, { group, title }] of Object.entries(data.maps)) groups.set(group, [...(groups.get(group) || []), [name, title]]);
  const mapChoice = choice([["", "Only the picture"], ...[...groups].map(([group, options]) => ({ group, options }))], state.map, (name) => {
    state.map = name;
    stage.draw();
    if (name && data.maps[name].per === "pixel") changed(true);
    else keepState();
  }, { id: "map-choice" });
  const opacity = h("input", { type: "range", min: "0", max: "100", id: "opacity", oninput: () => { state.opacity = opacity.value / 100; stage.draw(); keepState(); } });
  const log = tick("Logarithmic", state.log, (on) => { state.log = on; stage.draw(); keepState(); });
  const grid = tick("Tile borders", state.grid, (on) => { state.grid = on; stage.draw(); keepState(); });
  const reset = h("button", { type: "button", id: "reset", onclick: () => { readState(""); refresh(); changed(); } }, "Reset all");
  const home = h("button", { type: "button", id: "home", onclick: () => { state.camera = null; changed(); } }, "First view");

  function refresh() {
    mapChoice.value = state.map;
    opacity.value = String(100 * state.opacity);
    log.firstChild.checked = state.log;
    grid.firstChild.checked = state.grid;
    machine.refresh();
    scene.refresh();
  }
  addEventListener("hashchange", () => {
    if (location.hash.slice(1) === stateText()) return;
    readState(location.hash.slice(1));
    refresh();
    changed();
  });

  const keys = h("p", { class: "quiet keys", id: "stage-keys" }, "Keys on the picture: arrows turn the camera, Shift and arrows move it, + and − zoom, Home is the first view, Escape lets tile and patches go. ",
    "Ctrl and a click keeps the patches chosen before.");
  const header = topOfPage(data.title, `${data.about ? `${data.about}. ` : ""}${plural(data.patches, "patch").replace("patchs", "patches")}, ${data.size.join(" × ")} pixels. tilesim ${data.version}.`, []);
  const page = h("main", { class: "explorer" },
    h("div", { class: "forms" }, machine.element, scene.element),
    h("div", { class: "middle" },
      h("div", { class: "bar" }, field("Map", mapChoice), field("Opacity", opacity), h("span", { class: "ticks" }, log, grid), home, reset),
      stage.element, alert, status, counters.figures, keys),
    h("div", { class: "beside-it" }, queue.element, patches.element),
    counters.element);
  refresh();
  return { elements: [header, page], begin: () => changed() };
}

try {
  readState(location.hash.slice(1));
  const made = explorer();
  document.body.append(...made.elements);
  made.begin();
} catch (error) {
  document.body.append(h("p", { class: "bad", role: "alert" }, `The explorer cannot be shown: ${error.message}`));
  throw error;
}
