"""The command line: one line and exit status 2 for bad input, JSON for machines, nothing computed twice."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from bench.commands.main import main
from bench.engine import runner
from bench.store.store import Store

HEAVY = ("torch", "casadi", "pysindy", "emcee", "jax", "matplotlib")


def snapshot(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Return every file below a folder with its modification time and content."""
    return {
        str(p): (p.stat().st_mtime_ns, p.read_bytes())
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.parent.name != "view"
    }


def no_constants(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")


def test_json_is_one_object_with_the_documented_keys(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["method=oracle", "snr=20", "replicates=2", "workers=1", "format=json", f"store={store.folder}"]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) == 1
    result = json.loads(out, parse_constant=no_constants)
    keys = {"method", "system", "snr", "replicates", "seed", "n_ok", "status", "wall_s", "metrics"}
    assert keys <= set(result)
    fields = ("method", "system", "snr", "replicates", "seed", "n_ok", "status")
    assert [result[key] for key in fields] == ["oracle", "sdof", 20.0, 2, 0, 2, "ok"]
    for name in ("m_error_pct", "k_over_m_error_pct", "c_over_m_error_pct", "rmse", "rmse_simulated", "rmse_forecast"):
        metric = result["metrics"][name]
        assert set(metric) == {"mean", "median", "ci_low", "ci_high", "bound", "excess"}
        assert metric["ci_low"] <= metric["median"] <= metric["ci_high"]
    assert result["metrics"]["rmse"]["bound"] == pytest.approx(0.0107, abs=5e-5)
    assert main(["method=oracle", "snr=20", "replicates=2", "workers=1", f"store={store.folder}"]) == 0
    out = capsys.readouterr().out
    identifiable, prior_decides = out.split("Not identifiable from these data")
    assert [line[0] for line in prior_decides.splitlines() if line[1:4] == " % "] == ["m", "c", "k"]
    assert "\nk/m % " in identifiable
    assert "2/2 ok" in out


def test_json_of_a_failed_cell_has_nulls_and_a_message(
    store: Store, capsys: pytest.CaptureFixture[str], any_bound: None
) -> None:
    arguments = ["method=prior", "prior=none", "replicates=2", "workers=1", "format=json", f"store={store.folder}"]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out, parse_constant=no_constants)
    assert (result["n_ok"], result["status"]) == (0, "unsupported")
    assert "no prior" in result["message"]
    assert result["metrics"]["rmse"]["median"] is None


def test_a_finished_cell_is_read_from_the_store(
    store: Store, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The notation of a number, the number of workers and the format do not matter."""
    arguments = ["method=prior", "replicates=3", "format=json", f"store={store.folder}"]
    assert main([*arguments, "snr=20", "workers=1"]) == 0
    first = capsys.readouterr().out
    before = snapshot(store.folder)

    def never(*arguments: Any, **options: Any) -> Any:
        raise AssertionError("computed again")

    for name in ("Children", "make_bounds"):
        monkeypatch.setattr(runner, name, never)
    assert main([*arguments, "snr=20.0", "workers=2"]) == 0
    assert capsys.readouterr().out == first
    assert snapshot(store.folder) == before


def test_cfg_prints_the_configuration_and_runs_nothing(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    before = snapshot(store.folder)
    for option in (["--cfg", "job"], ["--cfg=job"], ["--cfg"], ["-c", "job"]):
        assert main(["method=oracle", "snr=7", *option, f"store={store.folder}"]) == 0
        assert yaml.safe_load(capsys.readouterr().out)["snr"] == 7.0
    assert snapshot(store.folder) == before


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


def test_workers_and_limits_reach_the_run_and_are_stored_with_it(store: Store) -> None:
    limits = ["workers=3", "timeout_s=50", "memory_mb=1500"]
    assert main(["method=prior", "replicates=2", *limits, f"store={store.folder}"]) == 0
    (path,) = store.folder.glob("*.json")
    provenance = json.loads(path.read_text().splitlines()[0])["provenance"]
    assert (provenance["workers"], provenance["limits"]) == (3, {"timeout_s": 50.0, "memory_mb": 1500.0})
