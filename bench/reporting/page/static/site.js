// Tables with sorting, search and export (DataTables), and charts in the colours of the page (Vega-Lite).
"use strict";

const SERIES = { // M. Okabe, K. Ito, 2008: distinct under colour vision deficiency
  light: ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7F7F7F"],
  dark: ["#56B4E9", "#E69F00", "#30C495", "#E3A0C6", "#A8A8A8"],
};
const SCHEMA = "https://vega.github.io/schema/vega-lite/v6.json"; // a name; nothing is loaded from there

// Sort key: the number that a cell begins with, such as "0.38 ×0.97", "3/4" or "12 ms" (in seconds); other cells come last.
const LEADING = /^[*×><≤≥\s]*([-−+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?)( ms\b| µs\b)?/i;
const UNITS = { " ms": 1e-3, " µs": 1e-6 };
const EMPTY = /^(–|-|failed|no answer|)$/;
const plain = (cell) => String(cell).replace(/<[^>]*>/g, "").trim();
const leading = (cell) => {
  const match = LEADING.exec(plain(cell));
  return match ? Number(match[1].replaceAll(",", "").replace("−", "-")) * (UNITS[match[2]] || 1) : Infinity;
};
DataTable.type("leading", {
  className: "",
  detect: {
    oneOf: (cell) => LEADING.test(plain(cell)),
    allOf: (cell) => EMPTY.test(plain(cell)) || LEADING.test(plain(cell)),
  },
  order: { pre: leading },
});
Object.assign(DataTable.defaults.language, {
  search: "Search ", info: "_START_ to _END_ of _TOTAL_ rows", infoFiltered: "(of _MAX_)", infoEmpty: "no rows",
  zeroRecords: "No matching rows.",
});
const HEADING = "preceding::*[self::h1 or self::h2 or self::h3][1]/text()";

window.bench = {
  root: new URL("..", document.currentScript.src).href,
  errors: {}, // of each loaded scenario, by method
  drawn: {},

  // Called by the file of a scenario with the charts of its page and the errors for the comparison of methods.
  scenario({ slug, charts, errors }) {
    this.errors[slug] = errors;
    this.draw(charts);
  },

  // Makes an element a DataTable; small screens show the heading before each cell, exports contain the visible rows.
  table(element, more = {}) {
    const name = document.evaluate(HEADING, element, null, XPathResult.STRING_TYPE).stringValue.trim();
    const heads = more.columns ?? Array.from(element.rows[0].cells, (cell) => ({ title: cell.textContent }));
    const file = name.toLowerCase().replace(/[^a-z0-9]+/g, "-") || "table";
    const exportOptions = { columns: ":visible", orthogonal: "export" };
    const csv = { extend: "csv", text: "CSV", filename: file, title: null, exportOptions };
    const rows = element.tBodies[0]?.rows.length ?? Infinity;
    const [some, long] = [rows > 12, rows > 60];
    element.classList.add("cards");
    const table = new DataTable(element, {
      order: [], autoWidth: false, paging: long, pageLength: 50, info: long, searching: some,
      layout: {
        topStart: { buttons: [csv, ...(more.buttons ?? [])] }, topEnd: some && !more.data ? "search" : null,
        bottomStart: long ? "info" : null, bottomEnd: long ? "paging" : null,
      },
      createdRow: (row, data, place, cells) => cells.forEach((cell, i) => { cell.dataset.label = heads[i].title; }),
      ...more,
    });
    const scrolled = { className: "scroll", tabIndex: 0, role: "region", ariaLabel: name }; // also by keyboard
    Object.assign(element.parentElement, scrolled);
    return table;
  },

  // Draws each chart in the element of the same name, if the page has it.
  async draw(charts) {
    Object.assign(this.drawn, charts);
    const style = getComputedStyle(document.body);
    const colour = (how) => style.getPropertyValue(`--md-default-fg-color${how}`);
    const [ink, quiet, grid, series] = [colour(""), colour("--light"), colour("--lightest"), SERIES[scheme()]];
    const letters = { labelColor: ink, titleColor: ink, labelFontSize: 12, titleFontSize: 12, titleFontWeight: 400 };
    const axis = { gridColor: grid, domainColor: quiet, tickColor: quiet, labelLimit: innerWidth < 640 ? 120 : 260 };
    const narrow = innerWidth < 640 ? { columns: 3 } : {}; // more entries in a row would be cut off
    const config = {
      background: "transparent", font: "system-ui, sans-serif", view: { stroke: null },
      axis: { ...letters, ...axis },
      legend: { ...letters, orient: "top", title: null, labelLimit: 500, symbolLimit: 8, ...narrow },
      text: { color: ink, fontSize: 11 }, mark: { color: series[0] }, rule: { color: series[0] },
      range: { category: series },
      style: { ink: { color: ink }, quiet: { color: quiet, strokeWidth: 2 }, region: { color: grid } },
    };
    const actions = { export: true, source: false, compiled: false, editor: false };
    const options = { ast: true, renderer: "svg", logLevel: vega.Error, config, actions, tooltip: { theme: scheme() } };
    for (const [id, chart] of Object.entries(charts)) {
      const place = document.getElementById(id);
      if (place && !chart) place.textContent = "No stored data for this chart.";
      if (!place || !chart) continue;
      await vegaEmbed(place, { $schema: SCHEMA, width: "container", ...chart }, { ...options, downloadFileName: id });
      place.querySelector("summary").ariaLabel = "Save this chart as SVG or PNG";
      place.querySelector("svg.marks").ariaLabel = place.nextElementSibling.textContent.trim();
    }
  },
};

const scheme = () => (document.body.dataset.mdColorScheme === "slate" ? "dark" : "light");
const paint = () => {
  document.documentElement.classList.toggle("dark", scheme() === "dark"); // for DataTables
  if (Object.keys(bench.drawn).length) bench.draw(bench.drawn);
};
paint();
new MutationObserver(paint).observe(document.body, { attributeFilter: ["data-md-color-scheme"] });
for (const table of document.querySelectorAll("article table:not([id], .highlighttable)")) {
  if (table.tBodies[0]?.rows.length && table.tHead?.textContent.trim()) bench.table(table); // without headings: a layout
}
