"""The tutorial's example of a new system, taken from its page to the letter, in a folder of its own."""

from __future__ import annotations

import json
import os
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench import systems
from bench.commands.main import main
from bench.config.experiment import expand
from bench.scenario.scenario import Scenario
from bench.store.version import cell_version
from bench.systems import load_system, make_system

PAGE = Path(__file__).parents[3] / "docs" / "gallery" / "add_system.md"
FILES = ("gap_spring.py", "pyproject.toml", "gap.yaml")
METHODS = ("ekf", *(pytest.param(name, marks=pytest.mark.slow) for name in ("shooting", "collocation")))
"""Some of those that take any smooth system."""


def block(name: str) -> str:
    """The page's block of that title."""
    found = re.search(rf"```\w+ title=\"{re.escape(name)}\"\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert found, name
    return found.group(1)


RUN = ("system=gap.yaml", "replicates=1", "workers=1", "format=json", "store=rows")


@pytest.fixture(scope="module")
def bounds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the bound of the newcomer's scenario is kept by the first test that needs it."""
    return tmp_path_factory.mktemp("bounds")


@pytest.fixture
def folder(tmp_path: Path, bounds: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The newcomer's folder as the current one, its system registered as ``pip install`` of its pyproject.toml would.

    The folder stands on the path and holds what an installer writes of a package: its name and its entry points. So
    the processes that fit and score, which are started anew, find it, too.
    """
    for name in FILES:
        (tmp_path / name).write_text(block(name), encoding="utf-8")
    (tmp_path / "rows").mkdir()
    (tmp_path / "rows" / "bounds").symlink_to(bounds)
    project = tomllib.loads(block("pyproject.toml"))["project"]
    ((group, points),) = project["entry-points"].items()
    info = tmp_path / "gap_spring-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[{group}]\n{lines}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    known = systems.registered_systems() | {n: EntryPoint(n, value, group) for n, value in points.items()}
    monkeypatch.setattr(systems, "registered_systems", lambda: known)
    for function in (load_system, cell_version):
        function.cache_clear()
    yield tmp_path
    for function in (load_system, cell_version):
        function.cache_clear()
    sys.modules.pop("gap_spring", None)


def scenario() -> Scenario:
    return expand(["method=prior", "system=gap.yaml"], multirun=False)[0].scenario


def test_it_is_at_most_thirty_lines(folder: Path) -> None:
    assert sum(len((folder / name).read_text(encoding="utf-8").splitlines()) for name in FILES) <= 30


def test_it_keeps_the_contract(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The copied code passes the checks of any system."""
    assert main(["check", f"package={folder}"]) == 0, capsys.readouterr().out


def test_its_file_is_a_scenario_that_starts_from_ours(folder: Path) -> None:
    """What the file says holds, and what it does not say is as in conf/system/sdof.yaml."""
    found = scenario()
    assert (found.label, found.samples, found.duration) == ("gap", 40, 10.0)
    assert found.initial == ((1.0,), (0.0,))
    assert found.parameters == {"m": 1.0, "c": 0.2, "k": 8.0, "k2": 30.0, "d": 0.4}


def test_its_data_are_those_of_its_equation(folder: Path) -> None:
    """The record without noise, against the equation of motion written out again for scipy.

    Far inside the gap the second spring does nothing, far outside it pulls by k2 (|x| - d): ``tanh`` is x/d, or 1.
    """
    truth = scenario().replicates(0, 1)[0][1]
    m, c, k, k2, d = (truth.parameters[name] for name in ("m", "c", "k", "k2", "d"))

    def rates(t: float, s: np.ndarray) -> list[float]:
        return [s[1], -(c * s[1] + k * s[0] + k2 * (s[0] - d * np.tanh(s[0] / d))) / m]

    path = solve_ivp(rates, (0.0, 10.0), [1.0, 0.0], "DOP853", truth.dense_times, rtol=1e-11, atol=1e-12).y[0]
    assert np.allclose(truth.dense_displacement[0], path, atol=1e-7)
    ops = type("ops", (), {"tanh": np.tanh})
    for x, force in ((0.004, k * 0.004), (4.0, k * 4.0 + k2 * 3.6)):
        (residual,) = make_system("gap", {}).residual(truth.parameters, [x], [0.0], [0.0], [0.0], [], ops)
        assert residual == pytest.approx(force, rel=2e-4)


@pytest.mark.parametrize("method", METHODS)
def test_methods_run_on_it(method: str, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The page's command; the fit is within five times the Cramér-Rao bound of the displacement."""
    for package in {"shooting": ["casadi"], "collocation": ["torch"]}.get(method, []):
        pytest.importorskip(package)
    assert main([f"method={method}", *RUN]) == 0
    said = json.loads(capfd.readouterr().out.strip().splitlines()[-1])
    assert (said["system"], said["status"]) == ("gap", "ok"), said
    assert said["metrics"]["rmse"]["excess"] < 5.0


def test_two_files_can_be_swept_over(tmp_path: Path) -> None:
    for n in (30, 50):
        (tmp_path / f"s{n}.yaml").write_text(f"defaults: [sdof]\nlabel: s{n}\nsamples: {n}\n", encoding="utf-8")
    files = ",".join(str(tmp_path / f"s{n}.yaml") for n in (30, 50))
    cells = [job.cell() for job in expand(["method=ls", f"system={files}", "system.duration=5"], multirun=True)]
    assert [(c.scenario.label, c.scenario.samples, c.scenario.duration) for c in cells] == [
        ("s30", 30, 5),
        ("s50", 50, 5),
    ]
