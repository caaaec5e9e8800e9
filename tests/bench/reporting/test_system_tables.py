"""Tables by system: what is pooled, and that the text says what the numbers say."""

import math

import numpy as np
import pytest

from bench.config.experiment import expand
from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Result
from bench.reporting.tables.pooling import (
    identified,
    modal_scores,
    pooled_coverage,
    pooled_errors,
    pooled_excess,
    pooled_quantities,
)
from bench.reporting.tables.systems import describe, lines, system_table
from bench.scoring.row import Row
from bench.store.stored import StoredCell


def _cell(*overrides, method="shooting"):
    return expand([f"method={method}", *overrides], multirun=False)[0].cell()


def _result(errors, bounds, failed=0, coverage=None, cell=None):
    """A result whose replicate i has the errors ``errors[name][i]`` (%), under the given bounds."""
    n = len(next(iter(errors.values())))
    rows = []
    for i in range(n):
        scores = {f"{name}_error_pct": own[i] for name, own in errors.items()}
        scores |= {f"{name}_ratio": 1 + own[i] / 100 for name, own in errors.items()}
        scores |= {f"{name}_coverage_95": own[i] for name, own in (coverage or {}).items()}
        rows.append(Row(i, Status.OK, scores={**scores, "rmse": 0.01}))
    rows += [Row(n + i, Status.DIVERGED, "lost") for i in range(failed)]
    summary = {
        f"{name}_error_pct": {
            "mean": 0.0, "median": float(np.median(errors.get(name, [0.0]))), "ci_low": 0.0, "ci_high": 0.0,
            "bound": bound, "excess": 1.0,
        }
        for name, bound in bounds.items()
    }  # fmt: skip
    summary["rmse"] = {"mean": 0.01, "median": 0.01, "ci_low": 0.01, "ci_high": 0.01, "bound": 0.01, "excess": 1.0}
    stored = StoredCell("", {}, tuple(rows), summary, {}, dict.fromkeys(bounds, True), 0.0)
    return Result.of_cell(cell or _cell("system=sdof_forced"), stored)


def test_pooling_by_hand():
    """Errors (3, 4) % over bounds (1, 1) %: sqrt((9 + 16)/2) of a replicate; over two replicates the mean square."""
    result = _result({"m": [3.0, 0.0], "k": [4.0, 2.0]}, {"m": 1.0, "k": 1.0}, failed=1)
    errors = pooled_errors(result, ("m", "k"))
    assert errors[:2] == pytest.approx([math.sqrt(12.5), math.sqrt(2.0)])
    assert errors[2] == math.inf
    assert pooled_excess(result, ("m", "k")) == pytest.approx(math.sqrt((12.5 + 2.0) / 2))


def test_a_quantity_without_a_bound_is_not_pooled():
    result = _result({"m": [3.0], "k": [4.0]}, {"m": math.inf, "k": 2.0})
    assert pooled_errors(result, ("m", "k")) == pytest.approx([2.0])


def test_coverage_is_pooled_over_quantities_and_replicates():
    result = _result({"m": [1.0, 1.0]}, {"m": 1.0}, coverage={"m": [1.0, 0.0], "k": [1.0, 1.0]})
    share, low, high = pooled_coverage(result, ("m", "k"))
    assert share == 0.75
    assert low < 0.75 < high
    assert math.isnan(pooled_coverage(result, ("c",))[0])


def test_what_the_data_tell_is_pooled():
    """With a force every parameter; in free vibration the ratios to the mass."""
    forced, free = (_cell(f"system={name}").scenario.make_system() for name in ("sdof_forced", "duffing"))
    assert pooled_quantities(forced, dict.fromkeys(["m", "c", "k", "k_over_m", "c_over_m"], True)) == ("m", "c", "k")
    told = dict.fromkeys(["k_over_m", "c_over_m", "k3_over_m"], True)
    assert pooled_quantities(free, {**told, "m": False, "c": False, "k": False, "k3": False}) == tuple(told)


def test_parameters_from_ratios_and_from_groups():
    cell = _cell("system=chain2")
    system, true = cell.scenario.make_system(), cell.scenario.parameters
    ratios = {f"{name}_ratio": 2.0 for name in system.names}
    groups = {f"{g.name}_ratio": 1.0 for g in system.groups}
    rows = (Row(0, Status.OK, scores=ratios), Row(1, Status.OK, scores=groups), Row(2, Status.TIMEOUT, scores=ratios))
    found = identified(Result.of_cell(cell, StoredCell("", {}, rows, {}, {}, {}, 0.0)))
    assert {name: own[0] for name, own in found.items()} == {name: 2.0 * true[name] for name in system.names}
    assert found["m1"][1] == 1.0
    assert found["k2"][1] == pytest.approx(true["k2"] / true["m1"])
    assert all(math.isnan(own[2]) for own in found.values())


def test_modes_of_the_true_parameters_agree_with_themselves():
    """Every parameter 21 % high: same modes. Springs alone 21 % high: frequencies 10 % high, the undamped law."""
    chain = _cell("system=chain2")
    names = chain.scenario.make_system().names
    bounds, springs = dict.fromkeys(names, 1.0), {n: [21.0 if n.startswith("k") else 0.0] for n in names}
    scaled, stiffer = (
        _result({name: [21.0] for name in names}, bounds, cell=chain),
        _result(springs, bounds, cell=chain),
    )
    assert modal_scores(scaled)["frequencies_error_pct"] == pytest.approx([0.0], abs=1e-9)
    assert modal_scores(scaled)["least_mac"] == pytest.approx([1.0])
    assert modal_scores(stiffer)["frequencies_error_pct"] == pytest.approx([10.0], rel=0.01)
    assert not modal_scores(_result({"m": [21.0]}, bounds, cell=_cell("system=duffing")))


def test_the_record_is_described_in_numbers():
    """Reference system: 0.45 Hz, so 4.5 periods in 10 s and 1/(0.45 * 10/24) = 5.3 samples in each."""
    text = describe(_cell("system=sdof").scenario)
    assert "25 samples over 10 s" in text
    assert "4.5 periods of the slowest mode, 5.33 samples" in text
    assert "0.5 kg added" in describe(_cell("system=sdof_added_mass").scenario)
    assert "no prior" in describe(_cell("system=sdof_forced").scenario)


def test_a_table_of_missing_failed_and_good_cells():
    names = ["m", "c", "k", "k_over_m", "c_over_m"]
    good = _result(
        {n: [1.0, 2.0, 1.5] for n in names}, dict.fromkeys(names, 1.0), coverage={n: [1.0, 1.0, 0.0] for n in names}
    )
    nines = {n: [9.0, 9.0, 9.0] for n in names}
    pinn = _cell("system=sdof_forced", method="pinn")
    bad = _result(nines, dict.fromkeys(names, 1.0), failed=2, cell=pinn)
    found = [
        good,
        bad,
        Result.of_cell(_cell("system=sdof_forced", method="ls"), None),
        Result.of_cell(_cell("system=sdof_forced", "snr=10", method="rls"), None),
    ]
    text = system_table(Frame("forced", "T", {"number": 6}, tuple(found)))["table6.md"]
    assert "3/5" in text
    assert "2 × PINN: diverged, lost" in text
    assert "2 cells were not run" in text
    panel = text.partition("Errors at")[0]
    rows = {line.split("|")[1].strip(): line for line in panel.splitlines() if line.startswith("| ")}
    assert "**×1.55**" in rows["Multiple shooting"]  # sqrt((1 + 4 + 2.25) / 3)
    assert [cell.strip() for cell in rows["LS, finite differences"].split("|")[2:6]] == ["not run", "", "", "-"]
    assert [cell.strip() for cell in rows["RLS"].split("|")[2:6]] == ["-", "", "", "not run"]
    tidy = {(line["method"], line["metric"]): line for line in lines("6", found)}
    assert tidy["pinn", "told_pooled"]["excess"] == pytest.approx(9.0)
