"""The benchmark from Python: the same cells and messages as on the command line, without output."""

from __future__ import annotations

import doctest
import json
import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY

import bench
from bench.commands.main import main
from bench.config.experiment import Experiment
from bench.store.store import Store

TIMES = np.linspace(0.0, 8.0, 60)
DECAY = np.exp(-0.25 * TIMES) * np.cos(3.0 * TIMES) + 0.01 * np.random.default_rng(5).standard_normal(60)


@pytest.mark.usefixtures("any_bound")
@pytest.mark.parametrize("module", ["results", "identification"])
def test_the_examples_of_the_documentation_run(module: str) -> None:
    result = doctest.testmod(import_module(f"bench.face.{module}"), optionflags=doctest.ELLIPSIS)
    assert result.attempted > 3
    assert result.failed == 0


def test_python_and_the_command_line_share_stored_cells(store: Store, capfd: pytest.CaptureFixture[str]) -> None:
    results = bench.run(method="oracle", snr=20, replicates=2, workers=1, store=store.folder)
    assert capfd.readouterr() == ("", "")
    (path,) = store.folder.glob("*.json")
    before = path.stat().st_mtime_ns
    assert main(["method=oracle", "snr=20.0", "replicates=2", "workers=1", f"store={store.folder}", "format=json"]) == 0
    assert path.stat().st_mtime_ns == before
    assert json.loads(capfd.readouterr().out) == results[0].as_dict()
    frame = results.frame()
    assert set(frame.cell) == {path.stem}
    assert frame.metric.is_unique
    median = frame.set_index("metric").loc["rmse", "median"]
    assert median == results[0].stored.summary["rmse"]["median"]
    assert f"{median:.3g}" in results._repr_html_()


def test_experiments_are_lists_of_cells_that_can_be_overridden() -> None:
    cells = bench.experiment("table5", method=["ls", "rls"], snr=[15], replicates=3)
    assert {(c.method, c.scenario.snr_db, c.replicates) for c in cells} == {("ls", 15.0, 3), ("rls", 15.0, 3)}
    assert [c.identity for c in bench.experiment("table3")] == [c.identity for c in Experiment("table3").cells()]


LINES: dict[str, dict[str, Any]] = {
    "method=pin": {"method": "pin"},
    "method=ls system=beam": {"method": "ls", "system": "beam"},
    "method=ls method.depth=3": {"method": "ls", "settings": {"method.depth": 3}},
    "method=ls disturbance=jitter disturbance.size=0": {
        "method": "ls", "disturbance": "jitter", "settings": {"disturbance": {"size": 0}},
    },
    "snr=20": {"snr": 20},
}  # fmt: skip


@pytest.mark.parametrize("line", LINES)
def test_bad_input_has_the_message_of_the_command_line(
    line: str, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*line.split(), f"store={store.folder}"]) == 2
    with pytest.raises(bench.InputError) as caught:
        bench.run(**LINES[line], store=store.folder)
    assert capsys.readouterr().err == f"bench: {caught.value}\n"


def test_a_record_is_identified_from_a_file_as_from_arrays(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "record.csv"
    np.savetxt(path, np.column_stack([TIMES + 5.0, 1e3 * DECAY]), delimiter=",", header="t [s],x [mm]", comments="")
    arrays, file = bench.identify(TIMES, DECAY, method="shooting"), bench.identify(path, method="shooting")
    assert capfd.readouterr() == ("", "")
    assert file.values == pytest.approx(arrays.values, rel=1e-6)
    low, high = arrays.intervals["k_over_m"]
    assert low < 9.0 + 0.25**2 < high  # x'' + 2·0.25 x' + (3² + 0.25²) x = 0
    assert arrays.residuals.rms == pytest.approx(0.01, rel=0.4)
    assert arrays.residuals.values.shape == (60,)
    assert "k/m" in repr(arrays)
    assert "<table" in arrays._repr_html_()
    json.dumps(arrays.as_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"data": TIMES}, "displacement=None: give displacements with times"),
        ({"data": "r.csv", "displacement": DECAY}, "displacement=array: give either a file, or times"),
        ({"data": TIMES, "displacement": DECAY[1:]}, r"displacement=array of shape \(59,\): use a vector"),
        ({"data": TIMES, "displacement": ["a"] * 60}, "displacement=array: numbers"),
        ({"data": TIMES, "displacement": np.where(TIMES[7] == TIMES, np.nan, DECAY)}, "array: sample 7 is not finite"),
        ({"data": TIMES, "displacement": DECAY, "columns": ["t", "x"]}, "a mapping, such as {'t': 0"),
        (
            {"data": TIMES, "displacement": DECAY, "settings": {"force_gain": 0}},
            "force_gain=0.0: the record has no force",
        ),
        ({"data": TIMES[::-1], "displacement": DECAY}, "time decreases from"),
        ({"data": TIMES, "displacement": DECAY, "settings": {"disturbance": "bias"}}, "=bias: .*omit it"),
    ],
)
def test_a_malformed_record_is_one_line(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(bench.InputError, match=sentence):
        bench.identify(given.pop("data"), method="ls", **given)


SCRIPT = """
import threading, bench
results = []
def work():
    results.append(bench.run(method="prior", replicates=2, workers=1, store={store!r}))
work = threading.Thread(target=work)
work.start()
work.join()
print(results[0][0].stored.n_ok, "once")
"""


def test_a_thread_of_a_script_without_a_guard_can_run_a_sweep(store: Store, tmp_path: Path) -> None:
    """The script is read from standard input, as the cells of a notebook are: child processes do not run it again."""
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    options = {"input": SCRIPT.format(store=str(store.folder)), "capture_output": True, "text": True, "timeout": 300}
    done = subprocess.run([sys.executable, "-"], cwd=tmp_path, env=environment, **options)
    assert (done.returncode, done.stdout, done.stderr) == (0, "2 once\n", "")


def test_importing_bench_loads_no_heavy_module(python: Callable[..., Any]) -> None:
    later = {"hydra", "pydantic", "pandas", "bench.face", "bench.engine"}
    handled = "signal.getsignal(signal.SIGINT) is signal.default_int_handler"  # bench does not handle Ctrl-C
    code = f"import signal, sys, bench; print(sorted({later!r} & set(sys.modules)), {handled})"
    assert python("-c", code, env={"PYTHONPATH": str(REPOSITORY)}).stdout == "[] True\n"
    with pytest.raises(AttributeError, match="no attribute fit"):
        _ = bench.fit
