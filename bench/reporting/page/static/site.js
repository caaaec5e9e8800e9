// Tables that sort, and give themselves away as CSV, JSON, Markdown or LaTeX (DataTables); data files beside the page.
"use strict";

window.bench = {
  root: document.body.dataset.root,
  waiting: new Map(),

  // Loads a data file once; the file calls one of the functions below with what it holds.
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
    return `\\begin{tabular}{${"l".repeat(header.length)}}\n\\hline\n${line(header)}\n\\hline\n`
      + `${body.map(line).join("\n")}\n\\hline\n\\end{tabular}\n`;
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
    document.querySelector("main").append(note);
    setTimeout(() => { note.textContent = ""; }, 3000);
  },

  // The buttons of a table whose files are called `name`; what is exported is what is shown, in its order.
  buttons(name, more = []) {
    const shown = (table) => {
      const found = table.buttons.exportData({ columns: ":visible", orthogonal: "export", modifier: { search: "applied", order: "applied" } });
      return { header: found.header, body: found.body };
    };
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
};

Object.assign(DataTable.defaults.language, {
  paginate: { first: "First", previous: "Previous", next: "Next", last: "Last" },
  aria: { ...DataTable.defaults.language.aria, paginate: { first: "First page", previous: "Previous page", next: "Next page", last: "Last page", number: "Page " } },
  search: "Search ", info: "_START_ to _END_ of _TOTAL_ lines", infoFiltered: "(of _MAX_)",
  infoEmpty: "no line", zeroRecords: "No line has this.", lengthMenu: "_MENU_ lines a page" });

// A column of cells that begin with a number, such as "0.384 ×0.97" or "3/4 (2/4)", sorts by it.
const LEADING = /^[*×><≤≥\s]*([-−+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?)/i;
const plainText = (value) => String(value).replace(/<[^>]*>/g, "");
DataTable.type("leading", {
  className: "",
  detect: { oneOf: (value) => typeof value === "string" && LEADING.test(plainText(value)),
    allOf: (value) => typeof value !== "string" || /^\s*([–-]|failed|no answer|)\s*$/.test(plainText(value)) || LEADING.test(plainText(value)) },
  order: { pre: (value) => {
    const match = LEADING.exec(plainText(value));
    return match ? Number(match[1].replace(/,/g, "").replace("−", "-")) : Infinity;
  } },
});

for (const table of document.querySelectorAll("table.cards")) { // a phone shows a row as a card, with these names
  const heads = Array.from(table.tHead ? table.tHead.rows[0].cells : [], (cell) => cell.textContent);
  for (const row of table.tBodies[0] ? table.tBodies[0].rows : []) {
    Array.from(row.cells).forEach((cell, i) => { cell.dataset.label = heads[i]; });
  }
}

for (const table of document.querySelectorAll("table[data-grid]")) {
  const rows = table.tBodies[0] ? table.tBodies[0].rows.length : 0;
  if (rows > 1) {
    const name = table.dataset.name || document.title;
    new DataTable(table, {
      order: [], autoWidth: false, paging: rows > 60, pageLength: 50, searching: rows > 12, info: rows > 60,
      layout: { topStart: rows > 2 ? { buttons: [{ extend: "collection", text: "Take", buttons: bench.buttons(name) }] } : null,
        topEnd: rows > 12 ? "search" : null, bottomStart: rows > 60 ? "info" : null, bottomEnd: rows > 60 ? "paging" : null },
    });
  }
}
