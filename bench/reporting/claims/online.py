"""What README says of the online track: Table 10 and the study of the online methods."""

from __future__ import annotations

import re

import pandas as pd

from bench.config.online import online_scenario
from bench.reporting.claims.claim import Claim, Said, claim, fold, number, said
from bench.reporting.claims.evidence import Evidence
from bench.reporting.tables.online_table import BOUND

KNOWN, UNKNOWN = "step10_multisine", "step10_ambient"
TITLES = {
    "ekf": "the EKF", "ukf": "the UKF", "square_root": "the square-root EKF", "imm": "the IMM",
    "change_points": "Bayesian change-point detection", "cusum": "the EKF with CUSUM", "glr": "the likelihood ratio",
    "ar": "the recursive AR model", "ssi": "SSI",
}  # fmt: skip


def _nearest(e: Evidence, scenario: str) -> dict[str, str]:
    """The method nearest to the bound by the farther of k/m and c/m, its excesses and its delay, and the bound's."""
    table = e.rows("table10", scenario=scenario)
    table = table[table.ok == table.ok.max()]
    wide = table.pivot(index="method", columns="quantity", values="excess").drop(index=BOUND).dropna()
    best = str(wide.max(axis=1).idxmin())
    delays = table[table.quantity == "k_over_m"].set_index("method").delay
    excess = wide.loc[best]
    return {
        "method": TITLES.get(best, best),
        "k": fold(float(excess["k_over_m"])),
        "c": fold(float(excess["c_over_m"])),
        "delay": f"{delays[best]:.0f}",
        "bound": f"{delays[BOUND]:.0f}",
    }


@claim
def online_steps(e: Evidence) -> Said:
    """- **A stiffness that falls by {change}**, at 20 dB. Under a known multisine {known_method} is nearest to the
    bound (k/m {known_k} times, c/m {known_c}); its interval excludes the old value after {known_delay} samples, where
    the bound would allow it after {known_bound}. Under an unknown white force {unknown_method} is (k/m {unknown_k},
    c/m {unknown_c}), after {unknown_delay} samples beside {unknown_bound}. The bound is told when the stiffness
    changes, and that it is the stiffness; a tracker has to find that out, and errs by the whole change meanwhile.
    """
    found = {"known": _nearest(e, KNOWN), "unknown": _nearest(e, UNKNOWN)}
    change = online_scenario(KNOWN).varying["k"].change
    return said(
        {
            "no tracker is below the bound": min(float(own["k"]) for own in found.values()) >= 1.0,
            "an unknown force takes longer": float(found["unknown"]["delay"]) > float(found["known"]["delay"]),
        },
        change=f"{abs(change):.0%}".replace("%", " %"),
        **{f"{kind}_{name}": text for kind, own in found.items() for name, text in own.items()},
    )


def _first_numbers(column: pd.Series) -> pd.Series:
    """The number that each entry begins with."""
    return column.map(_ratio)


@claim
def online_constant(e: Evidence) -> Said:
    """- **Nothing changes**: at the end of {samples} samples the filters' errors are {k_low} to {k_high} (k/m) and
    {c_low} to {c_high} (c/m) times the bound for all samples, those of shooting in a window {window_k} and
    {window_c} times the bound for the window; 95 % intervals of k/m hold the truth in {cover_low} to {cover_high} %
    of up to {records} records. False alarms in {per} samples: change points {change_points} (stated:
    at most {change_points_most}), CUSUM {cusum} ({cusum_most}), likelihood ratio {glr} ({glr_most}).
    """
    table = e.study("online.md", "Nothing changes")
    window = table.method.str.contains("window")
    k, c = _first_numbers(table["k/m excess"]), _first_numbers(table["c/m excess"])
    cover = _first_numbers(table["k/m cov. %"])
    alarms = table.set_index("method")[["false alarms in 10,000 samples", "at most, stated"]]
    own = {"change_points": "change points", "cusum": "CUSUM", "glr": "likelihood ratio"}
    return said(
        {
            "the window is near its bound": float(k[window].max()) < 1.3,
            "the best filter is near the bound": float(k[~window].min()) < 1.15,
        },
        samples=table["samples used"].max(),
        k_low=f"{k[~window].min():.2f}", k_high=f"{k[~window].max():.2f}",
        c_low=f"{c[~window].min():.2f}", c_high=f"{c[~window].max():.2f}",
        window_k=f"{k[window].iloc[0]:.2f}", window_c=f"{c[window].iloc[0]:.2f}",
        cover_low=f"{cover.min():.0f}", cover_high=f"{cover.max():.0f}",
        records=f"{table.records.astype(int).max():,}", per="10,000",
        **{name: alarms.iloc[:, 0][title] for name, title in own.items()},
        **{f"{name}_most": alarms.iloc[:, 1][title] for name, title in own.items()},
    )  # fmt: skip


@claim
def online_faults(e: Evidence) -> Said:
    """- **Faults** (missing values, a gap, repeated times, a sensor at its limit, spikes, a jump of its zero, a step
    that raises, a restart): behind them the errors of EKF and IMM are {least} to {most} times those without the fault,
    most for {worst}. Not every method stands all of them: without an answer on some record are {lost}.
    """
    table = e.study("online.md", "Faults").set_index("method").drop(columns="records").map(_ratio)
    filters = table.loc[["EKF", "IMM"]]
    words = {"saturation": "the sensor at its limit", "jump": "the jump", "gap": "the gap", "nan": "missing values",
             "spike": "spikes", "repeated": "repeated times", "crash": "the step that raises",
             "restart": "the restart"}  # fmt: skip
    lost = [f"{method} behind {words[fault]}" for method, own in table.iterrows() for fault in own.index[own.isna()]]
    return said(
        {"a restart changes nothing": bool((table["restart"] == 1.0).all()), "some method is lost": bool(lost)},
        least=f"{filters.min().min():.2f}", most=f"{filters.max().max():.2f}",
        worst=words[str(filters.max().idxmax())], lost=", ".join(lost),
    )  # fmt: skip


def _ratio(text: str) -> float:
    """The number of "1.02 ± 0.01"; NaN of "no answer"."""
    found = re.match(r"[\d.]+", text)
    return float(found.group()) if found else float("nan")


@claim
def online_cost(e: Evidence) -> Said:
    """- **A sample costs** {ekf} µs with the EKF, {points} µs with change points, {ar} µs with the recursive AR model
    (median of {samples} samples, one process alone), however many came before; the EKF holds {kb} kB all along. A
    live page, fed {rate} samples a second, is {behind} s behind (median; at most {most} s).
    """
    table = e.study("online.md", "A long record").set_index("method")
    live = e.study("online.md", "A live run").iloc[0]
    micros = table["µs a sample, median"]
    held = [column for column in table.columns if "after" in column]
    return said(
        {
            "memory is constant": bool((table[held[0]] == table[held[1]]).all()),
            "nothing is asked for elsewhere": live["requests elsewhere"] == "0" and live["console messages"] == "0",
        },
        ekf=micros["EKF"], points=micros["change points"], ar=micros["AR, recursive"],
        samples=held[1].removeprefix("after "), kb=number(float(table[held[1]]["EKF"])),
        rate=live["samples a second"], behind=live["page behind, median s"], most=live["largest s"],
    )  # fmt: skip


CLAIMS: tuple[Claim, ...] = (online_steps, online_constant, online_faults, online_cost)
