"use strict";
const MOST_LOGGED = 200, QUIET = new Set(["ok", "warming_up"]);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const readable = (name) => name.replace("_over_", "/").replaceAll("_", " ");
const digits = (x) => (x == null ? "–" : Number(x).toPrecision(4));
let head = null, kept = [], charts = [], dirty = false, ended = false, last = null, before = "";

function axes(label) {
  const ink = css("--soft"), grid = { stroke: css("--line"), width: 1 };
  return [{ stroke: ink, grid, ticks: grid }, { stroke: ink, grid, ticks: grid, size: 70, label, labelSize: 18 }];
}
function chart(place, height, label, series, bands) {
  const element = document.querySelector(place);
  const plot = new uPlot({
    width: element.clientWidth || 400, height, axes: axes(label), bands, scales: { x: { time: false } },
    series: [{ label: "t (s)", value: (_, v) => digits(v) }, ...series], legend: { live: false },
  }, [[], ...series.map(() => [])], element);
  new ResizeObserver(() => plot.setSize({ width: element.clientWidth, height })).observe(element);
  return plot;
}
function begin(message) {
  head = message; kept = [];
  document.querySelector("#system").textContent = head.system;
  document.querySelector("#sensors").textContent = head.sensors.join(", ");
  for (const one of charts) one.plot.destroy();
  charts = [];
  const body = document.querySelector("#values tbody"), place = document.querySelector("#quantities");
  body.replaceChildren(); place.replaceChildren();
  const sensor = head.sensors.flatMap((name, i) => [
    { label: `measured, ${name}`, stroke: ["#4477AA", "#228833", "#AA3377"][i % 3], points: { show: true, size: 4 }, width: 0 },
    { label: "predicted", stroke: ["#EE6677", "#CCBB44", "#66CCEE"][i % 3], width: 1.5, points: { show: false } }]);
  charts.push({ plot: chart("#motion", 230, "", sensor), columns: head.sensors.flatMap((_, i) =>
    [(k) => k.measured[i] ?? null, (k) => k.prediction[i] ?? null]) });
  head.quantities.forEach((q, i) => {
    const row = body.insertRow();
    for (let j = 0; j < 4; j++) row.insertCell();
    row.cells[0].textContent = readable(q.name); row.cells[3].textContent = q.unit;
    const section = document.createElement("section");
    section.innerHTML = `<h2></h2><div id="q${i}"></div>`;
    section.querySelector("h2").textContent = `${readable(q.name)} (${q.unit})`;
    place.append(section);
    const series = [{ label: "high", stroke: "#4477AA55", width: 1, points: { show: false } },
      { label: "low", stroke: "#4477AA55", width: 1, points: { show: false } },
      { label: "estimate", stroke: "#4477AA", width: 2, points: { show: false } }];
    const of = (end) => (k) => k.quantities[q.name]?.[end] ?? null;
    charts.push({ plot: chart(`#q${i}`, 190, "", series, [{ series: [1, 2], fill: "#4477AA33" }]), columns: [of("high"), of("low"), of("value")] });
  });
}
function note(k) {
  const text = QUIET.has(k.status) ? "" : k.status, ring = k.ringing ? "alarm" : "";
  const now = text + ring;
  if (now && now !== before) {
    const log = document.querySelector("#log"), item = document.createElement("li");
    log.querySelector(".none")?.remove();
    item.textContent = `${k.t.toFixed(3)} s: ${[ring && `alarm at ${digits(k.alarm)}`, text && text.replaceAll("_", " "), k.message].filter(Boolean).join(", ")}`;
    if (ring) item.className = "alarm";
    log.prepend(item);
    while (log.children.length > MOST_LOGGED) log.lastChild.remove();
  }
  before = now;
}
function draw() {
  if (dirty && head && last) {
    dirty = false;
    const times = kept.map((k) => k.t);
    for (const { plot, columns } of charts) plot.setData([times, ...columns.map((of) => kept.map(of))]);
    const standing = document.querySelector("#standing");
    const more = [last.waiting ? `${last.waiting} waiting` : "", last.decimated ? `${last.decimated} left out` : "",
      last.unreadable ? `${last.unreadable} unreadable` : ""].filter(Boolean).join(", ");
    standing.textContent = `${ended ? "the stream has ended; " : ""}t = ${last.t.toFixed(3)} s, sample ${last.sample}, ${last.status.replaceAll("_", " ")}${more ? ", " + more : ""}`;
    standing.className = last.ringing ? "alarm" : "";
    standing.dataset.sample = last.sample;
    head.quantities.forEach((q, i) => {
      const one = last.quantities[q.name], cells = document.querySelectorAll("#values tbody tr")[i].cells;
      cells[1].textContent = one ? digits(one.value) : "–";
      cells[2].textContent = one ? `${digits(one.low)} to ${digits(one.high)}` : "–";
    });
  }
  requestAnimationFrame(draw);
}
const source = new EventSource("events");
source.addEventListener("head", (event) => begin(JSON.parse(event.data)));
source.onmessage = (event) => {
  for (const k of JSON.parse(event.data)) {
    if (k.t == null) continue;
    note(k);
    if (kept.length && k.t <= kept[kept.length - 1].t) { last = k; continue; }
    kept.push(k); last = k;
  }
  if (kept.length > head.kept) kept = kept.slice(-head.kept);
  dirty = true;
};
source.addEventListener("end", () => { source.close(); ended = true; dirty = true; });
source.onerror = () => { document.querySelector("#standing").textContent = "the twin has ended, or is not reached"; };
requestAnimationFrame(draw);
