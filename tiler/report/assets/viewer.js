// The maps over the picture: two machines with a divider between them, and what there is to say of the place pointed at.

const LOUPE = 13; // pixels across

function mapViewer() {
  const [width, height] = data.size;
  const names = Object.keys(data.maps);
  const several = data.machines.length > 1;
  const state = {
    map: names[0] || "", left: 0, right: several ? data.machines.length - 1 : -1, split: several ? 0.5 : 1,
    opacity: 0.75, log: false, shared: true, grid: false, x: width >> 1, y: height >> 1, known: false, pinned: false,
  };
  const pictures = []; // {color, grey}, canvases
  const maps = data.machines.map(() => ({})); // typed arrays by machine and name, once they are unpacked
  const patches = data.machines.map(() => null); // {points, triangles, object_id, rect}
  const layers = new Map(); // painted maps
  let under = null, seen = null; // patch at each pixel; {pixels, box} by patch

  const canvas = h("canvas", { width, height, "aria-hidden": "true" });
  const mark = h("canvas", { width, height, class: "mark", "aria-hidden": "true" });
  const tileBox = h("div", { class: "tile-box", hidden: true });
  const boundBox = h("div", { class: "bound-box", hidden: true });
  const labels = [h("span", { class: "side left" }), h("span", { class: "side right" })];
  const divider = h("div", {
    class: "divider", role: "slider", tabindex: "0", "aria-label": "Divider between the machines",
    "aria-valuemin": "0", "aria-valuemax": "100", "aria-orientation": "horizontal",
  }, h("span", {}));
  const stage = h("div", {
    id: "stage", class: "stage", tabindex: "0", role: "application", "aria-label": "Map over the picture",
    "aria-describedby": "stage-keys", "--width": width, "--height": height,
  }, canvas, mark, boundBox, tileBox, labels, divider);
  const legend = h("div", { class: "legend" });
  const note = h("p", { class: "quiet", id: "map-text" });
  const live = h("p", { class: "live", role: "status", "aria-live": "polite", id: "live" });
  const readout = h("div", { class: "readout", id: "readout" });
  const loupe = h("canvas", { class: "loupe", width: LOUPE, height: LOUPE, "aria-hidden": "true" });
  const numbers = h("div", { class: "numbers" });

  const sides = () => state.right < 0 || state.right === state.left ? [state.left] : [state.left, state.right];
  const sideAt = (x) => x < state.split * width || state.right < 0 ? state.left : state.right;
  const info = () => data.maps[state.map];
  const has = (machine, name) => Object.hasOwn(data.machines[machine].maps, name);
  const values = (machine) => maps[machine][state.map];

  // What a place holds.
  function valueAt(machine, name, x, y) {
    const found = maps[machine][name];
    if (!found) return has(machine, name) ? NaN : 0;
    if (data.maps[name].per === "pixel") return found[y * width + x];
    const { tile, grid } = data.machines[machine];
    return found[Math.floor(y / tile) * grid[0] + Math.floor(x / tile)];
  }

  function tops() {
    const own = sides().map((machine) => describe(values(machine) || NOTHING).largest);
    return state.shared ? own.map(() => Math.max(...own)) : own;
  }

  function layer(machine, top) {
    const found = values(machine);
    if (!found) return null;
    const key = [machine, state.map, top, state.log].join();
    if (!layers.has(key)) {
      if (layers.size > 12) layers.clear();
      const [columns, rows] = info().per === "pixel" ? data.size : data.machines[machine].grid;
      layers.set(key, paint(found, columns, rows, top, state.log));
    }
    return layers.get(key);
  }

  // Drawing.
  function draw() {
    const context = canvas.getContext("2d");
    const cut = Math.round(state.split * width);
    const top = tops();
    context.clearRect(0, 0, width, height);
    sides().forEach((machine, k, all) => {
      context.save();
      context.beginPath();
      context.rect(k ? cut : 0, 0, all.length > 1 && !k ? cut : width, height);
      context.clip();
      const picture = pictures[data.machines[machine].picture];
      if (picture) context.drawImage(state.map ? picture.grey : picture.color, 0, 0);
      const map = state.map && layer(machine, top[k]);
      const { tile, grid } = data.machines[machine];
      if (map) {
        context.imageSmoothingEnabled = false;
        context.globalAlpha = state.opacity;
        if (info().per === "pixel") context.drawImage(map, 0, 0);
        else context.drawImage(map, 0, 0, grid[0] * tile, grid[1] * tile);
      }
      if (state.grid) lines(context, tile, grid);
      context.restore();
    });
    const two = sides().length > 1;
    divider.hidden = !two;
    divider.style.left = `${100 * state.split}%`;
    divider.setAttribute("aria-valuenow", String(Math.round(100 * state.split)));
    divider.setAttribute("aria-valuetext",
      two ? `${Math.round(100 * state.split)} % ${data.machines[state.left].name}, the rest ${data.machines[state.right].name}` : "");
    labels.forEach((label, k) => {
      label.hidden = !several || k >= sides().length;
      label.textContent = label.hidden ? "" : data.machines[sides()[k]].name;
    });
    drawLegend(top);
  }

  function lines(context, tile, grid) {
    context.globalAlpha = 0.45;
    context.fillStyle = "#fff";
    for (let x = 1; x < grid[0]; x++) context.fillRect(x * tile, 0, 1, height);
    for (let y = 1; y < grid[1]; y++) context.fillRect(0, y * tile, width, 1);
  }

  function drawLegend(top) {
    legend.replaceChildren();
    if (!state.map) return;
    const scales = new Set(top).size > 1 ? sides().map((machine, k) => [data.machines[machine].name, top[k], machine])
      : [["", top[0], null]];
    for (const [name, most, machine] of scales) {
      const half = state.log ? Math.expm1(0.5 * Math.log1p(most)) : most / 2;
      const bar = h("canvas", { width: 256, height: 1, "aria-hidden": "true" });
      const image = new ImageData(256, 1);
      for (let i = 0; i < 256; i++) image.data.set([RAMP[3 * i], RAMP[3 * i + 1], RAMP[3 * i + 2], 255], 4 * i);
      bar.getContext("2d").putImageData(image, 0, 0);
      const pointers = state.known ? sides().filter((m) => machine === null || m === machine).map((m) => {
        const value = valueAt(m, state.map, state.x, state.y);
        return h("i", { class: m === sideAt(state.x) ? "here" : null, "--at": place(value, most, state.log) });
      }) : [];
      legend.append(h("div", { class: "scale" },
        name && h("span", { class: "scale-name" }, name),
        h("div", { class: "ramp" }, bar, pointers),
        h("div", { class: "ends" }, h("span", {}, "0"), h("span", {}, show(most > 10 ? Math.round(half) : half)),
          h("span", {}, `${show(most)} ${info().unit} a ${info().per}`))));
    }
  }

  // The place pointed at.
  function point(x, y, known = true) {
    state.x = Math.min(width - 1, Math.max(0, Math.floor(x)));
    state.y = Math.min(height - 1, Math.max(0, Math.floor(y)));
    state.known = state.known || known;
    tell();
  }

  function tell() {
    drawBoxes();
    drawLoupe();
    drawReadout();
    drawLegend(tops());
    clearTimeout(tell.later);
    tell.later = setTimeout(say, 150);
  }

  function boxStyle(box, x0, y0, x1, y1) {
    box.hidden = !state.known || x1 <= x0 || y1 <= y0;
    box.style.left = `${100 * x0 / width}%`;
    box.style.top = `${100 * y0 / height}%`;
    box.style.width = `${100 * (Math.min(x1, width) - x0) / width}%`;
    box.style.height = `${100 * (Math.min(y1, height) - y0) / height}%`;
  }

  function drawBoxes() {
    const machine = sideAt(state.x), { tile } = data.machines[machine];
    const x0 = Math.floor(state.x / tile) * tile, y0 = Math.floor(state.y / tile) * tile;
    boxStyle(tileBox, x0, y0, x0 + tile, y0 + tile);
    const patch = patchAt(state.x, state.y), facts = patches[machine];
    if (patch >= 0 && facts) boxStyle(boundBox, ...facts.rect.slice(4 * patch, 4 * patch + 4));
    else boundBox.hidden = true;
    drawPatch(state.known ? patch : -1);
  }

  function patchAt(x, y) {
    return under ? under[y * width + x] : -1;
  }

  /** Shows where the patch is seen: its outline, and a breath of white inside that leaves the map's colours readable. */
  function drawPatch(patch) {
    if (patch === drawPatch.last) return;
    drawPatch.last = patch;
    const context = mark.getContext("2d");
    context.clearRect(0, 0, width, height);
    if (patch < 0) return;
    const { x0, y0, x1, y1 } = seen[patch];
    const image = new ImageData(x1 - x0 + 1, y1 - y0 + 1), pixels = new Uint32Array(image.data.buffer);
    for (let y = y0; y <= y1; y++) {
      for (let x = x0; x <= x1; x++) {
        if (patchAt(x, y) !== patch) continue;
        const inside = x >= x0 + 2 && x <= x1 - 2 && y >= y0 + 2 && y <= y1 - 2 && patchAt(x - 2, y) === patch
          && patchAt(x + 2, y) === patch && patchAt(x, y - 2) === patch && patchAt(x, y + 2) === patch;
        pixels[(y - y0) * image.width + x - x0] = inside ? 0x30ffffff : 0xe0ffffff;
      }
    }
    context.putImageData(image, x0, y0);
  }

  function drawLoupe() {
    const context = loupe.getContext("2d");
    const half = LOUPE >> 1;
    context.clearRect(0, 0, LOUPE, LOUPE);
    const picture = pictures[data.machines[sideAt(state.x)].picture];
    if (picture && state.known) context.drawImage(picture.color, half - state.x, half - state.y);
    loupe.hidden = !state.known;
  }

  /** Lines of the read-out: the same wherever one points, so that nothing jumps. */
  function rowsToTell() {
    const known = Object.keys(data.maps).filter((name) => data.maps[name].per === "tile" && sides().some((m) => has(m, name)));
    const reasons = known.filter((name) => name.startsWith("blame:") && name !== "blame:useful");
    const main = known.filter((name) => data.maps[name].group === "Overview");
    const told = main.flatMap((name) => name === "wasted_domain_points" ? [name, ...reasons] : [name]);
    return state.map && info().per === "tile" && !told.includes(state.map) ? [state.map, ...told] : told;
  }

  /** Triangle binning shades in the front end: there is nothing to say of its tiles. */
  function inNoTile(machine, name) {
    return data.machines[machine].fields.binning === "triangle"
      && (name === "ds_invocations" || name === "wasted_domain_points" || name.startsWith("blame:"));
  }

  function told(machine, name) {
    return inNoTile(machine, name) ? "–" : show(valueAt(machine, name, state.x, state.y));
  }

  function drawReadout() {
    if (!state.known) {
      readout.replaceChildren(h("p", { class: "quiet" }, "Point at the map, or focus it and use the arrow keys."));
      return;
    }
    const machine = sideAt(state.x), { tile } = data.machines[machine];
    const column = Math.floor(state.x / tile), row = Math.floor(state.y / tile);
    const heads = sides().length > 1 && h("thead", {}, h("tr", {}, h("td", {}),
      sides().map((m) => h("th", { scope: "col", class: m === machine ? "number here" : "number" }, nameOf(data.machines[m])))));
    const line = (name) => h("tr", { class: name === state.map ? "current" : name.startsWith("blame:") ? "of" : null },
      h("th", { scope: "row", title: data.maps[name].text }, data.maps[name].title),
      sides().map((m) => h("td", { class: "number" }, told(m, name))));
    const pixelMaps = Object.keys(data.maps).filter((name) => data.maps[name].per === "pixel");
    readout.replaceChildren(
      h("h3", {}, `Tile ${column}, ${row}`, h("small", {}, `${tile} × ${tile} pixels, ${nameText(machine)}`)),
      h("table", {}, heads, h("tbody", {}, rowsToTell().map(line))),
      h("h3", {}, `Pixel ${state.x}, ${state.y}`, state.pinned && h("small", {}, "held; click to let go")),
      h("div", { class: "pixel" }, loupe, h("div", {},
        pixelMaps.length > 0 && h("table", {}, h("tbody", {}, pixelMaps.map(line))), under && patchText(machine))));
  }

  function nameText(machine) {
    return data.machines[machine].name;
  }

  function patchLines(machine) {
    const patch = patchAt(state.x, state.y);
    if (patch < 0) return under ? ["No patch is seen here."] : [];
    const lines = [`Patch ${patch}`, `seen in ${plural(seen[patch].pixels, "pixel")}`];
    const facts = patches[machine];
    if (facts) {
      const [x0, y0, x1, y1] = facts.rect.slice(4 * patch, 4 * patch + 4), { tile } = data.machines[machine];
      const tiles = Math.max(0, Math.ceil(x1 / tile) - Math.floor(x0 / tile)) * Math.max(0, Math.ceil(y1 / tile) - Math.floor(y0 / tile));
      lines.push(`object ${facts.object_id[patch]}`,
        `${plural(facts.points[patch], "domain point")}, ${plural(facts.triangles[patch], "triangle")}`,
        `bound ${x1 - x0} × ${y1 - y0} pixels, over ${plural(tiles, "tile")}`);
    }
    return lines;
  }

  function patchText(machine) {
    return h("p", { class: "patch" }, patchLines(machine).map((line) => h("span", {}, line)));
  }

  function say() {
    if (!state.known) return;
    const machine = sideAt(state.x), { tile } = data.machines[machine];
    const there = state.map ? sides().map((m) => `${told(m, state.map)}${several ? ` in ${nameText(m)}` : ""}`)
      : [];
    live.textContent = `Tile ${Math.floor(state.x / tile)}, ${Math.floor(state.y / tile)}. `
      + (state.map ? `${info().title}, ${info().unit}: ${there.join("; ")}. ` : "") + patchLines(machine).slice(0, 2).join(", ");
  }

  // Figures of the whole map: what the picture says, in numbers.
  function drawNumbers() {
    const front = state.map ? sides().filter((m) => inNoTile(m, state.map)).map(nameText) : [];
    note.replaceChildren(...prose(state.map ? info().text : "The picture."),
      front.length ? ` ${front.join(" and ")}: shaded in the front end, in no tile.` : "");
    if (!state.map) {
      numbers.replaceChildren();
      return;
    }
    const of = sides().map((machine) => ({ machine, figures: describe(values(machine) || NOTHING) }));
    const lines = [
      ["sum", (f) => f.sum], ["largest", (f) => f.largest], ["95th percentile", (f) => f.at(0.95)], ["median", (f) => f.at(0.5)],
      ["mean", (f) => f.length ? f.sum / f.length : 0],
      ["not 0", (f) => `${(f.length ? 100 * f.some / f.length : 0).toFixed(1)} %`],
    ];
    numbers.replaceChildren(
      h("h3", {}, `The whole map: ${info().title}, ${info().unit} a ${info().per}`),
      h("div", { class: "beside" }, h("table", { id: "map-numbers" },
        several && h("thead", {}, h("tr", {}, h("td", {}), of.map((o) => h("th", { scope: "col", class: "number" }, nameOf(data.machines[o.machine]))))),
        h("tbody", {}, lines.map(([title, make]) => h("tr", {}, h("th", { scope: "row" }, title),
          of.map((o) => { const v = make(o.figures); return h("td", { class: "number" }, typeof v === "string" ? v : show(v)); }))))),
      h("div", {}, h("button", { type: "button", id: "to-largest", onclick: () => toLargest() }, "Go to the largest"),
        info().per === "tile" && largestTiles())));
  }

  function ranked(machine) {
    const found = values(machine) || [];
    return Array.from(found.keys()).sort((a, b) => found[b] - found[a] || a - b);
  }

  function middle(machine, index) {
    const { tile, grid } = data.machines[machine];
    if (info().per === "pixel") return [index % width, Math.floor(index / width)];
    const x = (index % grid[0]) * tile, y = Math.floor(index / grid[0]) * tile;
    return [Math.floor((x + Math.min(width, x + tile)) / 2), Math.floor((y + Math.min(height, y + tile)) / 2)];
  }

  function toLargest(hold = true) {
    const machine = state.left, found = values(machine) || [];
    let best = 0;
    for (let i = 1; i < found.length; i++) if (found[i] > found[best]) best = i;
    if (!found.length) return;
    const [x, y] = middle(machine, best);
    state.pinned = hold;
    point(x, y);
  }

  /** The map as a table, for who cannot see it or wants the numbers. */
  function largestTiles() {
    const machine = state.left, other = sides()[1];
    const rows = ranked(machine).slice(0, 20).filter((index) => values(machine)[index] > 0);
    if (!rows.length) return null;
    const { grid } = data.machines[machine];
    return folded("largest", `Largest tiles of ${several ? nameText(machine) : "the map"}`,
      h("table", { id: "largest-tiles" }, h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "tile"),
        h("th", { scope: "col", class: "number" }, nameText(machine)),
        other !== undefined && h("th", { scope: "col", class: "number" }, `there: ${nameText(other)}`))),
      h("tbody", {}, rows.map((index) => {
        const [x, y] = middle(machine, index);
        return h("tr", {}, h("th", { scope: "row" }, h("button", { type: "button", class: "link", onclick: () => { state.pinned = true; point(x, y); } },
          `${index % grid[0]}, ${Math.floor(index / grid[0])}`)),
        h("td", { class: "number" }, show(values(machine)[index])),
        other !== undefined && h("td", { class: "number" }, show(valueAt(other, state.map, x, y))));
      }))));
  }

  function refresh() {
    draw();
    drawNumbers();
    tell();
  }

  // Controls.
  const groups = new Map();
  for (const name of names) {
    const { group, title } = data.maps[name];
    groups.set(group, [...(groups.get(group) || []), [name, title]]);
  }
  const mapChoice = choice([["", "Only the picture"], ...[...groups].map(([group, options]) => ({ group, options }))], state.map,
    (name) => { state.map = name; refresh(); }, { id: "map-choice" });
  const listed = data.machines.map((machine, k) => [String(k), machine.name]);
  const leftChoice = choice(listed, state.left, (k) => { state.left = Number(k); refresh(); }, { id: "left-choice" });
  const rightChoice = choice([["-1", "none"], ...listed], state.right, (k) => { state.right = Number(k); refresh(); }, { id: "right-choice" });
  const opacity = h("input", { type: "range", min: "0", max: "100", value: String(100 * state.opacity), id: "opacity",
    oninput: () => { state.opacity = opacity.value / 100; draw(); } });
  const controls = h("div", { class: "bar" },
    field("Map", mapChoice),
    several && [field("Left", leftChoice), field("Right", rightChoice)],
    field("Opacity", opacity),
    h("span", { class: "ticks" },
      tick("Logarithmic", state.log, (on) => { state.log = on; refresh(); }),
      several && tick("One scale for both", state.shared, (on) => { state.shared = on; refresh(); }),
      tick("Tile borders", state.grid, (on) => { state.grid = on; draw(); })));

  // Pointer: hover moves the read-out, a click holds it; the divider is dragged.
  const fraction = (event) => {
    const box = stage.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };
  stage.addEventListener("pointermove", (event) => {
    if (state.pinned || event.target.closest(".divider")) return;
    const [x, y] = fraction(event);
    point(x * width, y * height);
  });
  stage.addEventListener("click", (event) => {
    if (event.target.closest(".divider")) return;
    const [x, y] = fraction(event);
    state.pinned = !state.pinned;
    point(x * width, y * height);
  });
  function split(part) {
    state.split = Math.min(1, Math.max(0, part));
    draw();
    tell();
  }
  divider.addEventListener("pointerdown", (event) => {
    divider.setPointerCapture(event.pointerId);
    event.preventDefault();
    divider.focus();
  });
  divider.addEventListener("pointermove", (event) => {
    if (divider.hasPointerCapture(event.pointerId)) split(fraction(event)[0]);
  });
  divider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.01, ArrowDown: -0.01, ArrowRight: 0.01, ArrowUp: 0.01, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 };
    if (!(event.key in step) || event.ctrlKey || event.altKey || event.metaKey) return;
    split(state.split + step[event.key] * (event.shiftKey ? 10 : 1));
    event.preventDefault();
    event.stopPropagation();
  });
  stage.addEventListener("keydown", (event) => {
    if (event.target !== stage || event.ctrlKey || event.altKey || event.metaKey) return;
    const { tile } = data.machines[sideAt(state.x)];
    const step = event.shiftKey ? 1 : tile;
    const middleOf = (v, size) => Math.min(size - 1, Math.floor(v / tile) * tile + (tile >> 1));
    const [x, y] = event.shiftKey || !state.known ? [state.x, state.y] : [middleOf(state.x, width), middleOf(state.y, height)];
    const moves = {
      ArrowLeft: () => point(x - step, y), ArrowRight: () => point(Math.min(x + step, width - 1), y),
      ArrowUp: () => point(x, y - step), ArrowDown: () => point(x, Math.min(y + step, height - 1)),
      Home: () => point(0, y), End: () => point(width - 1, y),
      "[": () => turnMap(-1), "]": () => turnMap(1), Escape: () => { state.pinned = false; tell(); },
    };
    if (!(event.key in moves)) return;
    if (event.key.length > 1 && event.key !== "Escape") state.pinned = true;
    moves[event.key]();
    event.preventDefault();
  });
  function turnMap(by) {
    const all = ["", ...names];
    state.map = all[(all.indexOf(state.map) + by + all.length) % all.length];
    mapChoice.value = state.map;
    refresh();
  }

  // Unpacking: the pictures and the first map first, so that something is there at once.
  async function load() {
    await Promise.all(data.pictures.map(loadPicture));
    draw();
    for (const name of names) {
      await Promise.all(data.machines.map(async (machine, k) => {
        if (has(k, name)) maps[k][name] = await unpack(machine.maps[name]);
      }));
      if (name === state.map) refresh();
    }
    if (data.under !== null) {
      const found = await unpack(data.under);
      const most = found.reduce((a, b) => Math.max(a, b), 0);
      seen = Array.from({ length: most + 1 }, () => ({ pixels: 0, x0: width, y0: height, x1: -1, y1: -1 }));
      for (let i = 0; i < found.length; i++) {
        if (found[i] < 0) continue;
        const s = seen[found[i]], x = i % width, y = (i - x) / width;
        s.pixels++;
        if (x < s.x0) s.x0 = x;
        if (x > s.x1) s.x1 = x;
        if (y < s.y0) s.y0 = y;
        if (y > s.y1) s.y1 = y;
      }
      under = found;
    }
    await Promise.all(data.machines.map(async (machine, k) => {
      if (!machine.patches) return;
      const found = {};
      for (const [name, blob] of Object.entries(machine.patches)) found[name] = await unpack(blob);
      patches[k] = found;
    }));
    refresh();
    if (!state.known) toLargest(false);
    clearTimeout(tell.later); // nothing has been asked yet
    stage.dataset.ready = "true";
  }

  async function loadPicture(uri, k) {
    const image = new Image();
    image.src = uri;
    await image.decode();
    const color = h("canvas", { width, height }), grey = h("canvas", { width, height });
    const context = color.getContext("2d", { willReadFrequently: false });
    context.drawImage(image, 0, 0);
    const pixels = context.getImageData(0, 0, width, height);
    for (let i = 0; i < pixels.data.length; i += 4) {
      const light = (54 * pixels.data[i] + 183 * pixels.data[i + 1] + 19 * pixels.data[i + 2]) >> 8;
      pixels.data[i] = pixels.data[i + 1] = pixels.data[i + 2] = light;
    }
    grey.getContext("2d").putImageData(pixels, 0, 0);
    pictures[k] = { color, grey };
  }

  load().catch((error) => {
    note.textContent = `The maps cannot be unpacked (${error.message}); a browser of 2023 or newer can.`;
    note.className = "bad";
  });
  return part("map", "Map over the picture", controls,
    h("div", { class: "viewer" },
      h("div", { class: "view" }, stage, legend, note,
        data.left_out.length ? h("p", { class: "quiet" }, `Left out to keep the file small: ${data.left_out.join(", ")}.`) : null,
        h("p", { class: "quiet keys", id: "stage-keys" }, "Keys on the map: arrows from tile to tile, Shift and arrows by a pixel, ",
          "Home and End along the row, [ and ] for the map before and after, Escape lets go. A click holds the place."),
        numbers),
      h("aside", { "aria-label": "At the pointer" }, readout, live)));
}
