// The leaderboard (its filters, order and columns are in the address), and the comparison of two methods.
"use strict";

const LOST = 10; // error over the bound assigned to an outlier fit

bench.board = (columns) => {
  const form = document.getElementById("choices");
  const verdict = document.getElementById("verdict");
  const fields = Array.from(form.elements).filter((field) => field.name);
  const choices = fields.filter((field) => form.contains(field)); // the other fields select the methods to compare
  const at = Object.fromEntries(columns.map(({ title }, i) => [title, i]));
  const rows = columns[0].codes.map((_, line) => columns.map(({ codes }) => codes[line]));
  const text = (row, title) => columns[at[title]].values[row[at[title]]];
  const fits = (row) => choices.every(({ name, value, dataset: { limit } }) => value === ""
    || (limit ? leading(text(row, name)) <= Number(value) : text(row, name) === value));

  for (const field of fields.filter(({ dataset }) => !dataset.limit)) {
    for (const value of columns[at[field.dataset.of || field.name]].values) field.add(new Option(value));
  }
  const cell = ({ values, links }) => (code, kind) => {
    if (kind === "sort" || kind === "type") return code; // texts are stored in sorted order
    const [name, address] = [values[code], links?.[code]].map(DataTable.util.escapeHtml);
    return address ? `<a href="${address}">${name}</a>` : name;
  };
  const table = bench.table(document.getElementById("board"), {
    data: rows, deferRender: true, buttons: [{ extend: "colvis", text: "Columns" }],
    columns: columns.map((column, i) => ({ title: column.title, data: i, render: cell(column), type: "num" })),
  });
  table.search.fixed("choices", (_, row) => fits(row));
  table.on("draw column-visibility", write);
  table.on("draw", compare);
  form.addEventListener("reset", () => setTimeout(() => table.draw()));
  form.addEventListener("change", ({ target }) => { // a filter without results resets the other filters
    for (const field of choices.toReversed()) if (field !== target && !rows.some(fits)) field.value = "";
    table.draw();
  });
  addEventListener("hashchange", read);
  read();

  function read() {
    const state = new URLSearchParams(location.hash.slice(1) || form.dataset.first);
    for (const field of fields) {
      field.value = state.get(field.name) ?? "";
      if (field.selectedIndex < 0) field.value = "";
    }
    const order = (state.get("sort") ?? form.dataset.sort).split(",").map((column) => column.split(":"));
    const there = order.filter(([title]) => title in at);
    table.order(there.map(([title, way]) => [at[title], way === "desc" ? "desc" : "asc"]));
    const hidden = (state.get("hide") ?? form.dataset.hide).split(",");
    columns.forEach(({ title }, i) => table.column(i).visible(!hidden.includes(title), false));
    table.draw();
  }

  function write() {
    const state = new URLSearchParams(Array.from(new FormData(form)).filter(([, value]) => value));
    const hidden = columns.filter((_, i) => !table.column(i).visible());
    state.set("sort", table.order().map(([i, way]) => `${columns[i].title}:${way}`).join(","));
    state.set("hide", hidden.map(({ title }) => title).join(","));
    history.replaceState(null, "", `#${state}`);
  }

  async function compare() {
    const [a, b] = [form.elements.A.value, form.elements.B.value];
    verdict.textContent = "Choose two methods to compare them in the scenarios of the rows above.";
    document.getElementById("scatter").replaceChildren();
    if (!a || !b || a === b) return;
    const { values, links } = columns[at.Scenario];
    const shown = table.rows({ search: "applied" }).data().toArray();
    const scenarios = Array.from(new Set(shown.map((row) => row[at.Scenario])));
    const address = location.hash;
    await Promise.all(scenarios.map((place) => load(links[place].replace(/html$/, "js"))));
    if (location.hash !== address) return; // the filters have changed meanwhile
    const pairs = scenarios.flatMap((place) => {
      const errors = bench.errors[links[place].replace(/^.*\/|\.html$/g, "")];
      const errorsOfB = unpacked(errors[b]);
      const errorsOfA = unpacked(errors[a]).slice(0, errorsOfB.length);
      return errorsOfA.map((value, i) => ({ scenario: values[place], "data set": i, a: value, b: errorsOfB[i] }));
    });
    verdict.textContent = pairs.length ? sentence(bench.statistics(pairs), a, b) : "No data sets in common.";
    if (pairs.length) bench.draw({ scatter: scatter(pairs, a, b) });
  }
};

const loaded = {};
const load = (path) => loaded[path] ||= new Promise((resolve) => { // without a server, scripts can be loaded, files not
  const script = document.createElement("script");
  Object.assign(script, { src: bench.root + path, onload: resolve });
  document.body.append(script);
});
const unpacked = (text = "") => { // half-precision numbers in base 64
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return Array.from(new Float16Array(bytes.buffer));
};

// The median of the ratios b / a and its 95 % interval by order statistics (W. J. Conover, 1999, section 3.2).
bench.statistics = (pairs) => {
  const n = pairs.length;
  const ratios = pairs.map(({ a, b }) => b / a).sort((x, y) => x - y);
  const k = Math.max(Math.floor((n - 1.96 * Math.sqrt(n)) / 2), 1);
  const count = (has) => pairs.filter(has).length;
  return {
    n, ratio: (ratios[Math.ceil(n / 2) - 1] + ratios[Math.floor(n / 2)]) / 2, low: ratios[k - 1], high: ratios[n - k],
    nearer: count(({ a, b }) => a < b), further: count(({ a, b }) => a > b),
    lost: [count(({ a }) => a >= LOST), count(({ b }) => b >= LOST)],
  };
};

function sentence({ n, ratio, low, high, nearer, further, lost }, a, b) {
  const digits = (value) => Number(value.toPrecision(3));
  return `On ${n} data sets the error of ${b} is ${digits(ratio)} times that of ${a} (median of the ratios; 95 % `
    + `interval ${digits(low)} to ${digits(high)}). ${a} is more accurate on ${nearer}, ${b} on ${further}. `
    + `Outlier fits: ${lost[0]} of ${a}, ${lost[1]} of ${b}.`;
}

function scatter(values, a, b) {
  const scale = { type: "log", domain: [0.1, LOST], nice: false, clamp: true };
  const axis = (field, who) => ({ field, type: "quantitative", title: `${who}: error over the bound`, scale });
  const color = { field: "scenario", type: "nominal", legend: { columns: 1 } };
  return {
    height: 420,
    encoding: { x: axis("a", a), y: axis("b", b) },
    layer: [
      { data: { values: scale.domain.map((end) => ({ a: end, b: end })) },
        mark: { type: "line", style: "quiet", strokeDash: [4, 4], aria: false } },
      { data: { values }, mark: { type: "point", filled: true, size: 26, opacity: 0.7, tooltip: { content: "data" } },
        encoding: { color } },
    ],
  };
}
