"""Export a cell as a notebook: the same computation in Python, its scores, and a figure of its first record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.store.cell import Cell

NAMED = ("method", "system", "snr", "initial_state", "prior", "disturbance", "replicates", "seed")
"""Fields that are arguments of :func:`bench.run`; others are its ``settings``."""
PICTURE = """import altair as alt
import pandas as pd

arrays = results[0].stored.arrays
curves = {"truth": arrays["true_displacement"][0]}
if "displacement" in arrays:
    curves["identified"] = arrays["displacement"][0]
lines = pd.DataFrame({"time": arrays["dense_times"], **curves}).melt("time", var_name="curve")
first = arrays["sample_dof"] == arrays["sample_dof"][0]
samples = pd.DataFrame({"time": arrays["sample_times"][first], "value": arrays["sample_values"][first]})
axes = {"x": alt.X("time").title("time (s)"), "y": alt.Y("value").title("displacement (m)")}
alt.Chart(lines).mark_line().encode(**axes, color="curve") + alt.Chart(samples).mark_point().encode(**axes)"""


def notebook(cell: Cell, overrides: Mapping[str, Sequence[Any]]) -> str:
    """Return a notebook (nbformat 4) that computes a cell as the overrides describe it."""
    from nbformat import v4, writes

    scenario = cell.scenario
    values = {name: values[-1] for name, values in overrides.items()}
    arguments = {name: values.pop(name) for name in NAMED if name in values}
    arguments |= {"settings": values} if values else {}
    call = "".join(f"    {name}={value!r},\n" for name, value in arguments.items())
    cells = [
        v4.new_markdown_cell(
            f"# {cell.label} on {scenario.label}, {scenario.snr_db:g} dB\n\n"
            f"{cell.replicates} replicates of seed {cell.seed}, initial state {scenario.initial_state}. "
            "Stored results are not recomputed."
        ),
        v4.new_code_cell(f"import bench\n\nresults = bench.run(\n{call})\nresults"),
        v4.new_markdown_cell("Every metric: median over the replicates with its interval, the bound, and the excess."),
        v4.new_code_cell("results.frame()"),
        v4.new_markdown_cell("The first record with the true and the identified motion."),
        v4.new_code_cell(PICTURE),
    ]
    for number, part in enumerate(cells):
        part["id"] = f"cell-{number}"  # the same notebook each time
    return str(writes(v4.new_notebook(cells=cells, metadata={"language_info": {"name": "python"}})))
