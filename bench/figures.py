"""``python -m bench.figures``: the pictures of the tables, from stored rows alone, as SVG and PNG with a caption."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bench.cli import read_folders
from bench.errors import InputError
from bench.estimate import Status
from bench.store import Store
from bench.tables import TITLES, Entry, entries, paper_numbers
from bench.terminal import guarded

STYLES = {
    "oracle": ("#7f7f7f", "D"), "shooting": ("#0072B2", "o"), "mcmc": ("#56B4E9", "v"), "pinn": ("#D55E00", "s"),
    "pinn_adam": ("#E69F00", "P"), "collocation": ("#8C564B", "h"),
    "ls": ("#000000", "x"), "ls_spline": ("#555555", "+"), "rls": ("#999999", "1"),
    "sindy": ("#009E73", "^"), "ddnn": ("#CC79A7", "*"),
    "output_error": ("#B5A300", "p"), "matrix_pencil": ("#882255", "d"), "log_decrement": ("#44AA99", "<"),
}  # fmt: skip
"""A method's colour (Okabe and Ito's palette, greys, and a few of Tol's) and marker, the same in every picture."""
COINCIDING = {"oracle": 16, "shooting": 13, "mcmc": 10, "collocation": 7.5}
"""Hollow markers of these sizes, so that lines that lie on each other can all be seen."""
PANELS = (
    ("k_over_m_error_pct", "error of k/m (%), root mean square"),
    ("c_over_m_error_pct", "error of c/m (%), root mean square"),
    ("rmse", "displacement error (m), root mean square"),
)
NOISE_CAPTION = (
    "Error against noise for every method (reference system, start known; failures left out). The grey region lies "
    "below the Cramér-Rao bound, where no unbiased method can be. Orange diamonds in the right panel: the paper's own "
    "PINN. Oracle, shooting, MCMC, PINN and spline collocation lie on each other, on the bound."
)
TIME_CAPTION = (
    "Accuracy against time at 20 dB (Table 3): excess of k/m over the Cramér-Rao bound, and processor time of a fit. "
    "Marker: the median fit, everything loaded. Line to the right: the slowest, which is the first of a process and "
    "loads and builds what the method needs. Left is faster, low is better, 1 is the best that the data allow."
)


def _root_mean_square(entry: Entry, metric: str) -> float:
    """From the stored summary: excess times bound; NaN where the method has none."""
    summary = entry.stored.summary.get(metric) if entry.stored else None
    return summary["excess"] * summary["bound"] if summary else math.nan


def pyplot() -> Any:
    """matplotlib's pyplot without a display, in the one style of all pictures."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"font.size": 9, "svg.hashsalt": "vibration-bench", "axes.spines.top": False})
    from matplotlib import pyplot

    return pyplot


def save_figure(figure: Any, folder: Path, name: str) -> list[Path]:
    """Write a figure as SVG and PNG, the same bytes for the same picture; returns the paths."""
    paths = []
    for ending, extra in (("svg", {"metadata": {"Date": None}}), ("png", {"dpi": 160})):
        paths.append(folder / f"{name}.{ending}")
        figure.savefig(paths[-1], **extra)
    return paths


def draw_noise(found: Sequence[Entry]) -> Any:
    """One panel a metric, one line a method, over SNR."""
    plt = pyplot()
    found = [entry for entry in found if entry.cell.scenario.told == "known" and entry.stored]
    figure, axes = plt.subplots(1, 3, figsize=(10.5, 4.2), layout="constrained")
    for axis, (metric, label) in zip(axes, PANELS, strict=True):
        bounds = {e.cell.scenario.snr_db: e.stored.summary[metric]["bound"] for e in found if e.stored}
        snrs = sorted(bounds)
        axis.fill_between(snrs, [bounds[s] for s in snrs], 1e-12, color="0.88", lw=0, label="below the bound")
        floor, ceiling = 0.5 * min(bounds.values()), max(bounds.values())
        for method, (colour, marker) in STYLES.items():
            points = {e.cell.scenario.snr_db: _root_mean_square(e, metric) for e in found if e.cell.label == method}
            drawn = [s for s in sorted(points) if math.isfinite(points[s])]
            if drawn:
                ceiling = max(ceiling, *(points[s] for s in drawn))
                values = [points[s] for s in drawn]
                size = COINCIDING.get(method, 5)
                face = "none" if method in COINCIDING else colour
                axis.plot(drawn, values, color=colour, marker=marker, ms=size, mfc=face, lw=1.2, label=TITLES[method])
        if metric == "rmse":
            paper = paper_numbers().query("table == 5")
            style = {"marker": "D", "mfc": "none", "color": "#D55E00", "ls": "none", "ms": 7}
            axis.plot(paper.snr_db, paper.displacement_rmse, label="paper's PINN", **style)
        axis.set(yscale="log", ylim=(floor, 2 * ceiling), xlabel="signal-to-noise ratio (dB)", title=label)
        axis.title.set_fontsize(9)
        axis.set_xticks(snrs)
        axis.invert_xaxis()
        axis.grid(alpha=0.3)
    handles = {label: h for axis in axes for h, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, frameon=False)
    return figure


def draw_time(found: Sequence[Entry]) -> Any:
    """Excess of k/m against processor time, one panel a reading of the start."""
    plt = pyplot()
    panels = list(dict.fromkeys(entry.cell.scenario.told for entry in found))
    figure, axes = plt.subplots(1, len(panels), figsize=(9.5, 4.0), layout="constrained", sharey=True, squeeze=False)
    for axis, told in zip(axes[0], panels, strict=True):
        for entry in found:
            label, stored = entry.cell.label, entry.stored
            if entry.cell.scenario.told != told or stored is None or label not in STYLES or label == "oracle":
                continue
            seconds = sorted(row.cpu_s for row in stored.rows if row.status is Status.OK)
            excess = stored.summary["k_over_m_error_pct"]["excess"]
            if not seconds or not math.isfinite(excess):
                continue
            colour, marker = STYLES[label]
            warm, cold = seconds[len(seconds) // 2], seconds[-1]
            axis.plot([warm, cold], [excess, excess], color=colour, lw=0.8, alpha=0.6)
            axis.plot(warm, excess, color=colour, marker=marker, ms=7, ls="none", label=TITLES[label])
        axis.axhline(1.0, color="0.7", lw=0.8)
        axis.set(xscale="log", yscale="log", xlabel="processor time of a fit (s)", title=f"initial state {told}")
        axis.title.set_fontsize(9)
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("excess of k/m: error / bound")
    handles = {label: h for axis in axes[0] for h, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, frameon=False)
    return figure


PICTURES: dict[str, tuple[str, Callable[[Sequence[Entry]], Any], str]] = {
    "error_against_noise": ("table5", draw_noise, NOISE_CAPTION),
    "accuracy_against_time": ("table3", draw_time, TIME_CAPTION),
}
"""By file name: the experiment whose cells it shows, what draws it, its caption."""


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.figures [store=results/rows] [out=results/figures]``; exit status 2 for bad input."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if {"-h", "--help"} & set(arguments):
        print("usage: python -m bench.figures [store=results/rows] [out=results/figures]\n\n" + str(__doc__))
        return 0
    try:
        folders = read_folders(arguments, {"store": "results/rows", "out": "results/figures"})
        store, out = Store(folders["store"]), folders["out"]
        found = {name: entries(experiment, store)[2] for name, (experiment, _, _) in PICTURES.items()}
        found = {name: own for name, own in found.items() if any(entry.stored for entry in own)}
        if not found:
            raise InputError("store", store.folder, "no cell of a table there; run -m experiment=table5 first")
        Store(out).prepare()
        for name, own in found.items():
            _, draw, caption = PICTURES[name]
            for path in save_figure(draw(own), out, name):
                print(path)
            (out / f"{name}.txt").write_text(caption + "\n", encoding="utf-8")
    except ImportError:
        print("bench.figures: matplotlib is missing: pip install 'vibration-bench[figures]'", file=sys.stderr)
        return 2
    except InputError as error:
        print(f"bench.figures: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(guarded("bench.figures", main))
