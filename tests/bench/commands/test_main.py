"""The command line: one line and exit status 2 for bad input, JSON for machines, nothing computed twice."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from bench.commands.main import main
from bench.engine import runner
from bench.store.store import Store

HEAVY = ("torch", "casadi", "pysindy", "emcee", "jax", "matplotlib")


@pytest.fixture
def store(tmp_path: Path, bounds_folder: Path) -> Path:
    folder = tmp_path / "rows"
    folder.mkdir()
    shutil.copytree(bounds_folder, folder / "bounds")
    return folder


def snapshot(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file below a folder with its time of change and content."""
    return {
        str(p): (p.stat().st_mtime_ns, p.read_bytes())
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.parent.name != "view"
    }


def test_a_bad_cell_late_in_a_sweep_stops_it_before_the_first_runs(
    store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = snapshot(store)
    assert main(["-m", "method=prior", "replicates=2", "snr=20,500", f"store={store}"]) == 2
    assert capsys.readouterr().err.startswith("bench: snr=500: ")
    assert snapshot(store) == before


def test_a_damaged_cell_is_one_line_and_stays(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["method=prior", "replicates=2", "workers=1", f"store={store}"]) == 0
    (path,) = store.glob("*.json")
    path.write_bytes(path.read_bytes()[:100])
    before = snapshot(store)
    capsys.readouterr()
    assert main(["method=prior", "replicates=2", "workers=1", f"store={store}"]) == 2
    err = capsys.readouterr().err
    assert [line for line in err.splitlines() if line.startswith("bench:")] == [
        f"bench: store={path}: not a whole cell of this benchmark (its checksum is not that of its content); "
        "retry=failed computes it again, or move it away"
    ]
    assert snapshot(store) == before


def no_constants(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")


def test_json_is_one_object_with_the_documented_keys(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["method=oracle", "snr=20", "replicates=2", "workers=1", "format=json", f"store={store}"]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) == 1
    result = json.loads(out, parse_constant=no_constants)
    keys = {"method", "system", "snr", "replicates", "seed", "n_ok", "status", "wall_s", "metrics"}
    assert keys <= set(result)
    stated = ("method", "system", "snr", "replicates", "seed", "n_ok", "status")
    assert [result[key] for key in stated] == ["oracle", "sdof", 20.0, 2, 0, 2, "ok"]
    for name in ("m_error_pct", "k_over_m_error_pct", "c_over_m_error_pct", "rmse", "rmse_simulated", "rmse_forecast"):
        metric = result["metrics"][name]
        assert set(metric) == {"mean", "median", "ci_low", "ci_high", "bound", "excess"}
        assert metric["ci_low"] <= metric["median"] <= metric["ci_high"]
    assert result["metrics"]["rmse"]["bound"] == pytest.approx(0.0107, abs=5e-5)


def test_json_of_a_failed_cell_has_nulls_and_a_message(
    store: Path, capsys: pytest.CaptureFixture[str], any_bound: None
) -> None:
    arguments = ["method=prior", "prior=none", "replicates=2", "workers=1", "format=json", f"store={store}"]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out, parse_constant=no_constants)
    assert (result["n_ok"], result["status"]) == (0, "unsupported")
    assert "no prior" in result["message"]
    assert result["metrics"]["rmse"]["median"] is None


def test_a_finished_cell_is_answered_from_the_store(
    store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However the same number is written, and whatever only concerns how it is run or shown."""
    arguments = ["method=prior", "replicates=3", "format=json", f"store={store}"]
    assert main([*arguments, "snr=20", "workers=1"]) == 0
    first = capsys.readouterr().out
    before = snapshot(store)

    def never(*arguments: Any, **options: Any) -> Any:
        raise AssertionError("computed again")

    for name in ("Children", "make_bounds"):
        monkeypatch.setattr(runner, name, never)
    assert main([*arguments, "snr=20.0", "workers=2"]) == 0
    assert capsys.readouterr().out == first
    assert snapshot(store) == before


def test_a_sweep_runs_what_is_missing_and_prints_a_line_a_cell(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = ["replicates=2", "workers=1", f"store={store}"]
    assert main(["method=prior", *one]) == 0
    before = snapshot(store)
    capsys.readouterr()
    assert main(["-m", "method=prior,oracle", *one]) == 0
    out = capsys.readouterr().out
    after = snapshot(store)
    assert {name: after[name] for name in before} == before
    assert len(list(store.glob("*.json"))) == 2
    assert [line.split()[0] for line in out.splitlines() if "2/2" in line] == ["prior", "oracle"]


def test_the_table_of_one_cell_marks_what_the_prior_decides(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["method=oracle", "replicates=2", "workers=1", f"store={store}"]) == 0
    out = capsys.readouterr().out
    starred = [line.split(" error")[0] for line in out.splitlines() if " error % *" in line]
    assert starred == ["m", "c", "k"]
    assert "2/2 ok" in out
    assert str(next(store.glob("*.json"))) in out


def test_cfg_prints_the_configuration_and_runs_nothing(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = snapshot(store)
    for option in (["--cfg", "job"], ["--cfg=job"], ["--cfg"], ["-c", "job"]):
        assert main(["method=oracle", "snr=7", *option, f"store={store}"]) == 0
        assert yaml.safe_load(capsys.readouterr().out)["snr"] == 7.0
    assert snapshot(store) == before


def test_an_interrupt_is_one_line_and_status_130(
    store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "Children", interrupted)
    assert main(["method=prior", "replicates=2", f"store={store}"]) == 130
    assert "interrupted; finished cells are kept" in capsys.readouterr().err
    assert list(Store(store)) == []


def test_help_and_bad_input_load_no_heavy_package(python: Callable[..., Any]) -> None:
    script = (
        "import sys\n"
        "from bench.commands.main import main\n"
        "codes = [main(['--help']), main(['--version']), main(['method=pin']), main(['method=ls', 'snr=nan'])]\n"
        f"print(codes, sorted(set(sys.modules) & set({HEAVY!r})))\n"
    )
    done = python("-c", script)
    assert done.stdout.splitlines()[-1] == "[0, 0, 2, 2] []", done.stdout + done.stderr
    assert len(done.stderr.splitlines()) == 2


def test_nothing_at_all_is_usage_and_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert capsys.readouterr().out.startswith("usage:")


PLUGIN = """
from dataclasses import dataclass
import numpy as np
from bench import Card, Estimate, Identifier, Normal
@dataclass(frozen=True)
class Constant(Identifier):
    value: float = 8.0
    card = Card("constant", "not used", "groups", "simulated", "none", "none")
    def estimate(self, problem, rng):
        print("chatter that must not mix with the result", flush=True)
        groups = Normal(("k_over_m", "c_over_m"), np.array([self.value, 0.4]), 1e-4 * np.eye(2), log=False)
        return Estimate(problem.system, groups=groups)
"""


def test_an_installed_entry_point_alone_makes_a_method(tmp_path: Path, store: Path, python: Callable[..., Any]) -> None:
    """One good plug-in and one broken: the good one runs, the broken one is named, and harms nobody else."""
    site = tmp_path / "site"
    metadata = site / "plugin-1.0.dist-info"
    metadata.mkdir(parents=True)
    (site / "plugin_method.py").write_text(PLUGIN)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: plugin\nVersion: 1.0\n")
    points = "[bench.methods]\nconstant = plugin_method:Constant\nbroken = plugin_method:Nowhere\n"
    (metadata / "entry_points.txt").write_text(points)
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
    common = ["-m", "bench", "replicates=2", "workers=1", "format=json", f"store={store}"]
    done = python(*common, "method=constant", "method.value=8.8", env={"PYTHONPATH": path})
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["method"], result["n_ok"]) == ("constant value=8.8", 2)
    assert result["metrics"]["k_over_m_error_pct"]["median"] == pytest.approx(10.0, abs=0.1)
    done = python(*common, "method=broken", env={"PYTHONPATH": path})
    assert done.returncode == 2
    assert done.stderr.startswith("bench: method=broken: its entry point does not load")
    assert len(done.stderr.splitlines()) == 1


def test_workers_and_limits_reach_the_run_and_stand_in_its_provenance(store: Path) -> None:
    limits = ["workers=3", "timeout_s=50", "memory_mb=1500"]
    assert main(["method=prior", "replicates=2", *limits, f"store={store}"]) == 0
    (path,) = store.glob("*.json")
    come = json.loads(path.read_text().splitlines()[0])["provenance"]
    assert (come["workers"], come["limits"]) == (3, {"timeout_s": 50.0, "memory_mb": 1500.0})
