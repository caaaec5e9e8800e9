"""``python -m tests.studies.extremes``: what becomes of each method where methods fail that should not.

Six scenarios off the tables, on a seed that nothing was tuned on: next to no noise, as much noise as signal, two real
poles, ten thousand samples, few samples, five samples; and the NIST's MGH17, which is an overdamped mass with an
offset. The cells are computed by the harness's own runner and kept in its store, so a second run makes the table only.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import bench
from bench.config.experiment import expand
from bench.config.schema import Job
from bench.contract.problem import Channel, Problem, Record
from bench.engine.launch import complete
from bench.engine.pool import Limits
from bench.entrants.registry import default_settings, method_names
from bench.errors import InputError
from bench.reporting.labels import title
from bench.reporting.rounding import excess_text
from bench.reporting.tables.common import csv, markdown_table
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.store import DEFAULT_STORE, Store, open_store
from bench.systems.linear import SDOF
from tests.studies.fields import command, read_fields, whole

SEED = 987
PLAIN = {"m": 2.0, "c": 0.5, "k": 30.0}
CASES: dict[str, dict[str, Any]] = {
    "200 dB": {"snr_db": 200.0},
    "0 dB, start unknown": {"snr_db": 0.0, "initial_state": "unknown"},
    "damping ratio 1.2": {"snr_db": 30.0, "parameters": {**PLAIN, "c": 2.4 * math.sqrt(60.0)}, "duration": 3.0},
    "10,000 samples": {"parameters": {**PLAIN, "c": 0.1}, "duration": 32.0, "samples": 10_000, "dense": 10_000},
    "33 samples": {"snr_db": 17.0, "parameters": {"m": 3.3, "c": 0.11, "k": 41.0}, "duration": 7.0, "samples": 33},
    "5 samples": {"duration": 2.0, "samples": 5},
}
"""By name what differs from 40 samples in 8 s of a mass of 2 kg, 0.5 N s/m, 30 N/m, 20 dB, start told."""
LEFT_OUT = ("nuts", "ddnn", "pinn_adam", "prior")
"""Minutes a fit, and the baseline that sees no data."""
METRICS = {"k_over_m": "k/m", "c_over_m": "c/m"}
CERTIFIED = {
    "b1": 3.7541005211e-01,
    "b2": 1.9358469127,
    "b3": -1.4646871366,
    "b4": 1.2867534640e-02,
    "b5": 2.2122699662e-02,
}
"""Certified values of MGH17 (NIST Statistical Reference Datasets, nonlinear regression): y = b1 + b2 e^(-b4 x) + ..."""
USAGE = f"""usage: python -m tests.studies.extremes [methods=<a,b>] [replicates=20] [timeout_s=60] [workers=2]
                                            [store={DEFAULT_STORE}] [out=results] [before=<extremes.csv>]
                                            [nist=../shared/data/nist_mgh17/MGH17.dat]

before: the file of an earlier run, to be shown beside this one
nist: the record of the NIST; left out where there is none"""


def scenario(case: str) -> Scenario:
    """The scenario of a case."""
    common = expand(["method=prior", "system=sdof", "snr=20"], multirun=False)[0].scenario
    plain = {"parameters": PLAIN, "duration": 8.0, "samples": 40, "label": case}
    return replace(common, **{**plain, **CASES[case]})


def cells(methods: Sequence[str], replicates: int) -> dict[tuple[str, str], Cell]:
    """By case and method."""
    found = {}
    for case in CASES:
        for method in methods:
            job: Job = expand([f"method={method}"], multirun=False)[0]
            found[case, method] = replace(job.cell(), scenario=scenario(case), replicates=replicates, seed=SEED)
    return found


def lines(found: Mapping[tuple[str, str], Cell], store: Store) -> list[dict[str, Any]]:
    """One line a case and method."""
    rows = []
    for (case, method), cell in found.items():
        stored = store.load(cell.identity)
        if stored is None:
            continue
        line: dict[str, Any] = {"case": case, "method": method, "n_ok": stored.n_ok, "n": len(stored.rows)}
        for name in METRICS:
            line[f"{name}_excess"] = stored.summary.get(f"{name}_error_pct", {}).get("excess", math.nan)
            line[f"{name}_coverage"] = stored.summary.get(f"{name}_coverage_95", {}).get("mean", math.nan)
        ours = [row for row in stored.rows if row.status.value != "ok"] or [row for row in stored.rows if row.message]
        line["says"] = f"{ours[0].status.value}: {ours[0].message}" if ours else ""
        rows.append(line)
    return rows


# ------------------------------------------------------------------------------------------------ the NIST's record


def certified() -> dict[str, float]:
    """k/m and c/m of the certified exponentials: product and sum of their rates."""
    slow, fast = CERTIFIED["b4"], CERTIFIED["b5"]
    return {"k_over_m": slow * fast, "c_over_m": slow + fast}


def digits(path: Path, methods: Sequence[str]) -> list[dict[str, Any]]:
    """Correct digits of each method's k/m and c/m, and how many of its standard deviations it is off."""
    y, x = np.loadtxt(path, skiprows=60, max_rows=33).T
    channel = Channel(x, y, offset=True)
    problem = Problem(SDOF(), (Record((channel,)),))
    rows = []
    for method in methods:
        identifier = bench.entrants.registry.load_method(method)(**default_settings(method))
        estimate = identifier.identify(problem, np.random.default_rng(SEED))
        row: dict[str, Any] = {"method": method, "says": f"{estimate.status.value}: {estimate.message}".strip(": ")}
        for name, value in certified().items():
            marginal = estimate.marginal(problem.system.quantity(name)) if estimate.status.value == "ok" else None
            if marginal is not None:
                low, high = marginal.interval(0.95)
                row[f"{name}_digits"] = -math.log10(max(abs(marginal.value / value - 1.0), 1e-15))
                row[f"{name}_held"] = low <= value <= high
        rows.append(row)
    return rows


# ------------------------------------------------------------------------------------------------ the page


def page(rows: Sequence[Mapping[str, Any]], before: pd.DataFrame | None, nist: Sequence[Mapping[str, Any]]) -> str:
    """The page as Markdown."""
    parts = ["# Extremes", __doc__.partition("\n\n")[2].strip()]
    earlier = {} if before is None else {(r["case"], r["method"]): r for r in before.to_dict("records")}
    parts.append(
        "Excess of k/m and c/m over the bound, and how many of 95 % intervals hold it; answers out of data sets. "
        "A status and its sentence where not all were answered." + (" After the arrow, before." if earlier else "")
    )
    for case in CASES:
        own = [row for row in rows if row["case"] == case]
        table = [[title(row["method"]), *_cells(row, earlier.get((case, row["method"]))), row["says"]] for row in own]
        heads = [head for name in METRICS.values() for head in (f"excess {name}", "held")]
        parts += [f"## {case[0].upper()}{case[1:]}", markdown_table(table, ["method", "answers", *heads, "says"])]
    if nist:
        heads = [head for name in METRICS.values() for head in (f"digits {name}", "held")]
        table = [[title(str(r["method"])), *_digits(r), str(r["says"])] for r in nist]
        parts += ["## MGH17", "Correct digits of the certified values, and whether the 95 % interval holds them."]
        parts.append(markdown_table(table, ["method", *heads, "says"]))
    parts.append("Regenerate: `python -m tests.studies.extremes`")
    return "\n\n".join(parts) + "\n"


def _cells(row: Mapping[str, Any], before: Mapping[str, Any] | None) -> list[str]:
    def beside(text: str, other: str) -> str:
        return text if before is None or other == text else f"{text} ← {other}"

    def share(value: float) -> str:
        return "-" if math.isnan(value) else f"{100 * value:.0f} %"

    old = before or row
    found = [beside(f"{row['n_ok']}/{row['n']}", f"{old['n_ok']}/{old['n']}")]
    for name in METRICS:
        found.append(beside(excess_text(row[f"{name}_excess"]), excess_text(old[f"{name}_excess"])))
        found.append(beside(share(row[f"{name}_coverage"]), share(old[f"{name}_coverage"])))
    return found


def _digits(row: Mapping[str, Any]) -> list[str]:
    found = []
    for name in METRICS:
        found.append(f"{row[f'{name}_digits']:.1f}" if f"{name}_digits" in row else "-")
        found.append({True: "yes", False: "no"}[row[f"{name}_held"]] if f"{name}_held" in row else "-")
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Write ``extremes.md`` and ``extremes.csv``; exit status 2 for bad input."""
    return command(
        "tests.studies.extremes", f"{USAGE}\n\n{__doc__}", argv, _main, "interrupted; finished cells are kept"
    )


def _main(arguments: Sequence[str]) -> int:
    usual = {
        "methods": "", "replicates": "20", "timeout_s": "60", "workers": "2", "store": DEFAULT_STORE, "archive": "",
        "out": "results", "before": "", "nist": "../shared/data/nist_mgh17/MGH17.dat",
    }  # fmt: skip
    fields = read_fields(arguments, usual)
    methods = fields["methods"].split(",") if fields["methods"] else [m for m in method_names() if m not in LEFT_OUT]
    if unknown := [name for name in methods if name not in method_names()]:
        raise InputError("methods", unknown[0], f"one of: {', '.join(method_names())}")
    store = open_store(fields["store"], fields["archive"])
    store.prepare()
    found = cells(methods, whole("replicates", fields["replicates"], 1))
    limits = Limits(whole("workers", fields["workers"], 1), float(fields["timeout_s"]))
    complete(list(found.values()), store, limits)
    rows = lines(found, store)
    nist = digits(Path(fields["nist"]), [m for m in methods if m != "oracle"]) if Path(fields["nist"]).is_file() else []
    before = pd.read_csv(fields["before"]) if fields["before"] else None
    out = Path(fields["out"])
    (out / "extremes.md").write_text(page(rows, before, nist), encoding="utf-8")
    (out / "extremes.csv").write_text(csv(rows, 5), encoding="utf-8")
    print(out / "extremes.md", out / "extremes.csv", sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
