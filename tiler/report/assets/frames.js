// A report of frames: key figures, the maps, where patches and invocations go, counters, machines, how to make it again.

/** Text cut in the middle of long names, so that a table keeps its width; whole as a title. */
function nameOf(machine) {
  return h("span", { class: "machine", title: machine.name }, machine.name);
}

function keyFigures() {
  const known = data.definitions.map((d) => d.name);
  const figures = data.figures.map((name) => ({ name, at: known.indexOf(name), unit: data.definitions[known.indexOf(name)].unit }));
  const base = data.machines[0];
  const blamed = data.machines.some((m) => m.waterfalls["domain-shader invocations"]);
  const useful = (machine) => {
    const fall = machine.waterfalls["domain-shader invocations"];
    if (!fall) return "–";
    return fall[0].value ? `${(100 * fall.at(-1).value / fall[0].value).toPrecision(3)} %` : "–";
  };
  return scroller("Key figures", h("table", { id: "figures" },
    h("caption", { class: data.machines.length > 1 ? null : "unseen" },
      data.machines.length > 1 ? `Below each figure its ratio to ${base.name}, the baseline` : "Key figures"),
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "machine"),
      figures.map((f) => h("th", { scope: "col", class: "number", title: data.definitions[f.at].text },
        h("code", {}, f.name), h("small", {}, f.unit))),
      blamed && h("th", { scope: "col", class: "number", title: "Useful domain-shader invocations of all" }, "useful",
        h("small", {}, "of invocations")))),
    h("tbody", {}, data.machines.map((machine, k) => h("tr", {}, h("th", { scope: "row" }, nameOf(machine)),
      figures.map((f) => h("td", { class: "number" }, show(machine.counters[f.at]),
        k > 0 && h("small", {}, ratio(machine.counters[f.at], base.counters[f.at]) || "–"))),
      blamed && h("td", { class: "number" }, useful(machine)))))));
}

function waterfalls() {
  const body = h("div");
  let same = false, defined = false;
  function draw() {
    const names = Object.keys(data.machines.reduce((all, m) => ({ ...all, ...m.waterfalls }), {}));
    body.className = defined ? "defined" : "";
    body.replaceChildren(...names.map((name) => fall(name, data.machines.filter((m) => m.waterfalls[name]), same)));
  }
  draw();
  const options = h("div", { class: "bar" },
    data.machines.length > 1 && tick("Bars of all machines on one scale", same, (on) => { same = on; draw(); }),
    tick("Definitions", defined, (on) => { defined = on; draw(); }));
  return part("waterfall", "Where the work goes", options, body);
}

function fall(name, machines, same) {
  const most = Math.max(1, ...machines.map((m) => m.waterfalls[name][0].value));
  const rows = machines[0].waterfalls[name].map((step, k) => {
    const steps = machines.map((m) => m.waterfalls[name]);
    if (step.kind === "lost" && !steps.some((s) => s[k].value)) return null;
    return h("tr", { class: step.kind },
      h("th", { scope: "row" }, step.kind === "lost" ? `− ${step.title}` : step.kind === "left" ? `= ${step.title}` : step.title,
        h("small", { class: "definition" }, prose(step.text))),
      steps.map((s) => {
        const all = same ? most : Math.max(1, s[0].value);
        const gone = s.slice(1, k).filter((t) => t.kind === "lost").reduce((sum, t) => sum + t.value, 0);
        const right = step.kind === "lost" ? s[0].value - gone : s[k].value;
        return h("td", { class: s[k].value ? "number" : "number zero" }, h("span", {}, show(s[k].value)),
          h("small", {}, percent(s[k].value, s[0].value)),
          h("i", { "aria-hidden": "true", "--from": (right - s[k].value) / all, "--long": s[k].value / all }));
      }));
  });
  return scroller(`From all ${name} down, by reason`, h("table", { class: "fall", "data-fall": name },
    h("caption", {}, `From all ${name} down, by reason`),
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, ""),
      machines.map((m) => h("th", { scope: "col", class: "number" }, nameOf(m))))),
    h("tbody", {}, rows)));
}

function percent(value, all) {
  if (!all) return "";
  const part = 100 * value / all;
  return part === 0 ? "0 %" : part === 100 ? "100 %" : part < 0.1 ? "< 0.1 %" : `${part.toFixed(1)} %`;
}

function counters() {
  const rows = data.definitions.map((d, at) => ({ ...d, at, values: data.machines.map((m) => m.counters[at]) }));
  const open = new Set();
  let wanted = "", zeros = false, all = false;
  const columns = [
    {
      key: "name", title: "counter", value: (row) => row.name,
      cell: (row) => h("button", {
        type: "button", class: "name", "aria-expanded": String(all || open.has(row.name)), title: row.text,
        onclick: (event) => {
          if (open.has(row.name)) open.delete(row.name);
          else open.add(row.name);
          refresh();
          [...document.querySelectorAll("#counter-table .name")].find((b) => b.textContent === row.name).focus();
          event.preventDefault();
        },
      }, row.name),
    },
    { key: "stage", title: "stage", minor: true, value: (row) => row.at, cell: (row) => h("span", { class: "plain" }, row.stage) },
    { key: "unit", title: "unit", minor: true, value: (row) => row.unit, cell: (row) => h("span", { class: "plain" }, row.unit) },
    ...data.machines.flatMap((machine, k) => [
      {
        key: `m${k}`, title: machine.name, numeric: true, value: (row) => row.values[k],
        cell: (row) => row.values[k] ? show(row.values[k]) : h("span", { class: "ratio" }, "0"),
      },
      k && {
        key: `r${k}`, title: "ratio", hint: `${machine.name}: ratio to ${data.machines[0].name}`, numeric: true,
        value: (row) => row.values[0] ? row.values[k] / row.values[0] : null,
        cell: (row) => h("span", { class: "ratio" }, ratio(row.values[k], row.values[0])),
      },
    ]).filter(Boolean),
  ];
  const table = sortedTable({
    id: "counter-table", caption: "Counters", columns, rows: [], empty: "No counter has these words.",
    after: (row) => all || open.has(row.name) ? h("tr", { class: "more" }, h("td", { colspan: columns.length }, prose(row.text),
      row.same_as && h("span", { class: "same" }, ` Same as: ${row.same_as}.`))) : null,
  });
  const found = h("output", { class: "found" });
  function refresh() {
    const words = wanted.toLowerCase().split(/\s+/).filter(Boolean);
    const some = rows.filter((row) => (zeros || row.values.some(Boolean)) && words.every((word) =>
      `${row.name} ${row.stage} ${row.unit} ${row.text} ${row.same_as}`.toLowerCase().includes(word)));
    found.textContent = `${some.length} of ${rows.length}`;
    table.show(some);
  }
  refresh();
  const search = h("input", { type: "search", placeholder: "name, stage, words of the definition", oninput: () => {
    wanted = search.value;
    refresh();
  } });
  return part("counters", "Counters",
    h("div", { class: "bar" }, field("Search", search), found,
      tick("Those that are 0", zeros, (on) => { zeros = on; refresh(); }),
      tick("Definitions", all, (on) => { all = on; refresh(); })),
    table.element);
}

function machines() {
  const text = (value) => value === null ? "–" : Array.isArray(value) ? value.join(", ") || "none"
    : typeof value === "boolean" ? (value ? "yes" : "no") : String(value);
  const names = Object.keys(data.defaults);
  let every = false;
  const body = h("tbody");
  function draw() {
    const rows = names.filter((name) => every || data.machines.some((m) => text(m.fields[name]) !== text(data.defaults[name])));
    body.replaceChildren(...rows.map((name) => h("tr", {}, h("th", { scope: "row" }, h("code", {}, name)),
      data.machines.map((m) => h("td", { class: text(m.fields[name]) === text(data.defaults[name]) ? "usual" : null },
        text(m.fields[name]))))));
    if (!rows.length) body.append(h("tr", {}, h("td", { colspan: data.machines.length + 1 }, "All fields are the default machine's.")));
  }
  draw();
  const checked = data.machines.filter((m) => m.verified).map((m) => h("div", { class: "verified" },
    h("p", {}, `${m.name}: bounds and culls verified, ${plural(m.verified.violations, "violation")}, `
      + `${plural(m.verified.false_culls, "false cull")}.`),
    m.verified.told.length ? h("ul", {}, m.verified.told.map((line) => h("li", {}, line)),
      m.verified.more ? h("li", {}, `${show(m.verified.more)} more`) : null) : null));
  return part("machines", "Machines and scene",
    h("div", { class: "bar" }, tick("All fields", every, (on) => { every = on; draw(); })),
    scroller("Machines", h("table", { id: "machine-table" },
      h("caption", {}, "Fields that differ from the default machine"),
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "field"), data.machines.map((m) => h("th", { scope: "col" }, nameOf(m))))),
      body)),
    checked, facts(data.facts));
}

function framesPage() {
  const several = data.machines.length > 1;
  const same = data.machines.every((m) => m.same);
  const frames = new Set(data.machines.map((m) => m.frame));
  const about = [
    frames.size === 1 ? `Frame ${data.machines[0].frame}, ${data.size.join(" × ")} pixels` : `${data.size.join(" × ")} pixels`,
    several ? `, ${data.machines.length} ${frames.size === 1 ? "machines" : "frames"}` : "",
    several && frames.size === 1 ? h("span", { class: same ? "good" : "bad" },
      same ? "pictures bit-identical" : "pictures DIFFER") : null,
  ];
  const timed = h("p", { class: "quiet" }, "Time taken here: " + Object.entries(data.provenance.milliseconds)
    .map(([name, ms]) => `${name} ${show(Math.round(ms))} ms`).join(", ") + ".");
  const parts = [
    part("summary", "Key figures", keyFigures()), mapViewer(), waterfalls(), counters(), machines(),
    reproduce(data.provenance, timed),
  ];
  return [topOfPage(data.title, about, parts), h("main", {}, parts)];
}
