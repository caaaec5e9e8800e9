// Charts by Vega-Lite in the page's colours, light and dark; each can be taken as SVG or PNG, and hover gives numbers.
"use strict";

bench.charts = new Map();

bench.colour = (name) => getComputedStyle(document.body).getPropertyValue(`--${name}`).trim();

bench.config = () => {
  const [ink, muted, line] = ["ink", "muted", "line"].map(bench.colour);
  const text = { labelColor: ink, titleColor: ink, labelFontSize: 12, titleFontSize: 12, titleFontWeight: "normal" };
  return {
    background: "transparent", font: "system-ui, sans-serif", view: { stroke: null },
    axis: { ...text, gridColor: line, domainColor: muted, tickColor: muted, labelLimit: 260 },
    legend: { ...text, orient: "top", title: null }, text: { color: ink, fontSize: 11 }, header: text,
    range: { category: ["s1", "s2", "s3", "s4", "muted"].map(bench.colour) },
  };
};

// Draws make() into the element of that id, again when the colours change; `name` is that of the files it is saved as.
bench.draw = async (id, name, make) => {
  bench.charts.set(id, () => bench.draw(id, name, make));
  const options = { ast: true, renderer: "svg", logLevel: vega.Error, downloadFileName: name, config: bench.config(),
    tooltip: { theme: document.body.dataset.mdColorScheme === "slate" ? "dark" : "light" },
    actions: { export: { svg: true, png: true }, source: false, compiled: false, editor: false },
    i18n: { PNG_ACTION: "Export as PNG", SVG_ACTION: "Export as SVG", CLICK_TO_VIEW_ACTIONS: "Export this figure" } };
  const schema = "https://vega.github.io/schema/vega-lite/v6.json"; // a name; nothing is loaded from there
  const { view } = await vegaEmbed(`#${id}`, { $schema: schema, width: "container", autosize: { type: "fit-x", contains: "padding" },
    ...make() }, options);
  const summary = document.querySelector(`#${id} summary`);
  if (summary) summary.setAttribute("aria-label", "Export this figure as SVG or PNG");
  const figure = document.getElementById(id).closest("figure");
  const svg = document.querySelector(`#${id} svg.marks`);
  if (svg && figure) svg.setAttribute("aria-label", figure.querySelector("figcaption").textContent.trim());
  return view;
};

new MutationObserver(() => {
  for (const again of bench.charts.values()) again();
}).observe(document.body, { attributes: true, attributeFilter: ["data-md-color-scheme"] });
