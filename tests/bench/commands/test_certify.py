"""``python -m bench certify``: the files that it writes, its exit status, and signals."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from bench.commands.main import main
from bench.records import certificate


@pytest.fixture(scope="module", autouse=True)
def no_classes() -> Iterator[None]:
    """Leave out the comparison of model classes, which takes a minute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(certificate, "_comparison", lambda measured, workers, missing: missing.update(classes="left out"))
        yield


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a free vibration of 120 samples with noise of 1 %."""
    t = np.arange(120) / 20.0
    x = np.exp(-0.2 * t) * np.cos(6.0 * t) + 0.01 * np.random.default_rng(3).standard_normal(t.size)
    path = tmp_path_factory.mktemp("record") / "decay.csv"
    np.savetxt(path, np.column_stack([t, x]), delimiter=",", header="t (s),x (m)", comments="")
    return path


@pytest.fixture(scope="module")
def written(record: Path) -> Path:
    """Return the folder of its certificate."""
    out = record.parent / "certificate"
    fields = [f"data={record}", f"out={out}", "system=sdof", "method=output_error,ls", "twins=0"]
    assert main(["certify", *fields]) == 0
    return out


def test_the_file_holds_the_result_and_its_origin(written: Path, record: Path) -> None:
    content = json.loads((written / "certificate.json").read_text(encoding="utf-8"))
    assert sorted(path.name for path in written.iterdir()) == ["certificate.html", "certificate.json"]
    assert content["method"] == "output_error"
    assert content["verdict"] in ("trust", "use with caution")
    k_over_m, truth = content["values"]["k_over_m"], 36.0 + 0.2**2
    assert k_over_m["low"] <= k_over_m["record_low"] < truth < k_over_m["record_high"] <= k_over_m["high"]
    assert re.fullmatch(r"natural frequency = 0.9\d+ ± 0.0\d+ Hz, damping ratio = \d.\d+ [^=]* %", content["answer"])
    assert [row["method"] for row in content["methods"]] == ["output_error", "ls"]
    assert content["record"]["hashes"][0][0] == record.name
    assert len(content["record"]["hashes"][0][1]) == 64
    assert content["command"].startswith("python -m bench certify data=")
    assert "twins=0" in content["missing"]["replicas"]


def test_pure_noise_is_not_to_be_trusted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(100) / 20.0
    x = np.random.default_rng(5).standard_normal(t.size)
    path = tmp_path / "noise.csv"
    np.savetxt(path, np.column_stack([t, x]), delimiter=",", header="t (s),x (m)", comments="")
    out = tmp_path / "out"
    assert main(["certify", f"data={path}", f"out={out}", "system=sdof", "method=output_error"]) == 1
    content = json.loads((out / "certificate.json").read_text(encoding="utf-8"))
    printed = " ".join(capsys.readouterr().out.split())
    assert content["reasons"]
    assert all(f"- {reason}" in printed for reason in content["reasons"])
    assert content["verdict"] == "do not trust"
    assert content["values"] == {}
    assert content["reasons"]
    assert "data:image/svg" in (out / "certificate.html").read_text(encoding="utf-8")


def test_a_method_without_an_estimate_gets_a_page_with_the_record(record: Path, tmp_path: Path) -> None:
    fields = [f"data={record}", f"out={tmp_path}", "system=sdof+quadratic", "method=matrix_pencil", "twins=0"]
    assert main(["certify", *fields]) == 1
    page = (tmp_path / "certificate.html").read_text(encoding="utf-8")
    assert "Do not trust" in page
    assert page.count("data:image/svg") == 1


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_command_and_all_its_processes(record: Path, tmp_path: Path, number: signal.Signals) -> None:
    """The signal is sent while replicas are computed, whose time is reported before."""
    fields = [f"data={record}", f"out={tmp_path}", "system=sdof", "method=output_error", "twins=100000"]
    line = [sys.executable, "-m", "bench", "certify", *fields]
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        message = next(text for text in process.stderr if "simulated replicas" in text)
        children = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(number)
        assert process.wait(30.0) == 128 + number
        assert "interrupted" in process.stderr.read()
    assert re.search(r"100000 simulated replicas: about \d+ s more", message)
    assert children
    assert psutil.wait_procs(children, timeout=10.0)[1] == []
    assert list(tmp_path.iterdir()) == []
