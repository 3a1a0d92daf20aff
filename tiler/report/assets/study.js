// A report of a study: how far it is, a plot of any counter over any axis, the table, what failed, how to run it again.

const OFFERED = 40; // values of an axis that are offered as a choice

/** The columns with their values, rows as objects that know their number only. */
async function readColumns() {
  return Promise.all(data.columns.map(async (column) => {
    const values = await unpack(column.values);
    const missing = "missing" in column ? await unpack(column.missing) : null;
    const at = (row) => missing && missing[row] ? null : column.texts ? column.texts[values[row]] : values[row];
    const numeric = !column.texts;
    const distinct = new Set();
    if (column.kind === "axis") for (let row = 0; row < values.length; row++) distinct.add(at(row));
    const listed = [...distinct].filter((v) => v !== null);
    if (numeric) listed.sort((a, b) => a - b);
    return { ...column, at, numeric, distinct: listed, count: values.length };
  }));
}

function studyTable(columns) {
  const named = Object.fromEntries(columns.map((c) => [c.name, c]));
  const rows = Array.from({ length: columns[0].count }, (_, row) => row);
  const axes = columns.filter((c) => c.kind === "axis");
  const turned = axes.filter((c) => c.distinct.length > 1);
  const counters = columns.filter((c) => c.numeric && ["counter", "check", "time"].includes(c.kind));
  const state = {
    words: "", only: {}, failed: false,
    shown: data.figures.filter((name) => name in named),
    y: named.ds_invocations ? "ds_invocations" : counters[0].name,
    x: (turned.find((c) => c.numeric && c.name !== "frame") || turned.find((c) => c.numeric) || turned.find((c) => c.name !== "machine") || axes[0]).name,
    by: (turned.find((c) => c.name === "machine") || turned.find((c) => c.name.startsWith("machine")) || axes[0]).name,
    log: false,
  };

  const ok = (row) => named.status.at(row) === "ok";
  const kept = () => {
    const words = state.words.toLowerCase().split(/\s+/).filter(Boolean);
    return rows.filter((row) => (!state.failed || !ok(row))
      && Object.entries(state.only).every(([name, value]) => value === "" || String(named[name].at(row)) === value)
      && words.every((word) => axes.some((c) => String(c.at(row)).toLowerCase().includes(word))
        || String(named.error.at(row) ?? "").toLowerCase().includes(word)));
  };

  const tableColumns = () => ["row", ...axes.map((c) => c.name), ...state.shown, "seconds", "status", ...(data.failed ? ["error"] : [])]
    .map((name) => named[name]).map((c) => ({
      key: c.name, title: c.name, hint: `${c.text}${c.unit ? ` Unit: ${c.unit}.` : ""}`, numeric: c.numeric, value: c.at,
      cell: (row) => c.numeric ? show(c.at(row)) : h("span", { class: "told", title: c.name === "error" ? c.at(row) : null }, c.at(row) ?? "–"),
    }));
  const table = sortedTable({ id: "study-table", caption: "Rows", columns: tableColumns(), rows: [], empty: "No row is left." });
  const found = h("output", { class: "found" });
  const plot = h("div", { id: "plot" });

  function lines(list) {
    const x = named[state.x], y = named[state.y], by = named[state.by];
    const sums = new Map();
    for (const row of list) {
      if (!ok(row) || y.at(row) === null || x.at(row) === null) continue;
      const line = sums.get(by.at(row)) || sums.set(by.at(row), new Map()).get(by.at(row));
      const sum = line.get(x.at(row)) || line.set(x.at(row), [0, 0]).get(x.at(row));
      sum[0] += y.at(row);
      sum[1]++;
    }
    const order = x.distinct;
    return by.distinct.filter((name) => sums.has(name)).map((name) => ({
      name: String(name),
      points: order.filter((at) => sums.get(name).has(at)).map((at) => {
        const [sum, count] = sums.get(name).get(at);
        return [x.numeric ? at : order.indexOf(at), sum / count];
      }),
    }));
  }

  function refresh() {
    const list = kept();
    found.textContent = `${show(list.length)} of ${show(rows.length)} rows`;
    table.columns(tableColumns());
    table.show(list);
    const made = lines(list), x = named[state.x], y = named[state.y];
    const title = `${y.name}${y.unit && y.unit !== y.name ? ` (${y.unit})` : ""}`;
    const label = (at) => x.numeric ? show(at) : x.distinct[at];
    const places = [...new Set(made.flatMap((line) => line.points.map((p) => p[0])))].sort((a, b) => a - b);
    plot.replaceChildren(
      h("p", { class: "quiet" }, `Mean of ${title} of the rows below, over ${x.name}. `, prose(y.text)),
      linePlot({ lines: made, categories: x.numeric ? null : x.distinct, xTitle: x.name, yTitle: title, log: state.log }),
      plotKeys(made),
      folded("plot", "The plot as a table", scroller("The plot as a table", h("table", { id: "plot-table" },
        h("thead", {}, h("tr", {}, h("th", { scope: "col" }, x.name), made.map((line) => h("th", { scope: "col", class: "number" }, line.name)))),
        h("tbody", {}, places.map((at) => h("tr", {}, h("th", { scope: "row" }, label(at)),
          made.map((line) => { const p = line.points.find((q) => q[0] === at); return h("td", { class: "number" }, p ? show(p[1]) : "–"); }))))))));
  }

  const pick = (key, list, label, id) => field(label, choice(list.map((c) => [c.name, c.name]), state[key],
    (name) => { state[key] = name; refresh(); }, { id }));
  const search = h("input", { type: "search", placeholder: "words of axes and errors", oninput: () => { state.words = search.value; refresh(); } });
  const filters = turned.filter((c) => c.distinct.length <= OFFERED).map((c) => field(c.name,
    choice([["", "all"], ...c.distinct.map((v) => [String(v), c.numeric ? show(v) : v])], "", (v) => { state.only[c.name] = v; refresh(); },
      { "data-filter": c.name })));
  const more = h("details", { class: "columns" }, h("summary", {}, "Columns"), h("div", { class: "ticks" }, counters.filter((c) => c.kind !== "time")
    .map((c) => tick(c.name, state.shown.includes(c.name), (on) => {
      const wanted = new Set(on ? [...state.shown, c.name] : state.shown.filter((name) => name !== c.name));
      state.shown = counters.map((d) => d.name).filter((name) => wanted.has(name));
      refresh();
    }))));
  refresh();
  narrow.addEventListener("change", refresh);
  return [
    part("plot-part", "Plot",
      h("div", { class: "bar" }, pick("y", counters, "Counter", "plot-y"), pick("x", axes, "Over", "plot-x"), pick("by", axes, "A line for each", "plot-by"),
        tick("Logarithmic", state.log, (on) => { state.log = on; refresh(); })), plot),
    part("rows", "Rows",
      h("div", { class: "bar" }, field("Search", search), filters,
        data.failed > 0 && tick("Failed only", false, (on) => { state.failed = on; refresh(); }), found),
      more, table.element),
  ];
}

function failures() {
  const count = data.failures.reduce((sum, failure) => sum + failure.rows, 0);
  return part("failures", "Failures", data.failed === 0 ? h("p", {}, "No row has failed.") : [
    h("p", {}, `${plural(data.failed, "row")} failed.`),
    scroller("Failures", h("table", { id: "failure-table" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "error"), h("th", { scope: "col", class: "number" }, "rows"),
        h("th", { scope: "col", class: "number" }, "first row"))),
      h("tbody", {}, data.failures.map((failure) => h("tr", {}, h("th", { scope: "row" }, failure.error,
        failure.differ && h("small", {}, "the first of them; the others differ in numbers")),
        h("td", { class: "number" }, show(failure.rows)), h("td", { class: "number" }, show(failure.first))))))),
    count < data.failed && h("p", { class: "quiet" }, `And ${show(data.failed - count)} rows with other errors.`)]);
}

function studyPage() {
  const about = [
    `Study, ${show(data.done)} of ${plural(data.rows, "row")}`,
    h("span", { class: data.failed ? "bad" : "good" }, data.failed ? `${show(data.failed)} failed` : "none failed"),
  ];
  const main = h("main", { "aria-busy": "true" });
  const studied = folded("study", "The study as it was written", h("pre", { tabindex: "0" }, h("code", {}, data.text)));
  const last = [failures(), reproduce(data.provenance, studied)];
  const header = h("div");
  const finish = (parts) => {
    main.replaceChildren(...parts, ...last);
    header.replaceChildren(topOfPage(data.title, about, [...parts, ...last]));
    main.removeAttribute("aria-busy");
    main.dataset.ready = "true";
  };
  readColumns().then((columns) => finish(columns[0].count ? studyTable(columns)
    : [part("rows", "Rows", h("p", {}, "No row is there yet."))])).catch((error) => {
    finish([h("p", { class: "bad", role: "alert" }, `The table cannot be shown (${error.message}); a browser of 2023 or newer can.`)]);
    throw error;
  });
  return [header, main];
}
