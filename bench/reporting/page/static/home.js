// The first screen's picture: every method's error over the bound at each noise level, named where it stands.
"use strict";

bench.home = (data) => {
  const order = data.lines.map((line) => line.m);
  const levels = [...new Set(data.points.map((point) => point.d))].sort((a, b) => b - a);
  const narrow = innerWidth < 640;
  const y = { field: "m", type: "nominal", sort: order, title: null, axis: { labelLimit: narrow ? 120 : 220 } };
  const top = Math.min(Math.max(...data.points.map((point) => point.e)) * 1.1, 6);
  const scale = { type: "log", domain: [Math.min(0.7, ...data.points.map((point) => point.e)), top], nice: false };
  const x = { field: "e", type: "quantitative", scale, title: "error over the bound (log scale)", axis: { values: [0.5, 0.75, 1, 1.5, 2, 3, 5], grid: true } };
  const tips = [["m", "method"], ["d", "SNR (dB)"], ["e", "error over the bound"]].map(([field, title]) => ({ field, title }));
  bench.draw("forest", "forest", () => ({
    height: { step: 19 }, data: { values: data.lines },
    layer: [
      { transform: [{ filter: "datum.g" }], mark: { type: "bar", color: bench.colour("line"), opacity: 0.5, height: 18 },
        encoding: { y, x: { datum: scale.domain[0], type: "quantitative", scale }, x2: { datum: top } } },
      { data: { values: [{ e: data.bound }] }, mark: { type: "rule", color: bench.colour("ink"), strokeWidth: 1.5 }, encoding: { x } },
      { mark: { type: "rule", color: bench.colour("muted"), strokeWidth: 2, clip: true }, encoding: { y, x: { ...x, field: "l" }, x2: { field: "h" } } },
      { data: { values: data.points }, mark: { type: "point", filled: true, size: 62, opacity: 1, clip: true },
        encoding: { y, x, tooltip: tips, color: { field: "d", type: "ordinal", sort: levels,
          scale: { domain: levels, scheme: "viridis", reverse: true }, legend: { title: "SNR (dB)", titleOrient: "left", direction: "horizontal" } } } },
      { mark: { type: "text", align: "left", dx: 6 }, encoding: { y, text: { field: "t" }, x: { value: "width" } } },
    ],
  }));
};
