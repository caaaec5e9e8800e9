// The leaderboard: lines of one system at a time, or of all; every choice is kept in the address.
"use strict";

const ALL = "";
const HIDDEN = "5.9.13"; // columns that are not shown at first: the bound, the prior's share, the table
const CHOICES = ["system", "snr", "start", "data", "method", "quantity", "budget"];
const form = document.getElementById("filter");
const boards = new Map();

const number = (value) => (value === null ? "–" : value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e4)
  ? value.toExponential(2) : String(Number(value.toPrecision(3))));
const percent = (value) => (value === null ? "–" : `${Number((100 * value).toPrecision(3))} %`);
const time = (value) => (value === null ? "–" : value < 0.1 ? `${number(1000 * value)} ms` : `${number(value)} s`);

bench.index = async (index) => {
  bench.site = index;
  const at = Object.fromEntries([...index.columns, ...index.shared].map((name, i) => [name, i]));
  const scenario = (line) => index.scenarios[line[at.scenario]];
  // What a filter looks at, by line; the time budget is a limit, and has no value of its own.
  bench.value = {
    system: (line) => index.systems[scenario(line)[1]][0],
    snr: (line) => scenario(line)[2],
    start: (line) => scenario(line)[3],
    data: (line) => scenario(line)[4],
    method: (line) => index.methods[line[at.method]][0],
    quantity: (line) => index.quantities[line[at.quantity]],
  };
  bench.at = at;
  bench.fits = (line, state, but = null) => Object.keys(bench.value).every((name) => name === but || state[name] === ALL
      || bench.value[name](line) === state[name])
    && (but === "budget" || state.budget === ALL || (line[at.seconds] !== null && line[at.seconds] <= Number(state.budget)))
    && (but === "level" || !state.level || line[at.standing] === 0);
  fillChoices(index);
  makeTable(index);
  await readAddress();
  addEventListener("hashchange", () => { if (location.hash.slice(1) !== written) readAddress(); });
  form.addEventListener("change", (event) => choose(event.target.name));
  form.elements.all.addEventListener("click", showAll);
};

// A block of lines shares its scenario, quantity, bound and the prior's part; here they become whole lines again.
bench.board = ({ system, blocks }) => boards.set(system, blocks.flatMap(([place, quantity, bound, prior, lines]) => lines.map(
  (line) => [...line, place, quantity, bound, prior])));

function fillChoices(index) {
  const unique = (values) => [...new Set(values)];
  const offers = {
    system: index.systems.map(([name, , words]) => [name, `${name}: ${words}`]),
    snr: unique(index.scenarios.map((one) => one[2])).sort((a, b) => b - a).map((name) => [name, `${name} dB`]),
    start: unique(index.scenarios.map((one) => one[3])).map((name) => [name, name]),
    data: unique(index.scenarios.map((one) => one[4])).map((name) => [name, name]),
    method: index.methods.map(([label, title]) => [label, title]),
    quantity: index.quantities.map((name) => [name, name]),
    budget: index.budgets.map((limit) => [String(limit), `at most ${time(limit)}`]),
  };
  for (const name of CHOICES) {
    form.elements[name].add(new Option(name === "system" ? "all (takes a moment)" : name === "budget" ? "any" : "all", ALL));
    for (const [value, text] of offers[name]) form.elements[name].add(new Option(text, value));
  }
}

function makeTable(index) {
  const { at } = bench;
  const label = (text) => (cell) => { cell.dataset.label = text; };
  const link = (path, text) => {
    const found = document.createElement("a");
    found.href = path;
    found.textContent = text;
    return found;
  };
  const shown = (title, value, text, more = {}) => ({ title, data: null, createdCell: label(title),
    render: (row, type) => (type === "display" ? text(row) : type === "sort" || type === "type" ? value(row) : text(row)), ...more });
  const measured = (title, name, form = number) => shown(title, (row) => (row[at[name]] === null ? Infinity : row[at[name]]), (row) => form(row[at[name]]),
    { type: "num", className: "number", orderSequence: ["asc", "desc"] });
  const scenario = (row) => index.scenarios[row[at.scenario]];
  const named = (title, text, path) => ({ title, data: null, type: "string", createdCell: (cell, _, row) => {
    cell.dataset.label = title;
    cell.replaceChildren(link(path(row), text(row)));
  }, render: (row, type) => (type === "display" ? "" : text(row)) });
  bench.scrolled(document.getElementById("board"), "Leaderboard");
  bench.table = new DataTable("#board", {
    data: [], autoWidth: false, deferRender: true, pageLength: 50, orderMulti: true, caption: "Leaderboard",
    layout: { topStart: { buttons: bench.buttons("leaderboard", [{ extend: "colvis", text: "Columns" }]) }, topEnd: null, bottomStart: "info", bottomEnd: "paging" },
    columns: [
      named("Method", (row) => index.methods[row[at.method]][1], (row) => `methods/${index.methods[row[at.method]][2]}.html`),
      shown("Error of", (row) => row[at.quantity], (row) => DataTable.util.escapeHtml(index.quantities[row[at.quantity]])),
      measured("× bound", "excess"),
      shown("Standing", (row) => row[at.standing], (row) => index.standings[row[at.standing]], { type: "num" }),
      measured("RMS error", "rms"), measured("Bound", "bound"), measured("Median", "median"),
      shown("95 %", (row) => (row[at.low] === null ? Infinity : row[at.low]), (row) => (row[at.low] === null ? "–" : `${number(row[at.low])} to ${number(row[at.high])}`), { type: "num" }),
      measured("Gross", "gross", percent), measured("Prior", "prior", percent),
      shown("Fits ok", (row) => -row[at.ok] / row[at.n], (row) => `${row[at.ok]}/${row[at.n]}`, { type: "num" }),
      measured("Time per fit", "seconds", time),
      named("Scenario", (row) => scenario(row)[6], (row) => `scenarios/${scenario(row)[0]}.html`),
      shown("Table", (row) => scenario(row)[5], (row) => DataTable.util.escapeHtml(scenario(row)[5] || "–")),
    ],
    order: [[3, "asc"], [2, "asc"]],
    createdRow: (row, line) => {
      row.classList.toggle("level", line[at.standing] === 0);
      row.classList.toggle("ref", index.standings[line[at.standing]] === "reference");
    },
  });
  bench.table.on("order.dt column-visibility.dt", () => { if (bench.ready) writeAddress(); });
}

let written = null;
bench.state = () => ({ ...Object.fromEntries(CHOICES.map((name) => [name, form.elements[name].value])), level: form.elements.level.checked });

function writeAddress() {
  const state = bench.state();
  const found = new URLSearchParams(Object.entries(state).filter(([name, value]) => name !== "level" && value !== ALL));
  if (state.level) found.set("level", "yes");
  const order = bench.table.order().map(([column, way]) => `${column}.${way}`).join(",");
  if (order !== "3.asc,2.asc") found.set("sort", order);
  const hidden = bench.table.columns().indexes().toArray().filter((i) => !bench.table.column(i).visible()).join(".");
  if (hidden !== HIDDEN) found.set("hide", hidden || "none");
  for (const [name, value] of Object.entries(bench.pair ? bench.pair() : {})) if (value) found.set(name, value);
  written = found.toString();
  history.replaceState(null, "", `#${written}`);
}
bench.writeAddress = writeAddress;

async function readAddress() {
  const found = new URLSearchParams(location.hash.slice(1));
  const given = [...found.keys()].length ? Object.fromEntries(found) : bench.site.first;
  for (const name of CHOICES) {
    form.elements[name].value = given[name] ?? ALL;
    if (form.elements[name].selectedIndex < 0) form.elements[name].value = ALL;
  }
  form.elements.level.checked = given.level === "yes";
  bench.ready = false;
  const order = (given.sort || "3.asc,2.asc").split(",").map((one) => one.split("."));
  const columns = bench.table.columns().count();
  const valid = order.filter(([i, way]) => Number(i) >= 0 && Number(i) < columns && ["asc", "desc"].includes(way));
  bench.table.order(valid.map(([i, way]) => [Number(i), way]));
  const hidden = new Set((given.hide || HIDDEN).split(".").map(Number));
  for (let i = 0; i < columns; i += 1) bench.table.column(i).visible(!hidden.has(i), false);
  bench.asked = { a: given.a, b: given.b, of: given.of };
  await refresh();
  bench.ready = true;
}

async function loaded() {
  const own = form.elements.system.value;
  const wanted = bench.site.systems.filter(([name]) => own === ALL || name === own);
  await Promise.all(wanted.map(([, slug]) => bench.load(`data/board/${slug}.js`)));
  return wanted.flatMap(([, slug]) => boards.get(slug));
}

async function choose(name) {
  const lines = await loaded();
  const free = CHOICES.filter((other) => other !== name && other !== "system" && other !== "quantity");
  for (const other of [...free, "quantity"]) { // a choice that leaves nothing gives up the others that it must
    if (lines.some((line) => bench.fits(line, bench.state()))) break;
    if (other !== name) form.elements[other].value = ALL;
  }
  await refresh();
}

async function showAll() {
  for (const name of CHOICES) form.elements[name].value = ALL;
  form.elements.level.checked = false;
  await refresh();
}

async function refresh() {
  const lines = await loaded();
  const state = bench.state();
  bench.all = lines;
  bench.lines = lines.filter((line) => bench.fits(line, state));
  grey(lines, state);
  bench.table.clear().rows.add(bench.lines).draw();
  document.getElementById("count").textContent = `${bench.lines.length} of ${lines.length} lines`;
  document.getElementById("none").hidden = bench.lines.length > 0;
  bench.updatePair();
  writeAddress();
}

// Choices that would leave no line, with the others as they are, cannot be chosen.
function grey(lines, state) {
  for (const name of Object.keys(bench.value).filter((own) => own !== "system")) {
    const left = new Set(lines.filter((line) => bench.fits(line, state, name)).map(bench.value[name]));
    for (const option of form.elements[name].options) option.disabled = option.value !== ALL && !left.has(option.value);
  }
  const times = lines.filter((line) => bench.fits(line, state, "budget") && line[bench.at.seconds] !== null).map((line) => line[bench.at.seconds]);
  const least = Math.min(...times);
  for (const option of form.elements.budget.options) option.disabled = option.value !== ALL && least > Number(option.value);
  const open = new Set(bench.site.scenarios.filter((one) => [["snr", 2], ["start", 3], ["data", 4]].every(([name, i]) => state[name] === ALL || one[i] === state[name]))
    .map((one) => bench.site.systems[one[1]][0]));
  for (const option of form.elements.system.options) option.disabled = option.value !== ALL && !open.has(option.value);
}
