// Forms of the machine and the scene, made from what the server says of their fields.

const WORDS = { null: "the model's own" };

/** A number as typed; null where the field is empty and may be; undefined where it is no number. */
function typed(text, { whole, none }) {
  if (text.trim() === "") return none ? null : undefined;
  const value = Number(text);
  return Number.isFinite(value) && (!whole || Number.isInteger(value)) ? value : undefined;
}

function machineForm(changed) {
  const rows = new Map();
  const set = (name, value) => {
    setField(name, value);
    refresh();
    changed();
  };

  function control(f) {
    const id = `field-${f.name}`;
    if (f.kind === "choice") {
      const options = [...(f.none ? [["null", WORDS.null]] : []), ...f.choices.map((value) => [JSON.stringify(value), String(value)])];
      const made = choice(options, "", (value) => set(f.name, JSON.parse(value)), { id });
      return { made, put: (value) => { made.value = JSON.stringify(value); } };
    }
    if (f.kind === "tick") {
      const made = h("input", { type: "checkbox", id, onchange: () => set(f.name, made.checked) });
      return { made, put: (value) => { made.checked = value; } };
    }
    if (f.kind === "list") {
      const boxes = f.choices.map((name) => {
        const box = h("input", { type: "checkbox", value: name, onchange: () => {
          const now = machineNow()[f.name].filter((one) => one !== name);
          set(f.name, box.checked ? f.choices.filter((one) => one === name || now.includes(one)) : now);
        } });
        return box;
      });
      const made = h("fieldset", { class: "list", id }, h("legend", { class: "unseen" }, f.name),
        boxes.map((box) => h("label", { class: "tick" }, box, h("span", {}, box.value))));
      return { made, put: (value) => { for (const box of boxes) box.checked = value.includes(box.value); } };
    }
    const made = h("input", { type: "text", id, inputmode: f.kind === "number" ? "decimal" : null, autocomplete: "off", spellcheck: "false",
      placeholder: f.none ? WORDS.null : null, onchange: () => {
        const value = f.kind === "number" ? typed(made.value, f) : made.value.trim();
        made.setAttribute("aria-invalid", String(value === undefined));
        if (value !== undefined) set(f.name, value);
      } });
    return { made, put: (value) => { made.value = value === null ? "" : String(value); made.removeAttribute("aria-invalid"); } };
  }

  const preset = choice([["", "changed"], ...Object.keys(data.presets).map((name) => [name, name])], "", (name) => {
    if (!name) return;
    for (const [field, value] of Object.entries(data.presets[name])) setField(field, value);
    refresh();
    changed();
  }, { id: "preset" });

  function refresh() {
    const now = machineNow();
    for (const [name, row] of rows) {
      row.put(now[name]);
      row.line.classList.toggle("changed", Object.hasOwn(state.machine, name));
    }
    const found = Object.entries(data.presets).find(([, fields]) => same(fields, { ...fields, ...now }));
    preset.value = found ? found[0] : "";
  }

  const lines = data.form.map((f) => {
    const { made, put } = control(f);
    const name = f.kind === "list" ? h("span", { class: "name" }, f.name) : h("label", { class: "name", for: made.id }, f.name);
    const line = h("div", { class: f.kind === "list" ? "row whole" : "row", title: f.text.replaceAll("`", "") }, name, made);
    rows.set(f.name, { put, line });
    return line;
  });
  const element = part("machine", "Machine", h("div", { class: "row" }, h("label", { class: "name", for: "preset" }, "preset"), preset), lines,
    h("p", { class: "quiet" }, "Fields that differ from the machine as started are set in bold."));
  refresh();
  return { element, refresh };
}

function sceneForm(changed) {
  const set = (name, value) => {
    if (value === null) delete state.scene[name];
    else state.scene[name] = value;
    changed();
  };
  const shading = choice(data.shadings.map((name) => [name, name]), "", (value) => set("shading", value === data.shading ? null : value), { id: "shading" });
  const samples = choice([["1", "1"], ["4", "4"]], "", (value) => set("samples", Number(value) === data.samples ? null : Number(value)), { id: "samples" });
  const factor = h("input", { type: "text", id: "factor", inputmode: "decimal", autocomplete: "off", placeholder: data.factor, onchange: () => {
    const value = typed(factor.value, { none: true });
    factor.setAttribute("aria-invalid", String(value === undefined));
    if (value !== undefined) set("factor", value);
  } });
  const last = Math.max(1, data.frames - 1);
  const frame = h("input", { type: "range", id: "frame", min: "0", max: String(last), step: "1", oninput: () => {
    state.frame = Number(frame.value);
    told.textContent = frame.value;
    changed();
  } });
  const told = h("output", { for: "frame" });
  const line = (name, made, more) => h("div", { class: "row" }, h("label", { class: "name", for: made.id }, name), made, more);
  function refresh() {
    shading.value = state.scene.shading || data.shading;
    samples.value = String(state.scene.samples || data.samples);
    factor.value = state.scene.factor ? String(state.scene.factor) : "";
    frame.value = String(state.frame);
    told.textContent = String(state.frame);
  }
  refresh();
  return {
    refresh,
    element: part("scene", "Scene", line("shading", shading), line("tessellation factor", factor), line("samples a pixel", samples),
      line("frame", frame, told)),
  };
}
