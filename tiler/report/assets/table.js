// A table that is sorted by its headings: rows of any kind, a column says what it shows and by what it sorts.

const PAGE = 100; // rows

/**
 * columns: [{key, title, hint, numeric, minor, cell(row), value(row)}]; value is what the column sorts by, a number or a text.
 * after(row): one more element below the row, or null. Returns {element, show(rows), columns(list)}.
 */
function sortedTable({ id, caption, columns, rows, after = () => null, empty = "No row." }) {
  let by = null, down = false, first = 0, shown = rows;
  const head = h("thead"), body = h("tbody");
  const pages = h("div", { class: "pages" });
  const table = h("table", { id }, h("caption", { class: "unseen" }, caption), head, body);

  function compare(a, b) {
    const x = by.value(a), y = by.value(b);
    const noX = x === null || x === undefined || Number.isNaN(x), noY = y === null || y === undefined || Number.isNaN(y);
    if (noX || noY) return noX - noY; // what is unknown stands last, whichever way
    const order = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y), "en");
    return down ? -order : order;
  }

  const kindOf = (column) => column.numeric ? "number" : column.minor ? "minor" : null;

  function heading(column) {
    const here = by && by.key === column.key;
    const sort = here ? (down ? "descending" : "ascending") : "none";
    return h("th", { scope: "col", class: kindOf(column), "aria-sort": sort },
      h("button", {
        type: "button", title: column.hint, "data-key": column.key,
        onclick: () => {
          // Numbers: the largest first. A third click gives the order that the table came in.
          const start = Boolean(column.numeric);
          if (!here) [by, down] = [column, start];
          else if (down === start) down = !start;
          else [by, down] = [null, false];
          first = 0;
          draw();
          head.querySelector(`[data-key="${CSS.escape(column.key)}"]`).focus();
        },
      }, column.title, h("span", { class: "arrow", "aria-hidden": "true" }, here ? (down ? "↓" : "↑") : "")));
  }

  function turn(by) {
    first += by;
    draw();
  }

  function draw() {
    head.replaceChildren(h("tr", {}, columns.map(heading)));
    const sorted = by ? [...shown].sort(compare) : shown;
    const page = sorted.slice(first, first + PAGE);
    body.replaceChildren(...page.flatMap((row) => [
      h("tr", {}, columns.map((column, k) => {
        const kind = { class: kindOf(column) };
        return k === 0 ? h("th", { scope: "row", ...kind }, column.cell(row)) : h("td", kind, column.cell(row));
      })),
      after(row),
    ].filter(Boolean)));
    if (!page.length) body.append(h("tr", {}, h("td", { colspan: columns.length }, empty)));
    pages.replaceChildren(...(sorted.length <= PAGE ? [] : [
      h("button", { type: "button", disabled: first === 0, onclick: () => turn(-PAGE) }, "Previous"),
      h("span", {}, `${show(first + 1)} to ${show(first + page.length)} of ${show(sorted.length)}`),
      h("button", { type: "button", disabled: first + PAGE >= sorted.length, onclick: () => turn(PAGE) }, "Next"),
    ]));
  }

  draw();
  return {
    element: h("div", {}, scroller(caption, table), pages),
    show(list) {
      shown = list;
      first = 0;
      draw();
    },
    columns(list) {
      columns = list;
      if (by) by = list.find((column) => column.key === by.key) || null;
      draw();
    },
  };
}
