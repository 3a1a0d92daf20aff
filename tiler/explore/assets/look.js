// What there is to look at beside the picture: a tile's queue, the chosen patches and their boxes, figures and counters.

/** The queue of the tile that was clicked on. */
function queueView({ choose, tileTyped }) {
  const heading = h("small"), summary = h("div", { class: "fates" }), note = h("p", { class: "quiet" });
  const number = (label) => h("input", { type: "text", inputmode: "numeric", "aria-label": label, class: "tile-number", onchange: () => tileTyped(Number(column.value), Number(row.value)) });
  const column = number("Column of the tile"), row = number("Row of the tile");
  let only = null, shown = null, rows = [];
  const patchButton = (r) => r.patch < 0 ? "–" : h("button", {
    type: "button", class: "link", "aria-pressed": String(state.patches.includes(r.patch)), "data-patch": r.patch,
    title: "Draws its boxes; with Ctrl beside those of others", onclick: (event) => choose(r.patch, event.ctrlKey || event.metaKey),
  }, r.label);
  const columns = [
    { key: "order", title: "#", hint: "Place in the queue", numeric: true, cell: (r) => show(r.order), value: (r) => r.order },
    { key: "patch", title: "patch", hint: "Patch, and sub-domain or triangle of it", cell: patchButton, value: (r) => r.patch },
    { key: "fate", title: "fate", hint: "What became of it", cell: (r) => h("span", { class: `fate ${r.fate}`, title: data.fates[r.fate].text }, data.fates[r.fate].title), value: (r) => data.fates[r.fate].title },
    { key: "ds", title: "DS", hint: "Domain-shader invocations", numeric: true, cell: (r) => show(r.ds), value: (r) => r.ds },
    { key: "triangles", title: "tris", hint: "Triangles rasterized in the tile", numeric: true, cell: (r) => show(r.triangles), value: (r) => r.triangles },
    { key: "covered", title: "cov.", hint: "Samples covered, each a depth test", numeric: true, cell: (r) => show(r.covered), value: (r) => r.covered },
    { key: "visible", title: "seen", hint: "Samples that show it at the end", numeric: true, cell: (r) => show(r.visible), value: (r) => r.visible },
  ];
  const table = sortedTable({ id: "queue-table", caption: "Entries of the tile's queue in order", columns, rows: [], empty: "The queue is empty." });
  const body = h("div", { hidden: true }, summary, table.element, note);
  const hint = h("p", { class: "quiet" }, "Click a tile in the picture, or type its column and row, to see its queue in order and what became of each entry.");
  const element = part("queue", "Tile", h("div", { class: "bar small" }, field("column", column), field("row", row), heading), hint, body);

  function list() {
    table.show(only ? rows.filter((r) => r.fate === only) : rows);
    summary.replaceChildren(...[...new Set(rows.map((r) => r.fate))].map((name) => {
      const of = rows.filter((r) => r.fate === name);
      return h("button", { type: "button", class: `chip ${name}`, "aria-pressed": String(only === name), title: data.fates[name].text, onclick: () => {
        only = only === name ? null : name;
        list();
      } }, `${data.fates[name].title} ${show(of.reduce((sum, r) => sum + r.entries, 0))}`);
    }));
  }

  return {
    element,
    /** queue: of a reply, or null. A draft has none: the last one stays, dimmed. */
    show(queue, view) {
      element.classList.toggle("old", Boolean(shown) && !queue && Boolean(state.point));
      if (!state.point) shown = null;
      else if (queue) shown = queue;
      body.hidden = !shown;
      hint.hidden = Boolean(shown);
      heading.textContent = "";
      if (!shown) {
        column.value = row.value = "";
        return;
      }
      if (!queue) return;
      const { patch, triangle, domain, phase } = queue;
      rows = patch.map((p, k) => ({
        order: k + 1, patch: p, entries: queue.entries[k], fate: queue.fate[k], ds: queue.ds[k], triangles: queue.triangles[k], covered: queue.covered[k],
        visible: queue.visible[k],
        label: triangle ? `${p} △${triangle[k]}` : domain && !same(domain[k], [0, 1, 0, 1]) ? `${p} [${domain[k].map((v) => Number(v.toFixed(3))).join(" ")}]` : String(p),
      }));
      if (only && !rows.some((r) => r.fate === only)) only = null;
      [column.value, row.value] = [String(queue.column), String(queue.row)];
      const entries = rows.reduce((sum, r) => sum + r.entries, 0), seen = rows.filter((r) => r.fate === "visible").length;
      heading.textContent = `${show(entries)} ${entries === 1 ? "entry" : "entries"}, ${show(seen)} visible`;
      const passes = new Set(queue.pass.filter((v) => v >= 0)).size;
      note.textContent = [
        view.machine.binning === "triangle" ? "Entries are triangles; domain shading is the front end's." : domain ? "In brackets: the sub-domain's u and v from, to." : "",
        passes > 1 ? `Worked off in ${passes} passes.` : "", phase && new Set(phase).size > 1 ? "Two phases." : "",
      ].filter(Boolean).join(" ");
      list();
    },
    mark() {
      for (const button of element.querySelectorAll("[data-patch]")) button.setAttribute("aria-pressed", String(state.patches.includes(Number(button.dataset.patch))));
    },
  };
}

/** The chosen patches, and by which bounds their boxes are drawn. */
function patchView({ changed, drop }) {
  const names = data.form.find((f) => f.name === "bounds").choices;
  const ticks = h("div", { class: "bound-list" }), list = h("div", { class: "chips" }), table = h("div");
  const hint = h("p", { class: "quiet" }, "Click a patch in the picture or in a queue to draw its oriented boxes.");
  const body = h("div", { hidden: true }, list, ticks, table);
  return {
    element: part("patches", "Patches and their bounds", hint, body),
    show(view) {
      hint.hidden = state.patches.length > 0;
      body.hidden = !state.patches.length;
      if (body.hidden) return;
      const own = view.machine.bounds;
      const focused = document.activeElement && document.activeElement.dataset.bound;
      list.replaceChildren(...state.patches.map((p) => h("button", { type: "button", class: "chip", title: "Let it go", onclick: () => drop(p) }, `patch ${p} ×`)));
      ticks.replaceChildren(...names.map((name) => {
        const box = h("input", { type: "checkbox", "data-bound": name, disabled: name === own, onchange: () => {
          state.bounds = names.filter((one) => one === name ? box.checked : state.bounds.includes(one));
          changed();
        } });
        box.checked = name === own || state.bounds.includes(name);
        const style = boxStyle(name);
        const swatch = h("svg", { class: "swatch", viewBox: "0 0 22 6", "aria-hidden": "true" }, h("path", { d: "M0 3H22", stroke: style.colour, "stroke-width": 3, "stroke-dasharray": style.dash }));
        return h("label", { class: "tick" }, box, swatch, h("span", {}, name, name === own ? h("small", {}, " the machine's") : null));
      }));
      if (focused) ticks.querySelector(`[data-bound="${CSS.escape(focused)}"]`)?.focus();
      const whole = view.boxes.filter((box) => box.part < 0);
      const parts = view.boxes.length - whole.length;
      const size = ([x0, y0, x1, y1]) => `${x1 - x0} × ${y1 - y0}`;
      table.replaceChildren(h("table", { id: "box-table" }, h("thead", {}, h("tr", {}, ["patch", "bound", "pixels", "nearest depth"].map((t, k) => h("th", { scope: "col", class: k > 1 ? "number" : null }, t)))),
        h("tbody", {}, whole.map((box) => h("tr", {}, h("th", { scope: "row" }, String(box.patch)), h("td", {}, box.bound),
          h("td", { class: "number" }, size(box.rect)), h("td", { class: "number" }, box.z_min.toFixed(5)))))),
      parts ? h("p", { class: "quiet" }, `Thin lines: the boxes of ${plural(parts, "sub-domain")}.`) : "");
    },
  };
}

/** Key figures and all counters, beside those kept to compare with. */
function counterView() {
  let kept = null, last = null;
  const figures = h("div", { class: "tiles" }), size = h("p", { class: "quiet", id: "counted" });
  const find = h("input", { type: "search", id: "find-counter", placeholder: "name, stage or words of the definition", oninput: () => list() });
  const keep = h("button", { type: "button", id: "keep", onclick: () => { kept = last; draw(); } }, "Keep to compare");
  const forget = h("button", { type: "button", hidden: true, onclick: () => { kept = null; draw(); } }, "Forget");
  const value = (d) => last.counters[d.at], before = (d) => kept ? kept.counters[d.at] : null;
  const rows = data.definitions.map((d, at) => ({ ...d, at }));
  const columns = () => [
    { key: "name", title: "counter", cell: (d) => h("span", { title: d.text.replaceAll("`", "") }, h("code", {}, d.name)), value: (d) => d.name },
    { key: "value", title: "now", numeric: true, cell: (d) => show(value(d)), value },
    ...(kept ? [{ key: "kept", title: "kept", numeric: true, cell: (d) => show(before(d)), value: before },
      { key: "ratio", title: "ratio", numeric: true, cell: (d) => ratio(value(d), before(d)), value: (d) => before(d) ? value(d) / before(d) : null }] : []),
    { key: "unit", title: "unit", minor: true, cell: (d) => h("span", { class: "plain" }, d.unit), value: (d) => d.unit },
    { key: "stage", title: "stage", minor: true, cell: (d) => h("span", { class: "plain" }, d.stage), value: (d) => d.stage },
  ];
  const table = sortedTable({ id: "counter-table", caption: "Counters of the frame", columns: [], rows: [], empty: "No counter has that." });
  const element = part("counters", "Counters", size, h("div", { class: "bar small" }, field("search", find), keep, forget), table.element);

  function list() {
    const words = find.value.trim().toLowerCase();
    table.show(rows.filter((d) => (value(d) || before(d)) && (!words || `${d.name} ${d.stage} ${d.text}`.toLowerCase().includes(words))));
  }

  function draw() {
    forget.hidden = !kept;
    figures.replaceChildren(...data.figures.map((name) => {
      const d = rows.find((one) => one.name === name);
      const change = kept && kept.size.join() === last.size.join() ? ratio(value(d), before(d)) : "";
      return h("div", { class: "figure", title: d.text.replaceAll("`", "") }, h("span", { class: "name" }, name), h("strong", { "data-counter": name }, show(value(d))), h("span", { class: "ratio" }, change || d.unit));
    }));
    size.textContent = `${last.size.join(" × ")} pixels${last.full ? "" : ", a draft: counters of the full size follow"}; ${kept ? `kept: ${kept.size.join(" × ")}. ` : ""}counters that are 0 are not listed.`;
    element.classList.toggle("old", !last.full);
    table.columns(columns());
    list();
  }
  return { element, figures, show(view) { last = view; draw(); } };
}
