"""Claims on the studies beside the tables: the PINN engine, fits by hand, chains, a measured record."""

from __future__ import annotations

import pandas as pd

from bench.reporting.claims.claim import Said, claim, exceptions, number, said, span
from bench.reporting.claims.evidence import Evidence


def _floats(column: pd.Series) -> pd.Series:
    """Numbers that a page wrote as text, with or without thousands' commas and a unit behind; NaN for a dash."""
    return column.str.replace(",", "").str.extract(r"(-?[\d.]+(?:e[+-]?\d+)?)", expand=False).astype(float)


def _entry(table: pd.DataFrame, row: str, column: str) -> float:
    """The number of the row whose first entry is, or else alone begins, so, in the one column that begins so."""
    names = table.iloc[:, 0]
    (line,) = names.index[names == row] if (names == row).any() else names.index[names.str.startswith(row)]
    (wanted,) = [name for name in table if name.startswith(column)]
    return float(_floats(table[wanted])[line])


# ---- the PINN engine

PAPER_STEPS = 1000
"""Of L-BFGS, which `method=pinn_adam` is given."""


@claim
def engine_time(e: Evidence) -> Said:
    """- On one core and the very same loss it is within 1 % of the minimum in {ours} s. A usual PyTorch PINN (Adam,
    then L-BFGS) and DeepXDE never come so near: their whole trainings of {naive} and {deepxde} s end {naive_above}
    and {deepxde_above} % above it. Whole against whole they take {naive_ratio} and {deepxde_ratio} times as long as
    `method=pinn` ({pinn} s; its loss has a start and a prior, too), and {naive_adam} and {deepxde_adam} times as long
    as `method=pinn_adam` ({adam} s).
    """
    table = e.study("pinn.md", "Time against other inverse PINNs")
    time, above = "seconds a fit", "above the minimum"
    ours, naive, deepxde = "their loss", "naive PyTorch", "DeepXDE"
    pinn, adam = (_entry(table, f"method={name},", time) for name in ("pinn", "pinn_adam"))
    return said(
        {
            "ours is at the minimum": _entry(table, ours, above) <= 1,
            "the others stop above it": min(_entry(table, naive, above), _entry(table, deepxde, above)) > 1,
            "and take a hundred times longer than a whole fit": _entry(table, naive, time) > 100 * pinn,
        },
        ours=number(_entry(table, ours, time), 1),
        naive=number(_entry(table, naive, time)),
        naive_above=number(_entry(table, naive, above), 1),
        deepxde=number(_entry(table, deepxde, time)),
        deepxde_above=number(_entry(table, deepxde, above), 1),
        naive_ratio=number(_entry(table, naive, time) / pinn),
        deepxde_ratio=number(_entry(table, deepxde, time) / pinn),
        naive_adam=number(_entry(table, naive, time) / adam),
        deepxde_adam=number(_entry(table, deepxde, time) / adam),
        pinn=number(pinn),
        adam=number(adam),
    )


@claim
def engine_steps(e: Evidence) -> Said:
    """- The paper's training gets there, too, at its price: at 40 dB its k/m is {few} standard errors off the minimum
    (the largest of {fits} fits) after {first} steps of L-BFGS, {short} s, and {many} after {last}, {long} s, and even
    then {ended} of {fits} had come to an end of their own.
    """
    table = e.study("pinn.md", "What the steps of first-order training buy")
    loud = table[table["SNR (dB)"] == "40"]
    steps, off = _floats(loud["steps of L-BFGS"]), _floats(loud["off by (largest)"])
    seconds, (at_limit, fits) = _floats(loud["CPU s a fit"]), loud["ended at the limit"].iloc[-1].split(" of ")
    (usual,), last = [i for i in steps.index if steps[i] == PAPER_STEPS], steps.idxmax()
    return said(
        {
            "the paper's budget ends short of the minimum": off[usual] > 0.5,
            "more steps come to it": off[last] < 0.05,
            "and take far longer": seconds[last] > 5 * seconds[usual],
        },
        few=number(off[usual]),
        many=number(off[last], 1),
        first=f"{steps[usual]:,.0f}",
        last=f"{steps[last]:,.0f}",
        short=number(seconds[usual]),
        long=number(seconds[last], 2),
        ended=str(int(fits) - int(at_limit)),
        fits=fits,
    )


@claim
def engine_initialisation(e: Evidence) -> Said:
    """- {fits} random initialisations give the same k/m to {deviation}, relative; from {starts} starting values
    (k/m 0.5 to 40, c/m 0.05 to 2) {same} fits reach the same minimum. So the spread over initialisations, the
    paper's uncertainty, says next to nothing about the error: see [calibration](results/calibration.md).
    """
    weights, values = e.study("pinn.md", "Different random weights"), e.study("pinn.md", "Different starting values")
    deviation, interval = (_entry(weights, "pinn", name) for name in ("largest deviation", "half the 95"))
    starts, same = (_entry(values, "pinn", name) for name in ("starting values", "the same minimum"))
    return said(
        {
            "the spread is below a hundredth of the interval": deviation < 0.01 * interval,
            "95 % of the starts or more reach the same minimum": same >= 0.95 * starts,
        },
        fits=f"{_entry(weights, 'pinn', 'initialisations'):.0f}",
        deviation=f"{deviation:.0e}".replace("e-0", "e-"),
        starts=f"{starts:.0f}",
        same="all" if same == starts else f"{same:.0f}",
    )


AT_ORACLE = 1.15
"""Errors over the oracle's up to which parameters are said to be as good."""


@claim
def engine_reach(e: Evidence) -> Said:
    """- It was tried in chains of up to {masses} masses and records of up to {cycles} cycles, the spline to
    {spline_masses} masses (from a cold start in {seconds} s) and {spline_cycles} cycles. Their parameters are as good
    as the oracle's (errors at most {near} % above) but for the PINN's at {worse} and the spline's at {spline_worse},
    the errors over the oracle's in brackets: with many samples the share of the noise by which the equation of motion
    is softened shows. It shows in the displacement, too, which is up to {off} times as far off as the oracle's. The
    PINN takes {cheaper} times as long as the spline.
    """
    table = e.study("pinn.md", "Cost and reach")
    table["error"], table["seconds"] = _floats(table["groups / oracle"]), _floats(table["CPU s a fit"])
    table["off"], table["count"] = _floats(table["displacement / oracle"]), _floats(table["size"])
    table["kind"] = table["size"].str.split().str[-1]
    pinn, spline = (table[table.method == one].set_index("size") for one in ("pinn", "collocation"))
    (cycles, masses), (spline_cycles, spline_masses) = (
        [own[own.kind == kind]["count"].max() for kind in ("cycles", "masses")] for own in (pinn, spline)
    )
    largest = spline[(spline.kind == "masses") & (spline["count"] == spline_masses)]
    ratio = pinn.seconds / spline.seconds.reindex(pinn.index)
    both = pd.concat([pinn, spline])
    worse, spline_worse = (exceptions(list(own.error.items()), AT_ORACLE) for own in (pinn, spline))
    return said(
        {
            "most sizes are reached": (both.error < AT_ORACLE).mean() > 0.9,
            "the largest are": bool((largest.error < AT_ORACLE).all()),
            "the spline goes further": spline_masses > masses and spline_cycles > cycles,
            "the spline is cheaper": ratio.min() > 1,
            "the displacement is not as good": both.off.max() > AT_ORACLE,
        },
        near=f"{max(0.0, 100 * (both.error[both.error < AT_ORACLE].max() - 1)):.0f}",
        cycles=f"{cycles:.0f}",
        masses=f"{masses:.0f}",
        worse=worse,
        spline_cycles=f"{spline_cycles:.0f}",
        spline_masses=f"{spline_masses:.0f}",
        spline_worse=spline_worse,
        seconds=number(largest.seconds.iloc[0]),
        off=number(both.off.max()),
        cheaper=span(ratio, number),
    )


# ---- by hand, and with many masses


@claim
def by_hand(e: Evidence) -> Said:
    """- **Beside `least_squares` around `solve_ivp`**, what one would write by hand
    ([table](results/handwritten.md)): on the Duffing oscillator as good, in {duffing} times the time of multiple
    shooting; on five masses it finds the solution in {hand} of {sets} data sets, multiple shooting in {shooting},
    the time by hand being {chain} times its.
    """
    table = e.study("handwritten.md")
    time = _floats(table["time, median (s)"])
    found, asked = (table.success.str.extract(r"(\d+)/(\d+)")[i].astype(int) for i in (0, 1))
    hand, ours = table.what.str.startswith("by hand"), table.what == "method=shooting"

    def ratio(system: str) -> list[float]:
        one = table.system == system
        return [by / of for by, of in zip(time[one & hand], time[one & ours], strict=True)]

    chain, duffing = table.system == "chain5", table.system == "duffing"
    by, of = int(found[chain & hand].sum()), int(found[chain & ours].sum())
    return said(
        {
            "on the Duffing oscillator both always succeed": (found == asked)[duffing & (hand | ours)].all(),
            "on five masses shooting succeeds more often": of > by,
            "and takes less time": min(ratio("chain5")) > 1,
        },
        duffing=span(ratio("duffing"), number),
        hand=str(by),
        sets=str(int(asked[chain & hand].sum())),
        shooting=str(of),
        chain=span(ratio("chain5"), number),
    )


@claim
def chains(e: Evidence) -> Said:
    """- **How far each method gets with 1 to 20 masses** ([chains](results/chains.md)): from a cold start multiple
    shooting solves up to {shooting} masses and MCMC up to {mcmc}, ten of them on the bound (displacement {excess}
    times it) in {seconds} s. The extended Kalman filter stops at {ekf}, NUTS at {nuts}, the spline at
    {collocation}, the unscented filter at {ukf}, and the PINN at {pinn}, where it takes {pinn_seconds} s; output
    error finds the right basin by luck. A fit is stopped after two minutes.
    """
    table = e.table("chains")

    def reach(method: str) -> int:
        """The most masses up to which all fits succeed, within three times the bound."""
        lines = table[table.method == method].sort_values("n")
        failed = lines[(lines.n_ok < lines.n_fits) | (lines.n_fits == 0) | ~(lines.rmse_excess < 3)]
        return int(lines[lines.n < failed.n.min()].n.max()) if len(failed) else int(lines.n.max())

    far = {method: reach(method) for method in ("shooting", "mcmc", "ekf", "nuts", "collocation", "ukf", "pinn")}
    ten = table[(table.n == 10) & table.method.isin(("shooting", "mcmc"))].sort_values("method", ascending=False)
    cold = table[table.method == "output_error"].sort_values("n").rmse_excess
    pinn = table[(table.method == "pinn") & (table.n == far["pinn"])].cpu_s
    others = max(reach for method, reach in far.items() if method not in ("shooting", "mcmc"))
    return said(
        {
            "shooting and MCMC get farthest": min(far["shooting"], far["mcmc"]) > others,
            "they are on the bound there": ten.rmse_excess.max() < 1.25,
            "output error fails with fewer masses than it succeeds with": (cold.diff() < -3).any(),
        },
        excess=span(ten.rmse_excess),
        seconds=span(ten.cpu_s, number),
        pinn_seconds=number(pinn.max()),
        **{method: str(reach) for method, reach in far.items()},
    )


# ---- a measured record


@claim
def silverbox(e: Evidence) -> Said:
    """- Root mean square error {multisine} mV on the test multisine, {arrow} mV on the arrow, which goes beyond the
      training data, {inside} mV on the part of it that does not. Published recurrent networks have {net_multisine},
      {net_arrow} and {net_inside} mV.
    - The input between its samples matters: {linear} mV on the test multisine where it is taken to run in lines, in
      place of a cubic spline.
    """
    table = e.study("silverbox.md", "Free simulation of the test parts")
    parts = {"multisine": "test multisine", "arrow": "arrow", "inside": "arrow, no extrapolation"}
    nets = table[table.model.isin(("GRU", "LSTM", "OLSTM", "RNN"))]
    ours = table.model.str.startswith("shooting") & table.model.str.endswith("cubic input")
    lines = table.model.str.startswith("shooting") & table.model.str.endswith("linear input")
    found = {key: float(table[ours][name].iloc[0]) for key, name in parts.items()}
    others = {f"net_{key}": nets[name].astype(float) for key, name in parts.items()}
    linear = float(table[lines]["test multisine"].iloc[0])
    return said(
        {
            "it is below every recurrent network": all(found[key] < others[f"net_{key}"].min() for key in parts),
            "lines are worse than a cubic spline": linear > found["multisine"],
        },
        linear=number(linear, 3),
        **{key: number(value, 3) for key, value in found.items()},
        **{key: span(values, number) for key, values in others.items()},
    )


ENGINE = (engine_time, engine_steps, engine_initialisation, engine_reach)
REACH = (by_hand, chains)
MEASURED = (silverbox,)
CLAIMS = (*ENGINE, *REACH, *MEASURED)
