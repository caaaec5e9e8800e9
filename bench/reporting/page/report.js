"use strict";
// Tables are whole without this script; it adds sorting to all of them and filters to the leaderboard.
(() => {
  const units = { ms: 1e-3, s: 1, "%": 1 };
  // What a cell sorts by: a number where it begins with one (a/b as a share, times in seconds), else its text.
  const key = (text) => {
    const found = /^[×±]?\s*(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)(?:\/(\d+)$|\s*(ms|s|%)$)?/i.exec(text);
    if (text === "failed") return [0, Infinity];
    if (text === "–" || text === "") return [2, text];
    if (!found) return [1, text.toLowerCase()];
    return [0, Number(found[1]) / (found[2] ? Number(found[2]) : 1) * (units[found[3]] || 1)];
  };
  const compare = (a, b) => (a[0] !== b[0] ? a[0] - b[0] : a[1] < b[1] ? -1 : a[1] > b[1] ? 1 : 0);

  const sortBy = (table, column, direction) => {
    const body = table.tBodies[0];
    const keyed = Array.from(body.rows, (row, i) => ({ row, i, k: key(row.cells[column].textContent.trim()) }));
    const missing = (one) => one.k[0] === 2;  // what is not there comes last, whichever way
    keyed.sort((a, b) => (missing(a) || missing(b) ? missing(a) - missing(b) : direction * compare(a.k, b.k)) || a.i - b.i);
    body.append(...keyed.map((one) => one.row));
  };

  for (const table of document.querySelectorAll("table[data-sort]")) {
    const heads = Array.from(table.tHead.rows[table.tHead.rows.length - 1].cells);
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = head.textContent;
      head.replaceChildren(button);
      button.addEventListener("click", () => {
        const up = head.getAttribute("aria-sort") !== "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        sortBy(table, column, up ? 1 : -1);
      });
    });
  }

  const form = document.getElementById("filter");
  const board = document.getElementById("board");
  if (form && board) {
    const rows = Array.from(board.tBodies[0].rows);
    const selects = Array.from(form.querySelectorAll("select"));
    const level = form.elements.level;
    const texts = new Map(rows.map((row) => [row, selects.map((s) => row.cells[s.dataset.column].textContent.trim())]));
    const fits = (row) =>
      selects.every((s, i) => s.value === "" || texts.get(row)[i] === s.value) &&
      (!level.checked || row.classList.contains("level"));
    const show = () => {
      let n = 0;
      for (const row of rows) {
        row.hidden = !fits(row);
        n += row.hidden ? 0 : 1;
      }
      for (const s of selects) board.classList.toggle(`without-${s.dataset.column}`, s.value !== "" && s.name !== "method");
      const set = selects.filter((s) => s.value !== "").map((s) => (s.name === "start" ? "start " : "") + s.selectedOptions[0].textContent.trim());
      document.getElementById("where").textContent = set.length ? `: ${set.join(", ")}` : "";
      document.getElementById("count").textContent = `${n} of ${rows.length} lines`;
      document.getElementById("none").hidden = n > 0;
    };
    // A choice that leaves nothing with the others gives up as many of them as it must.
    const relax = (chosen) => {
      if (!selects.includes(chosen) || rows.some(fits)) return;
      const others = selects.filter((s) => s !== chosen);
      const was = others.map((s) => s.value);
      for (const s of others) s.value = "";
      if (!rows.some(fits)) level.checked = false;
      others.forEach((s, i) => {
        s.value = was[i];
        if (!rows.some(fits)) s.value = "";
      });
    };
    const preset = () => {
      for (const s of selects) s.value = (s.querySelector("option[data-first]") || s.options[0]).value;
    };
    form.hidden = false;
    form.addEventListener("change", (event) => {
      relax(event.target);
      show();
    });
    form.addEventListener("submit", (event) => event.preventDefault());
    form.elements.all.addEventListener("click", () => {
      for (const s of selects) s.value = "";
      level.checked = false;
      show();
    });
    preset();
    if (!rows.some(fits)) for (const s of selects) s.value = "";
    show();
  }

  // A link to something folded opens it.
  const unfold = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target && target.tagName === "DETAILS") {
      target.open = true;
      target.scrollIntoView();
    }
  };
  addEventListener("hashchange", unfold);
  unfold();

  // On paper nothing can be opened.
  let closed = [];
  addEventListener("beforeprint", () => {
    closed = Array.from(document.querySelectorAll("details:not([open])"));
    for (const one of closed) one.open = true;
  });
  addEventListener("afterprint", () => {
    for (const one of closed) one.open = false;
  });
})();
