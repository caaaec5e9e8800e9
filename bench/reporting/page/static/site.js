// Tables that sort, are searched, and are exported as CSV, JSON, Markdown or LaTeX (DataTables); data files beside the pages.
"use strict";

window.bench = {
  root: new URL("..", document.currentScript.src).href,
  waiting: new Map(),

  // Loads a data file once; the file calls one of the functions of the page with what it holds.
  load(path) {
    if (!this.waiting.has(path)) {
      this.waiting.set(path, new Promise((resolve, reject) => {
        const script = document.createElement("script");
        script.src = this.root + path;
        script.onload = resolve;
        script.onerror = () => reject(new Error(`${path} is not beside this page`));
        document.body.append(script);
      }));
    }
    return this.waiting.get(path);
  },

  save(name, type, text) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  },

  markdown({ header, body }) {
    const line = (cells) => `| ${cells.map((cell) => String(cell).replaceAll("|", "\\|")).join(" | ")} |`;
    return [line(header), line(header.map(() => "---")), ...body.map(line)].join("\n") + "\n";
  },

  latex({ header, body }) {
    const marks = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}", "×": "$\\times$" };
    const text = (cell) => String(cell).replace(/[\\&%$#_{}~^×]/g, (mark) => marks[mark] || `\\${mark}`);
    const line = (cells) => `${cells.map(text).join(" & ")} \\\\`;
    return `\\begin{tabular}{${"l".repeat(header.length)}}\n\\hline\n${line(header)}\n\\hline\n${body.map(line).join("\n")}\n\\hline\n\\end{tabular}\n`;
  },

  records({ header, body }) {
    return JSON.stringify(body.map((row) => Object.fromEntries(row.map((cell, i) => [header[i], cell]))), null, 1) + "\n";
  },

  copy(text) {
    const area = document.createElement("textarea");
    area.value = text;
    area.setAttribute("aria-label", "Text to copy");
    document.body.append(area);
    area.select();
    document.execCommand("copy"); // the clipboard's newer interface is closed to pages from a disk
    area.remove();
    const note = document.getElementById("note") || document.createElement("output");
    note.id = "note";
    note.textContent = "Copied.";
    document.querySelector("article").append(note);
    setTimeout(() => { note.textContent = ""; }, 3000);
  },

  // The buttons of a table whose files are called `name`; what is exported is what is shown, in its order.
  buttons(name, more = []) {
    const shown = (table) => table.buttons.exportData({ columns: ":visible", orthogonal: "export", modifier: { search: "applied", order: "applied" } });
    const file = name.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "") || "table";
    const button = (text, act) => ({ text, action: (event, table) => act(shown(table)) });
    return [
      { extend: "csv", text: "CSV", filename: file, title: null, exportOptions: { columns: ":visible", orthogonal: "export" } },
      button("JSON", (data) => this.save(`${file}.json`, "application/json", this.records(data))),
      button("Copy as Markdown", (data) => this.copy(this.markdown(data))),
      button("Copy as LaTeX", (data) => this.copy(this.latex(data))),
      ...more,
    ];
  },

  // A table that is wider than the page is scrolled, by keyboard too.
  scrolled(table, name) {
    const region = document.createElement("div");
    for (const [key, value] of Object.entries({ class: "scroll", tabindex: "0", role: "region", "aria-label": name })) region.setAttribute(key, value);
    table.replaceWith(region);
    region.append(table);
  },
};

Object.assign(DataTable.defaults.language, {
  paginate: { first: "First", previous: "Previous", next: "Next", last: "Last" },
  aria: { ...DataTable.defaults.language.aria, paginate: { first: "First page", previous: "Previous page", next: "Next page", last: "Last page", number: "Page " } },
  search: "Search ", info: "_START_ to _END_ of _TOTAL_ lines", infoFiltered: "(of _MAX_)", infoEmpty: "no line", zeroRecords: "No line has this.", lengthMenu: "_MENU_ lines a page" });

// A column of cells that begin with a number, such as "0.384 ×0.97", "3/4 (2/4)" or "12 ms", sorts by it.
const LEADING = /^[*×><≤≥\s]*([-−+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?)( ms\b| µs\b)?/i;
const UNITS = { " ms": 1e-3, " µs": 1e-6 };
const plainText = (value) => String(value).replace(/<[^>]*>/g, "");
DataTable.type("leading", {
  className: "",
  detect: { oneOf: (value) => typeof value === "string" && LEADING.test(plainText(value)),
    allOf: (value) => typeof value !== "string" || /^\s*([–-]|failed|no answer|)\s*$/.test(plainText(value)) || LEADING.test(plainText(value)) },
  order: { pre: (value) => {
    const match = LEADING.exec(plainText(value));
    return match ? Number(match[1].replace(/,/g, "").replace("−", "-")) * (UNITS[match[2]] || 1) : Infinity;
  } },
});

for (const table of document.querySelectorAll("article table:not([id]):not(.highlighttable)")) {
  const rows = table.tBodies[0] ? table.tBodies[0].rows : [];
  if (rows.length < 2) continue;
  const before = Array.from(document.querySelectorAll("article h1, article h2, article h3")).filter((head) => head.compareDocumentPosition(table) & Node.DOCUMENT_POSITION_FOLLOWING);
  const name = (before.pop()?.firstChild?.textContent || document.title).trim();
  const heads = Array.from(table.tHead.rows[0].cells, (cell) => cell.textContent); // a phone shows them before each cell
  for (const row of rows) Array.from(row.cells).forEach((cell, i) => { cell.dataset.label = heads[i]; });
  table.classList.add("cards");
  bench.scrolled(table, name);
  new DataTable(table, {
    order: [], autoWidth: false, paging: rows.length > 60, pageLength: 50, searching: rows.length > 12, info: rows.length > 60,
    layout: { topStart: { buttons: [{ extend: "collection", text: "Export", buttons: bench.buttons(name) }] },
      topEnd: rows.length > 12 ? "search" : null, bottomStart: rows.length > 60 ? "info" : null, bottomEnd: rows.length > 60 ? "paging" : null },
  });
}
