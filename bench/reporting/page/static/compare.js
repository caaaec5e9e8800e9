// Two methods on the same data sets: a dot each, the diagonal, and what the pairs say.
"use strict";

const LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
const TOP = LETTERS.length ** 2 - 1;
const pairForm = document.getElementById("pair");
const errorsOf = new Map();
const MOST_SCENARIOS = 40;

// An error over the bound as it is packed: two letters are the place of its logarithm between 1e-4 and 1e5; the last is a failure.
bench.unpacked = (text) => Array.from({ length: text.length / 2 }, (_, i) => {
  const place = 64 * LETTERS.indexOf(text[2 * i]) + LETTERS.indexOf(text[2 * i + 1]);
  return place === TOP ? Infinity : 10 ** (9 * place / (TOP - 1) - 4);
});

bench.scenario = (data) => errorsOf.set(data.slug, data);
bench.pair = () => Object.fromEntries(["a", "b", "of"].map((name) => [name, pairForm.elements[name].value]));

bench.updatePair = () => {
  const { at, site } = bench;
  const free = { ...bench.state(), method: "", quantity: "", budget: "", level: false }; // of the scenarios chosen above
  const lines = bench.all.filter((line) => bench.fits(line, free));
  bench.places = [...new Set(lines.map((line) => line[at.scenario]))];
  const apart = ["reference", "not ranked"].map((name) => site.standings.indexOf(name));
  const open = lines.filter((line) => !apart.includes(line[at.standing]) && line[at.ok] > 0);
  const methods = [...new Set(open.map((line) => line[at.method]))].map((i) => site.methods[i]);
  const quantities = [...new Set(open.map((line) => line[at.quantity]))].map((i) => [site.metrics[i], site.quantities[i]]);
  const before = { ...bench.pair(), ...Object.fromEntries(Object.entries(bench.asked || {}).filter(([, value]) => value)) };
  bench.asked = null;
  fill("a", methods, before.a);
  fill("b", methods, before.b);
  fill("of", quantities, before.of || quantities[0]?.[0], true);
  compare();
};

function fill(name, offers, chosen, must = false) {
  const select = pairForm.elements[name];
  select.replaceChildren(...(must ? [] : [new Option("–", "")]), ...offers.map(([value, text]) => new Option(text, value)));
  select.value = offers.some(([value]) => value === chosen) ? chosen : must && offers.length ? offers[0][0] : "";
}

pairForm.addEventListener("change", async () => { await compare(); bench.writeAddress(); });

async function compare() {
  const { a, b, of } = bench.pair();
  const verdict = document.getElementById("verdict");
  document.getElementById("scatter").replaceChildren();
  bench.compared = null;
  if (!a || !b || a === b) {
    verdict.textContent = "Choose two different methods; they are compared in the scenarios chosen above.";
    return;
  }
  const slugs = bench.places.slice(0, MOST_SCENARIOS).map((place) => bench.site.scenarios[place]);
  await Promise.all(slugs.map(([slug]) => bench.load(`data/scenario/${slug}.js`)));
  const pairs = slugs.flatMap((one) => paired(errorsOf.get(one[0]), of, a, b, one[6]));
  const title = Object.fromEntries(bench.site.methods.map(([label, name]) => [label, name]));
  bench.compared = statistics(pairs);
  verdict.textContent = pairs.length ? said(bench.compared, title[a], title[b]) : "No data set has both with an error of this quantity; choose other scenarios or another quantity.";
  if (pairs.length) await drawPairs(pairs.filter((pair) => Number.isFinite(pair.a) && Number.isFinite(pair.b)), title[a], title[b], `${a}-${b}`);
}

function paired(data, metric, a, b, scenario) {
  const errors = data.errors[metric] || {};
  if (!(a in errors) || !(b in errors)) return [];
  const [first, second] = [bench.unpacked(errors[a]), bench.unpacked(errors[b])];
  return first.slice(0, second.length).map((value, i) => ({ a: value, b: second[i], n: i, scenario }));
}

// The median of the ratios with a 95 % interval by order statistics, and the exact sign test of which is nearer the truth.
function statistics(pairs) {
  const ratios = pairs.map(({ a, b }) => (a === b ? 1 : b / a)).sort((x, y) => x - y);
  const n = ratios.length;
  const nearer = pairs.filter(({ a, b }) => a < b).length;
  const further = pairs.filter(({ a, b }) => a > b).length;
  const k = Math.max(quantile(n) - 1, 0);
  return { n, nearer, further, ratio: n % 2 ? ratios[(n - 1) / 2] : (ratios[n / 2 - 1] + ratios[n / 2]) / 2, low: ratios[k], high: ratios[n - 1 - k],
    p: signTest(Math.min(nearer, further), nearer + further), lost: [pairs.filter(({ a }) => a === Infinity).length, pairs.filter(({ b }) => b === Infinity).length] };
}
bench.statistics = statistics;

// log of the binomial probability of k of n at one half
function terms(n) {
  const found = [-n * Math.log(2)];
  for (let k = 1; k <= n; k += 1) found.push(found[k - 1] + Math.log((n - k + 1) / k));
  return found.map(Math.exp);
}

function signTest(fewer, n) {
  return Math.min(1, 2 * terms(n).slice(0, fewer + 1).reduce((sum, term) => sum + term, 0));
}

// The largest k of which fewer than 2.5 % of such samples have less than k below the median; 0 where there is none.
function quantile(n) {
  let sum = 0;
  let k = 0;
  for (const term of terms(n)) {
    sum += term;
    if (sum > 0.025) return k;
    k += 1;
  }
  return k;
}

function said(found, a, b) {
  const digits = (value) => (value === Infinity ? "∞" : String(Number(value.toPrecision(4))));
  const p = found.p < 1e-4 ? "below 0.0001" : `${Number(found.p.toPrecision(2))}`;
  const lost = found.lost.some(Boolean) ? ` Without an answer: ${found.lost[0]} of ${a}, ${found.lost[1]} of ${b}.` : "";
  const alike = found.n - found.nearer - found.further;
  return `On ${found.n} data sets the error of ${b} is ${digits(found.ratio)} times that of ${a} (median of the ratios; 95 % interval ${digits(found.low)} to ${digits(found.high)}). `
    + `${a} is nearer the truth on ${found.nearer}, ${b} on ${found.further}${alike ? `, alike to half a percent on ${alike}` : ""}; were they equal, so uneven a count would have probability ${p} (sign test).${lost}`;
}

async function drawPairs(pairs, a, b, name) {
  const values = pairs.map((pair) => ({ ...pair, a: Math.max(pair.a, 1e-3), b: Math.max(pair.b, 1e-3) }));
  const ends = [Math.min(...values.map((one) => Math.min(one.a, one.b))), Math.max(...values.map((one) => Math.max(one.a, one.b)))];
  const several = new Set(values.map((one) => one.scenario)).size > 1;
  const axis = (field, who) => ({ field, type: "quantitative", title: `${who}: error over the bound`, scale: { type: "log", domain: ends, nice: false } });
  await bench.draw("scatter", name, () => ({
    height: 420,
    layer: [
      { data: { values: [{ a: ends[0], b: ends[0] }, { a: ends[1], b: ends[1] }] }, mark: { type: "line", color: bench.colour("muted"), strokeDash: [4, 4] },
        encoding: { x: axis("a", a), y: axis("b", b) } },
      { data: { values }, mark: { type: "point", filled: true, size: 26, opacity: 0.7, color: bench.colour("s1") },
        encoding: { x: axis("a", a), y: axis("b", b), tooltip: [["scenario", "scenario"], ["n", "data set"], ["a", a], ["b", b]].map(([field, title]) => ({ field, title })),
          ...(several ? { color: { field: "scenario", type: "nominal", legend: { columns: 1, labelLimit: 500, symbolLimit: 8 } } } : {}) } },
    ],
  }));
}
