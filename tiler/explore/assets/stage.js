// The picture: map over it, the patches' boxes, the tile and the patch pointed at; and the hand that turns the camera.

const BOX_COLOURS = ["#ffffff", "#4ea7e0", "#ee8a55", "#3cc09b", "#dc94c3", "#dcb640", "#9aa0f0", "#c7d36a", "#e46a6a"];
const DRAG = 4; // screen pixels that a click may move

/** The colour and dash of a bound's boxes, the same as long as the page is open. */
function boxStyle(name) {
  const k = data.form.find((field) => field.name === "bounds").choices.indexOf(name);
  return { colour: BOX_COLOURS[(k + 1) % BOX_COLOURS.length], dash: ["none", "7 4", "2 3"][k % 3] };
}

function makeStage({ moved, chosen, moving }) {
  const canvas = h("canvas", { "aria-hidden": "true" });
  const mark = h("canvas", { class: "mark", "aria-hidden": "true" });
  const tileBox = h("div", { class: "tile-box", hidden: true }), overBox = h("div", { class: "over-box", hidden: true });
  const lines = h("svg", { class: "boxes", viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" });
  const stage = h("div", {
    id: "stage", class: "stage", tabindex: "0", role: "application", "aria-label": "Picture; drag or use the keys to turn the camera",
    "aria-describedby": "stage-keys", "--width": data.size[0], "--height": data.size[1],
  }, canvas, mark, lines, overBox, tileBox);
  const legend = h("div", { class: "legend" });
  const pointed = h("p", { class: "quiet", id: "pointed" }, "");
  const live = h("p", { class: "live", role: "status", "aria-live": "polite", id: "live" });
  let view = null, picture = null, grey = null, over = null;

  function toCanvas(pixels, width, height) {
    const made = h("canvas", { width, height });
    made.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
    return made;
  }

  function showView(next) {
    view = next;
    const [width, height] = view.size, colour = new Uint8ClampedArray(view.picture.slice().buffer);
    picture = toCanvas(colour, width, height);
    const light = new Uint8ClampedArray(colour);
    for (let i = 0; i < light.length; i += 4) light[i] = light[i + 1] = light[i + 2] = (54 * light[i] + 183 * light[i + 1] + 19 * light[i + 2]) >> 8;
    grey = toCanvas(light, width, height);
    for (const c of [canvas, mark]) [c.width, c.height] = [width, height];
    draw();
  }

  const values = () => state.map && view.maps[state.map] || null;

  function draw() {
    if (!view) return;
    const [width, height] = view.size, context = canvas.getContext("2d"), found = values();
    context.drawImage(state.map ? grey : picture, 0, 0);
    const top = found ? describe(found).largest : 0;
    if (found) {
      const pixel = data.maps[state.map].per === "pixel", [columns, rows] = pixel ? view.size : view.grid;
      context.save();
      context.imageSmoothingEnabled = false;
      context.globalAlpha = state.opacity;
      context.drawImage(paint(found, columns, rows, top, state.log), 0, 0, pixel ? width : columns * view.tile, pixel ? height : rows * view.tile);
      context.restore();
    }
    if (state.grid) {
      context.fillStyle = "rgb(255 255 255 / 0.45)";
      for (let x = view.tile; x < width; x += view.tile) context.fillRect(x, 0, 1, height);
      for (let y = view.tile; y < height; y += view.tile) context.fillRect(0, y, width, 1);
    }
    drawLegend(top);
    drawBoxes();
    drawMark();
    point();
  }

  function drawLegend(top) {
    legend.replaceChildren();
    if (!state.map) return;
    const { title, unit, per } = data.maps[state.map];
    const bar = h("canvas", { width: 256, height: 1, "aria-hidden": "true" }), image = new ImageData(256, 1);
    for (let i = 0; i < 256; i++) image.data.set([RAMP[3 * i], RAMP[3 * i + 1], RAMP[3 * i + 2], 255], 4 * i);
    bar.getContext("2d").putImageData(image, 0, 0);
    const half = state.log ? Math.expm1(0.5 * Math.log1p(top)) : top / 2;
    legend.append(h("div", { class: "scale" }, h("span", { class: "scale-name" }, values() ? title : `${title}: 0 everywhere`),
      h("div", { class: "ramp" }, bar),
      h("div", { class: "ends" }, h("span", {}, "0"), h("span", {}, show(top > 10 ? Math.round(half) : half)), h("span", {}, `${show(top)} ${unit} a ${per}`))));
  }

  function setBox(box, tile) {
    box.hidden = !tile || !view;
    if (box.hidden) return;
    const [width, height] = view.size, [column, row] = tile, side = view.tile;
    box.style.left = `${100 * column * side / width}%`;
    box.style.top = `${100 * row * side / height}%`;
    box.style.width = `${100 * (Math.min(width, (column + 1) * side) - column * side) / width}%`;
    box.style.height = `${100 * (Math.min(height, (row + 1) * side) - row * side) / height}%`;
  }

  const pixelAt = ([x, y]) => [Math.min(view.size[0] - 1, Math.floor(x * view.size[0])), Math.min(view.size[1] - 1, Math.floor(y * view.size[1]))];
  const tileAt = (part) => pixelAt(part).map((v) => Math.floor(v / view.tile));
  const patchAt = (part) => { const [x, y] = pixelAt(part); return view.under[y * view.size[0] + x]; };

  function drawBoxes() {
    setBox(tileBox, state.point && tileAt(state.point));
    const made = view.boxes.filter((box) => state.patches.includes(box.patch)).map((box) => {
      const style = boxStyle(box.bound);
      const d = box.lines.map(([x0, y0, x1, y1]) => `M${x0} ${y0}L${x1} ${y1}`).join("");
      const one = (cls, colour) => h("path", { d, class: cls, stroke: colour, "stroke-dasharray": cls === "halo" ? "none" : style.dash });
      return h("g", { class: box.part < 0 ? "box" : "box part", "data-bound": box.bound, "data-patch": box.patch }, one("halo", "#000"), one("edge", style.colour));
    });
    lines.replaceChildren(...made);
  }

  /** Where the chosen patches are seen. */
  function drawMark() {
    const context = mark.getContext("2d"), [width, height] = view.size;
    context.clearRect(0, 0, width, height);
    if (!state.patches.length) return;
    const chosenOnes = new Set(state.patches), image = new ImageData(width, height), pixels = new Uint32Array(image.data.buffer);
    const inside = (x, y) => x >= 0 && y >= 0 && x < width && y < height && chosenOnes.has(view.under[y * width + x]);
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        if (!inside(x, y)) continue;
        const border = !inside(x - 1, y) || !inside(x + 1, y) || !inside(x, y - 1) || !inside(x, y + 1);
        pixels[y * width + x] = border ? 0xffffffff : 0x38ffffff;
      }
    }
    context.putImageData(image, 0, 0);
  }

  /** What lies under the pointer. */
  function point() {
    setBox(overBox, over && view && tileAt(over));
    if (!over || !view) {
      pointed.textContent = "Drag turns the camera, Shift and drag moves it, the wheel zooms; a click looks into a tile and its patch.";
      return;
    }
    const [column, row] = tileAt(over), at = row * view.grid[0] + column, patch = patchAt(over);
    const of = (name) => view.maps[name] ? view.maps[name][at] : 0;
    const words = [`Tile ${column}, ${row}`, `${show(of("queue_entries"))} in its queue`];
    if (view.machine.binning !== "triangle") words.push(`${plural(of("ds_invocations"), "domain-shader invocation")}`);
    if (state.map && values() && !["queue_entries", "ds_invocations"].includes(state.map)) {
      const value = data.maps[state.map].per === "tile" ? values()[at] : values()[pixelAt(over)[1] * view.size[0] + pixelAt(over)[0]];
      words.push(`${data.maps[state.map].title}: ${show(value)}`);
    }
    words.push(patch >= 0 ? `patch ${patch}` : "no patch");
    pointed.textContent = words.join(" · ");
  }

  // The hand.
  const partOf = (event) => {
    const box = stage.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height].map((v) => Math.min(1, Math.max(0, v)));
  };
  const cameraNow = () => state.camera || (view ? view.camera : data.camera);
  function move(camera) {
    state.camera = { eye: camera.eye, target: camera.target };
    moved();
  }
  let held = null; // {x, y, far}
  stage.addEventListener("pointerdown", (event) => {
    if (event.button > 2 || !event.isPrimary) return;
    stage.setPointerCapture(event.pointerId);
    held = { x: event.clientX, y: event.clientY, far: 0, pan: event.button > 0 || event.shiftKey };
  });
  stage.addEventListener("pointermove", (event) => {
    over = partOf(event);
    if (!held) return point();
    const right = event.clientX - held.x, down = event.clientY - held.y;
    held.far += Math.hypot(right, down);
    if (held.far < DRAG) return;
    [held.x, held.y] = [event.clientX, event.clientY];
    const box = stage.getBoundingClientRect();
    moving(true);
    move(held.pan ? pan(cameraNow(), -right / box.height, down / box.height)
      : orbit(cameraNow(), -right / box.width * Math.PI * 1.2, down / box.height * Math.PI * 0.8));
  });
  const release = (event) => {
    if (!held) return;
    const click = held.far < DRAG && event.type === "pointerup" && event.button === 0;
    held = null;
    moving(false);
    if (click && view) chosen(partOf(event), patchAt(partOf(event)), event.ctrlKey || event.metaKey);
  };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  stage.addEventListener("pointerleave", () => { over = null; if (view) point(); });
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    move(zoom(cameraNow(), Math.exp(0.0015 * Math.min(400, Math.max(-400, event.deltaY * (event.deltaMode ? 30 : 1))))));
  }, { passive: false });
  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const turn = Math.PI / 36, step = 0.05;
    const by = event.shiftKey ? (x, y) => pan(cameraNow(), x * step, y * step) : (x, y) => orbit(cameraNow(), x * turn, y * turn);
    const keys = {
      ArrowLeft: () => move(by(-1, 0)), ArrowRight: () => move(by(1, 0)), ArrowUp: () => move(by(0, 1)), ArrowDown: () => move(by(0, -1)),
      "+": () => move(zoom(cameraNow(), 1 / 1.1)), "=": () => move(zoom(cameraNow(), 1 / 1.1)), "-": () => move(zoom(cameraNow(), 1.1)),
      Home: () => { state.camera = null; moved(); }, Escape: () => chosen(null, -1, false),
    };
    if (!(event.key in keys)) return;
    keys[event.key]();
    event.preventDefault();
  });

  return { element: [stage, pointed, legend, live], stage, live, show: showView, draw, tileAt, view: () => view };
}
