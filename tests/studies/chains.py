"""Reach and cost of each method as the number of masses grows."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import pandas as pd

from bench.config.declaration import OneOf
from bench.contract.estimate import Status
from bench.dynamics.modal import modes
from bench.engine.launch import complete
from bench.engine.pool import Limits
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import default_settings, method_names
from bench.errors import InputError
from bench.reporting import frame, labels
from bench.reporting.rounding import excess_text, number
from bench.reporting.tables.pooling import pooled_excess
from bench.reporting.tables.render import markdown_table
from bench.scenario.declaration import Positive
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.store import DEFAULT_STORE, Store, open_store
from bench.store.stored_cell import StoredCell
from bench.systems import Chain
from tests.studies.chains_picture import ASTRAY, caption, picture
from tests.studies.common import RESULTS, Count, Out, publish, study
from tests.studies.common import scenario as common_scenario

SIZES = (1, 2, 3, 5, 10, 20)
SEED = 0
TRUE = {
    "m": (1.0, 0.9, 1.1, 0.8, 1.2), "c": (0.3, 0.25, 0.3, 0.2, 0.25), "k": (20.0, 18.0, 22.0, 16.0, 19.0)
}  # fmt: skip
"""True values (kg, N·s/m, N/m) along the chain, from the ground on, over and over: those of conf/system/chain5."""
PERIODS, PER_PERIOD = 4.0, 4.5
"""Length of the record in periods of the slowest mode; samples a period of the fastest."""
DENSE = 1000
"""Fewest times at which the displacement is scored."""


def true_parameters(n: int) -> dict[str, float]:
    """The true parameters of a chain of n masses."""
    return {f"{kind}{i + 1}": values[i % len(values)] for kind, values in TRUE.items() for i in range(n)}


def natural_frequencies(n: int) -> np.ndarray:
    """Return the undamped natural frequencies (rad/s) of the true chain, rising.

    For n equal masses m and springs k they are ``2 sqrt(k/m) sin((2 i - 1) π / (4 n + 2))``.
    """
    undamped = {name: 0.0 if name.startswith("c") else value for name, value in true_parameters(n).items()}
    return 2.0 * np.pi * modes(Chain(n), undamped).frequencies


@cache
def scenario(n: int) -> Scenario:
    """The chain of n masses; the record is as long, and sampled as fast, as the rule above asks of its true modes.

    The times at which the displacement is scored, and forecast, are the samples' and equal parts of their steps.
    """
    common = common_scenario(system="chain2", snr=30)
    frequencies = natural_frequencies(n)
    duration = float(math.ceil(PERIODS * 2.0 * math.pi / frequencies[0]))
    steps = math.ceil(PER_PERIOD * duration * frequencies[-1] / (2.0 * math.pi))
    dense = steps * math.ceil((DENSE - 1) / steps) + 1
    return replace(
        common, parameters=true_parameters(n), options={"n": n}, initial=((1.0, *[0.0] * (n - 1)), (0.0,) * n),
        duration=duration, samples=steps + 1, dense=dense, forecast=dense * duration / (dense - 1),
        label=f"chain of {n}",
    )  # fmt: skip


def replicates(n: int) -> int:
    """Data sets at a size."""
    return 5 if n <= 5 else 3


def cell(n: int, method: str, count: int) -> Cell:
    """The cell of a method, with its default settings, at a size."""
    return Cell(scenario(n), method, default_settings(method), count, SEED, method)


# ------------------------------------------------------------------------------------------------ computing


def found(n: int, method: str, store: Store) -> StoredCell | None:
    """Return what is stored of a method at a size: all data sets, or the one that it gave up on."""
    cells = (cell(n, method, count) for count in (replicates(n), 1))
    return next((stored for c in cells if (stored := store.load(c.identity)) is not None), None)


def compute(sizes: Sequence[int], methods: Sequence[str], store: Store, limits: Limits) -> None:
    """Compute and store what is lacking, from short chains to long ones; a method is asked until it has no answer."""
    alive = list(methods)
    for n in sorted(sizes):
        complete([cell(n, method, 1) for method in alive], store, limits)
        firsts = {method: store.load(cell(n, method, 1).identity) for method in alive}
        alive = [method for method, stored in firsts.items() if stored is None or stored.n_ok]
        complete([cell(n, method, replicates(n)) for method in alive], store, limits)


# ------------------------------------------------------------------------------------------------ what came out


def line(n: int, method: str, stored: StoredCell | None) -> dict[str, Any]:
    """Return a line of the CSV."""
    system, head = Chain(n), {"n": n, "parameters": 3 * n, "method": method}
    if stored is None:
        return {**head, "n_ok": 0, "n_fits": 0, "status": "not tried"}
    scored = frame.Result.of_stored(stored)
    seconds = [row.cpu_s for row in stored.rows if row.status is Status.OK]
    failed = [row for row in stored.rows if row.status is not Status.OK]
    return {
        **head,
        "n_ok": stored.n_ok, "n_fits": len(stored.rows), "status": stored.status.value,
        "cpu_s": median(seconds) if seconds else math.nan,
        "rmse_m": stored.summary["rmse"]["median"], "rmse_excess": stored.summary["rmse"]["excess"],
        "parameters_excess": pooled_excess(scored, system.names),
        "ratios_excess": pooled_excess(scored, tuple(group.name for group in system.groups)),
        "message": failed[0].message if failed else "",
    }  # fmt: skip


def tidy(sizes: Sequence[int], methods: Sequence[str], store: Store) -> pd.DataFrame:
    """One line a size and method, in the order of the table; a method of which nothing is stored is left out."""
    results = [(n, method, found(n, method, store)) for n in sorted(sizes) for method in methods]
    there = {method for _, method, stored in results if stored is not None} or set(methods)
    return pd.DataFrame([line(*result) for result in results if result[1] in there])


def reach(own: pd.DataFrame) -> str:
    """Return the longest chain that a method solved every time, and what happened on the next one."""
    solved, after = 0, ""
    for _, at in own.iterrows():
        if at.status == "not tried":
            break
        if at.n_ok == at.n_fits and at.rmse_excess < ASTRAY:
            solved = int(at.n)
            continue
        failed = f"{at.n_fits - at.n_ok} of {at.n_fits} failed ({at.message})" if at.n_ok < at.n_fits else ""
        astray = f"excess {excess_text(at.rmse_excess)}" if at.n_ok and not at.rmse_excess < ASTRAY else ""
        after = f"{at.n:.0f}: {'; '.join(part for part in (failed, astray) if part)}"
        break
    return f"| {solved or 'none'} | {after or '-'} |"


def entry(at: Mapping[str, Any]) -> list[str]:
    """Return the columns of a size: time, excesses, successes."""
    values = [at[key] for key in ("rmse_excess", "parameters_excess", "ratios_excess")]
    texts = ["-" if math.isnan(value) else excess_text(value) for value in values]
    return [number(at["cpu_s"]), *texts, f"{at['n_ok']:.0f}/{at['n_fits']:.0f}"]


TEXT = """Regenerate: `python -m tests.studies.chains` (what is stored already is not computed again).

Chains of n masses, every displacement measured, 30 dB, the first mass released from 1 m, initial state known, nominal
prior, 5 data sets up to five masses, 3 above. True values along the chain from the ground on, repeated: masses {m} kg,
dampers {c} N·s/m, springs {k} N/m. A record lasts {periods:g} periods of the slowest mode, in whole seconds, and has
{per:g} samples per period of the fastest: the scenario is designed from the true natural frequencies, the methods get
its record alone. One setting per method, its default; limits of {timeout:g} s of wall time and 4 GB per fit; one
thread. A method that fails on the first data set of a size within these limits is not run on the others.

*Time*: processor seconds, median over the successful fits. *rmse*, *parameters*, *ratios*: root mean square error over
the Cramér-Rao bound, 1 being the smallest that an unbiased method can reach, of the displacement; of all 3 n masses,
dampers and springs together (root mean over them of its square); and of their 3 n - 1 ratios to the first mass, which
are identifiable. The prior determines the scale, and with it much of the bound of the parameters. Errors are of the
successful fits only; *ok* says how many. *oracle* is maximum a posteriori started at the true values, *prior* the
nominal values without any data. A single excess of so few data sets is uncertain: the oracle's shows by how much, since
all methods get the same data."""


def page(data: pd.DataFrame, timeout_s: float) -> str:
    """The tables as a page."""
    joined = {kind: "/".join(f"{value:g}" for value in values) for kind, values in TRUE.items()}
    text = TEXT.format(periods=PERIODS, per=PER_PERIOD, timeout=timeout_s, **joined)
    parts = ["# Chains: reach and cost", text]
    methods = list(dict.fromkeys(data.method))
    served = [m for m in methods if not (data[data.method == m].status == Status.UNSUPPORTED.value).all()]
    lines = [f"| {labels.title(m)} {reach(data[data.method == m])}" for m in served if m != "prior"]
    head = f"| method | solved up to n = (all fits ok, rmse excess below {ASTRAY:g}) | and then, at n = |"
    parts += ["## Where each method gives up", "\n".join([head, "|---|---|---|", *lines])]
    parts += ["![Time and excess against the number of masses](figures/chains.png)", caption(data)]
    columns = ["method", "time (s)", "rmse", "parameters", "ratios", "ok"]
    for n, own in data.groupby("n", sort=True):
        cell_scenario = scenario(int(n))
        rows = [[labels.title(at["method"]), *entry(at)] for at in own.to_dict("records") if _asked(at)]
        size = f"{3 * n} parameters, {cell_scenario.samples} samples of each mass over {cell_scenario.duration:g} s"
        parts += [f"## n = {n}: {size}", markdown_table(rows, columns)]
    unsupported = data[data.status == Status.UNSUPPORTED.value].drop_duplicates("method")
    if len(unsupported):
        said = "\n".join(f"- {labels.title(at.method)}: {at.message} (n = {at.n})" for at in unsupported.itertuples())
        parts += ["## Not served", said]
    return "\n\n".join(parts) + "\n"


def _asked(at: Mapping[str, Any]) -> bool:
    return at["status"] not in (Status.UNSUPPORTED.value, "not tried")


# ------------------------------------------------------------------------------------------------ command line


def chains(
    sizes: Annotated[tuple[Count, ...], "numbers of masses"] = SIZES,
    methods: Annotated[tuple[str, ...], OneOf(method_names), "methods; left out: all"] = (),
    timeout_s: Annotated[Positive, "s by the clock, limit of a fit"] = 120.0,
    workers: Annotated[Count, "processes that fit"] = 1,
    store: Annotated[Path, "folder of finished cells, which are not computed again"] = Path(DEFAULT_STORE),
    out: Out = RESULTS,
    fit: Annotated[bool, "false: page and picture of the published table"] = True,
) -> int:
    """Measure how far each method reaches as the number of masses grows, and what it costs.

    Chains of 1 to 20 masses, every displacement measured, 30 dB, the first mass released from 1 m, initial state known,
    nominal prior. At each size every method first gets one data set; one that gives no answer within the limits is not
    asked again, neither for more data sets of that size nor for longer chains.
    """
    if fit:
        opened, names = open_store(store), methods or (*REFERENCES, *_others())
        opened.prepare()
        compute(sizes, names, opened, Limits(workers, timeout_s))
        publish(out / "chains.csv", tidy(sizes, names, opened).to_csv(index=False, float_format="%.5g"))
    table = out / "chains.csv"
    if not table.is_file():
        raise InputError("out", out, "a folder with chains.csv; without fit=false it is written")
    data = pd.read_csv(table).fillna({"message": ""})
    publish(out / "chains.md", page(data, timeout_s))
    print(*picture(data, out / "figures"), sep="\n")
    return 0


def _others() -> list[str]:
    """Return the registered methods in the order of the other tables, any others behind."""
    return labels.in_order(name for name in method_names() if name not in REFERENCES)


main = partial(study, chains, "tests.studies.chains", interrupted="interrupted; the same command goes on from here")

if __name__ == "__main__":
    sys.exit(main())
