"""``python -m bench.figures``: the picture of Table 5, from stored rows alone, as SVG and PNG."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.cli import read_folders
from bench.errors import InputError
from bench.store import Store
from bench.tables import TITLES, Entry, entries, paper_numbers

STYLES = {
    "oracle": ("#7f7f7f", "D"), "shooting": ("#0072B2", "o"), "mcmc": ("#56B4E9", "v"), "pinn": ("#D55E00", "s"),
    "pinn_adam": ("#E69F00", "P"), "collocation": ("#8C564B", "h"),
    "ls": ("#000000", "x"), "ls_spline": ("#555555", "+"), "rls": ("#999999", "1"),
    "sindy": ("#009E73", "^"), "ddnn": ("#CC79A7", "*"),
    "output_error": ("#F0E442", "p"), "matrix_pencil": ("#882255", "d"), "log_decrement": ("#44AA99", "<"),
}  # fmt: skip
"""A method's colour (Okabe and Ito's palette, greys, and a few of Tol's) and marker, the same in every picture."""
COINCIDING = {"oracle": 16, "shooting": 13, "mcmc": 10, "collocation": 7.5}
"""Hollow markers of these sizes, so that lines that lie on each other can all be seen."""
PANELS = (
    ("k_over_m_error_pct", "error of k/m (%), root mean square"),
    ("c_over_m_error_pct", "error of c/m (%), root mean square"),
    ("rmse", "displacement error (m), root mean square"),
)
CAPTION = (
    "Error against noise for every method (reference system, start known; failures left out). The grey region lies "
    "below the Cramér-Rao bound, where no unbiased method can be. Orange diamonds in the right panel: the paper's own "
    "PINN. Oracle, shooting, MCMC, PINN and spline collocation lie on each other, on the bound."
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


def draw(found: Sequence[Entry]) -> Any:
    """The figure: one panel a metric, one line a method, over SNR."""
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


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.figures [store=results/rows] [out=results/figures]``; exit status 2 for bad input."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if {"-h", "--help"} & set(arguments):
        print("usage: python -m bench.figures [store=results/rows] [out=results/figures]\n\n" + str(__doc__))
        return 0
    try:
        folders = read_folders(arguments, {"store": "results/rows", "out": "results/figures"})
        out = folders["out"]
        _, _, found = entries("table5", Store(folders["store"]))
        if not any(entry.stored for entry in found):
            raise InputError("store", folders["store"], "no cell of table5 there; run -m experiment=table5 first")
        Store(out).prepare()
        figure = draw(found)
    except ImportError:
        print("bench.figures: matplotlib is missing: pip install 'vibration-bench[figures]'", file=sys.stderr)
        return 2
    except InputError as error:
        print(f"bench.figures: {error}", file=sys.stderr)
        return 2
    for path in save_figure(figure, out, "error_against_noise"):
        print(path)
    (out / "error_against_noise.txt").write_text(CAPTION + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
