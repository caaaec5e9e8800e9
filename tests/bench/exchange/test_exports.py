"""Exports say what was exported: equations, data and priors as PEtab, draws as ArviZ, a cell as a notebook."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from conftest import StoreFactory
from scipy.integrate import solve_ivp
from stored import described, save, scored

from bench import Problem
from bench.commands.main import main
from bench.config.experiment import expand
from bench.exchange.petab import petab_files, rates
from bench.store.store import Store
from bench.systems import make_system

MATHS = {name: getattr(math, name) for name in ("tanh", "sin", "cos", "exp", "sqrt")}
MATHS |= {"abs": abs, "piecewise": lambda a, when, b: a if when else b}


def evaluated(text: str, values: Mapping[str, float]) -> float:
    """A formula of SBML, read by Python."""
    return float(eval(text.replace("^", "**"), {"__builtins__": {}}, {**MATHS, **values}))


def by_hand(system: str, q: Mapping[str, float]) -> dict[str, float]:
    """The accelerations of free vibration, solved for by hand."""
    if system == "sdof":
        return {"v1": -(q["c"] * q["v1"] + q["k"] * q["x1"]) / q["m"]}
    if system == "duffing":
        return {"v1": -(q["c"] * q["v1"] + q["k"] * q["x1"] + q["k3"] * q["x1"] ** 3) / q["m"]}
    pull = q["c2"] * (q["v2"] - q["v1"]) + q["k2"] * (q["x2"] - q["x1"])
    return {"v1": (pull - q["c1"] * q["v1"] - q["k1"] * q["x1"]) / q["m1"], "v2": -pull / q["m2"]}


@pytest.mark.parametrize("name", ["sdof", "duffing", "chain"])
def test_the_formulas_are_the_equation_of_motion(name: str) -> None:
    system = make_system(name, {"n": 2} if name == "chain" else {})
    found = rates(system)
    rng = np.random.default_rng(3)
    for _ in range(5):
        values = {one: float(rng.uniform(0.5, 2.0)) for one in [*system.names, *found]}
        for state, expected in by_hand(name, values).items():
            assert evaluated(found[state], values) == pytest.approx(expected, rel=1e-12)
            assert evaluated(found[state.replace("v", "x")], values) == values[state]


def exported(*words: str, replicate: int = 0) -> tuple[dict[str, str], Problem]:
    job = expand(["method=oracle", *words], multirun=False)[0]
    scenario = job.cell().scenario
    return petab_files(scenario, job.config.seed, replicate), scenario.maker(job.config.seed)(replicate)[0]


def table(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines(), delimiter="\t"))


def test_the_tables_hold_the_samples_and_the_prior_and_not_the_truth() -> None:
    pytest.importorskip("libsbml")
    files, problem = exported("system=chain2", "snr=20", replicate=3)
    samples = [(float(line["time"]), float(line["measurement"])) for line in table(files["measurements.tsv"])]
    channels = problem.records[0].channels
    assert samples == [pair for channel in channels for pair in zip(channel.times, channel.values, strict=True)]
    prior = problem.prior
    assert prior is not None
    lines = {line["parameterId"]: line for line in table(files["parameters.tsv"])}
    for name in problem.system.names:
        mean, sd = map(float, lines[name]["objectivePriorParameters"].split(";"))
        assert (mean, sd) == (pytest.approx(math.log(prior.nominal[name])), prior.log_sd[name])
        assert lines[name]["estimate"] == "1"
    truths = {line["parameterId"]: float(line["value"]) for line in table(files["truth.tsv"])}
    assert all(float(lines[name]["nominalValue"]) != truths[name] for name in problem.system.names)


@pytest.mark.parametrize("told", ["known", "unknown"])
def test_the_start_is_estimated_where_it_is_not_told(told: str) -> None:
    pytest.importorskip("libsbml")
    files, _ = exported("system=sdof", f"initial_state={told}", "prior=none")
    lines = {line["parameterId"]: line for line in table(files["parameters.tsv"])}
    expected = {"known": ("0", 1.0), "unknown": ("1", 0.0)}[told]
    assert (lines["x1_start"]["estimate"], float(lines["x1_start"]["nominalValue"])) == expected
    assert "objectivePriorType" not in lines["m"]


@pytest.mark.parametrize("system", ["sdof", "duffing", "chain2", "bouc_wen"])
def test_the_model_with_the_truth_moves_as_the_record_without_noise(system: str) -> None:
    """The SBML is read by libsbml and integrated by scipy: no code of the export has a part in it."""
    libsbml = pytest.importorskip("libsbml")
    files, _ = exported(f"system={system}", "snr=200")
    model = libsbml.readSBMLFromString(files["model.xml"]).getModel()
    values = {line["parameterId"]: float(line["value"]) for line in table(files["truth.tsv"])}
    rules = {}
    for i in range(model.getNumRules()):
        rules[model.getRule(i).getVariable()] = libsbml.formulaToL3String(model.getRule(i).getMath())
    starts = {}
    for i in range(model.getNumInitialAssignments()):
        one = model.getInitialAssignment(i)
        starts[one.getSymbol()] = values.get(libsbml.formulaToL3String(one.getMath()), 0.0)
    lines = [line for line in table(files["measurements.tsv"]) if line["observableId"] == "displacement1"]
    times = np.array([float(line["time"]) for line in lines])

    def rate(t: float, state: np.ndarray) -> list[float]:
        at = {**values, **dict(zip(starts, state, strict=True))}
        return [evaluated(rules[name], at) for name in starts]

    path = solve_ivp(rate, (0.0, times[-1]), list(starts.values()), "LSODA", times, rtol=1e-9, atol=1e-11)
    measured = [float(line["measurement"]) for line in lines]
    np.testing.assert_allclose(path.y[list(starts).index("x1")], measured, atol=2e-6)


def with_draws(folder: Path) -> tuple[Store, np.ndarray]:
    """A stored cell that keeps 40 draws of m, c and k."""
    store = Store(folder)
    store.prepare()
    draws = np.exp(0.1 * np.random.default_rng(0).standard_normal((40, 3))).astype("f4").astype(float)
    arrays = {"draws": draws, "sample_times": np.linspace(0, 1, 5), "sample_values": np.arange(5.0),
              "sample_dof": np.zeros(5, int)}  # fmt: skip
    save(store, described("mcmc", n=3), scored("mcmc", 3), arrays)
    save(store, described("ls", n=3), scored("ls", 3))
    return store, draws


def test_draws_come_back_from_a_file_that_arviz_reads(tmp_path: Path) -> None:
    arviz = pytest.importorskip("arviz")
    store, draws = with_draws(tmp_path / "rows")
    stored = next(one for one in store if one.cell["label"] == "mcmc")
    path = tmp_path / "own.nc"
    words = [f"cell={stored.identity[:8]}", f"store={store.folder}", "archive=none", f"out={path}"]
    assert main(["share", "action=export", "form=arviz", *words]) == 0
    found = arviz.from_netcdf(path)
    assert list(found.posterior.data_vars) == ["m", "c", "k"]
    for i, name in enumerate("mck"):
        np.testing.assert_array_equal(found.posterior[name].values, draws[None, :, i])
    assert found.observed_data["displacement"].values.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert (found.attrs["method"], found.attrs["cell"]) == ("mcmc", stored.identity)
    summary = arviz.summary(found, kind="stats", round_to="none")
    assert summary["mean"]["k"] == pytest.approx(float(np.mean(draws[:, 2])))


def test_a_cell_without_draws_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store, _ = with_draws(tmp_path / "rows")
    stored = next(one for one in store if one.cell["label"] == "ls")
    words = [f"cell={stored.identity}", f"store={store.folder}", "archive=none"]
    assert main(["share", "action=export", "form=arviz", *words]) == 2
    error = capsys.readouterr().err
    assert "ls states no draws" in error
    assert error.count("\n") == 1


def test_a_notebook_runs_and_computes_the_cell(
    new_store: StoreFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nbformat = pytest.importorskip("nbformat")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    path, store = tmp_path / "own.ipynb", new_store()
    words = ["method=ls", "snr=20", "replicates=2", "method.derivative=spline", f"store={store.folder}", "workers=1"]
    assert main(["share", "action=export", "form=notebook", *words, f"out={path}"]) == 0
    found = nbformat.read(path, as_version=4)
    nbformat.validate(found)
    names: dict[str, object] = {}
    for cell in found.cells:
        if cell.cell_type == "code":
            exec(cell.source, names)
    (identity,) = store.identities()
    stored = store.load(identity)
    assert stored is not None
    assert stored.cell["settings"]["derivative"] == "spline"
    assert (stored.cell["replicates"], stored.cell["snr_db"]) == (2, 20.0)
    assert len(names["axes"].lines) >= 2  # type: ignore[attr-defined]
