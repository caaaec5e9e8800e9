// A scenario's pictures: the first data set with some fits, and how far every method is off.
"use strict";

bench.scenario = (data) => {
  drawRecord(data.record);
  const quantities = Object.keys(data.spread).filter((metric) => data.spread[metric].length);
  const choice = document.getElementById("quantity");
  if (!quantities.length) {
    document.getElementById("spread-figure").hidden = true;
    return;
  }
  for (const metric of quantities) choice.add(new Option(data.names[metric], metric));
  const show = () => drawSpread(data, choice.value);
  choice.addEventListener("change", show);
  show();
};

function drawRecord(record) {
  if (!record) {
    document.getElementById("record-figure").innerHTML = "<p>No arrays are kept of this scenario, so there is no record to draw.</p>";
    return;
  }
  const metres = (steps) => (steps === null ? null : Number((steps * record.step).toPrecision(6)));
  const curve = (values, what) => values.map((value, i) => ({ t: record.dense[i], u: metres(value), what }));
  const fits = Object.entries(record.fits).flatMap(([name, values]) => curve(values, name));
  const samples = record.times.map((t, i) => ({ t, u: metres(record.values[i]), what: "sample" }));
  const x = { field: "t", type: "quantitative", title: "time (s)" };
  const place = record.where ? `, ${record.where}` : "";
  const y = { field: "u", type: "quantitative", title: `displacement (m)${place}` };
  const tips = [["what", " "], ["t", "time (s)"], ["u", "displacement (m)"]].map(([field, title]) => ({ field, title }));
  bench.draw("record", "record", () => ({
    height: 300,
    layer: [
      { data: { values: curve(record.truth, "truth") }, mark: { type: "line", strokeWidth: 6, color: bench.colour("line"), tooltip: { content: "data" } }, encoding: { x, y } },
      { data: { values: fits }, mark: { type: "line", strokeWidth: 1.6 }, encoding: { x, y, tooltip: tips,
        color: { field: "what", type: "nominal", sort: Object.keys(record.fits) },
        strokeDash: { field: "what", type: "nominal", sort: Object.keys(record.fits) } } },
      { data: { values: samples }, mark: { type: "point", filled: true, size: 28, color: bench.colour("ink"), opacity: 1 }, encoding: { x, y, tooltip: tips } },
    ],
  }));
}

function drawSpread(data, metric) {
  const lines = data.spread[metric].map(([m, l, h, f, s, t]) => ({ m, l, h, f, s, t }));
  const bound = 1.96 * (data.bounds[metric] || 0);
  const widths = lines.map((line) => Math.max(Math.abs(line.l), Math.abs(line.h))).sort((a, b) => a - b);
  const reach = 1.1 * Math.max(widths[Math.floor(0.75 * (widths.length - 1))], 1.5 * bound, 1e-3);
  const x = { field: "l", type: "quantitative", title: `${data.names[metric]}: off the truth (%)`, scale: { domain: [-reach, reach], nice: false } };
  const y = { field: "m", type: "nominal", sort: [...lines].reverse().map((line) => line.m), title: null };
  const tips = [["m", "method"], ["l", "2.5 % of data sets (%)"], ["h", "97.5 % (%)"], ["f", "first data set (%)"], ["s", "it states from (%)"],
    ["t", "to (%)"]].map(([field, title]) => ({ field, title }));
  const lower = { ...y, bandPosition: 0.75 };
  bench.draw("spread", `spread-${metric}`, () => ({
    height: { step: 22 }, data: { values: lines },
    layer: [
      { data: { values: [{ l: -bound, h: bound }] }, mark: { type: "rect", color: bench.colour("line"), opacity: 0.6, clip: true },
        encoding: { x, x2: { field: "h" } } },
      { data: { values: [{ l: 0 }] }, mark: { type: "rule", color: bench.colour("ink") }, encoding: { x } },
      { mark: { type: "rule", strokeWidth: 5, color: bench.colour("s1"), clip: true }, encoding: { x, x2: { field: "h" }, y, tooltip: tips } },
      { mark: { type: "rule", strokeWidth: 1.5, color: bench.colour("s2"), clip: true },
        encoding: { x: { ...x, field: "s" }, x2: { field: "t" }, y: lower, tooltip: tips } },
      { mark: { type: "point", filled: true, size: 30, opacity: 1, color: bench.colour("s2"), clip: true }, encoding: { x: { ...x, field: "f" }, y: lower, tooltip: tips } },
    ],
  }));
}
