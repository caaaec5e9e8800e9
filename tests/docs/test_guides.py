"""Commands of the guides run as written, except those that need hours, a cluster or files of the reader."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import REPOSITORY
from pages import blocks, commands

GUIDES = sorted(
    path for part in ("how_to", "explanation", "reference") for path in (REPOSITORY / "docs" / part).glob("*.md")
)
LONG = (
    "experiment=", "hydra/launcher", "bench tables", "bench share", "bench round", "bench score", "bench track",
    "package=", "pinn_family", "reproduce", "blows.csv", "b1.csv", "frf.uff", "scope.xlsx", "times=optimal",
    "force=optimal", "<", "tests.studies", "verify=500",
)  # fmt: skip
"""Parts of commands that are not run here: they take long, need files or a network, or are run by other tests."""


def runnable() -> list[str]:
    """Return the commands of the guides that an empty folder with two records can run."""
    lines = {line for path in GUIDES for block in blocks(path) if block.language == "bash" for line in commands(block)}
    return sorted(line for line in lines if line.startswith("python -m bench") and not any(p in line for p in LONG))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with free decays of one mass and of two modes, and the published claims."""
    folder = tmp_path_factory.mktemp("guides")
    t, rng = np.arange(400) / 100, np.random.default_rng(1)
    for name in ("record.csv", "run1.csv", "run2.csv"):
        x = 5 * np.exp(-0.4 * t) * np.cos(2 * np.pi * 2.1 * t) + rng.normal(0, 0.05, t.size)
        np.savetxt(folder / name, np.column_stack([t, x]), "%.5f", ",", header="t [s],x [mm]", comments="")
    t = np.arange(2000) / 400
    x = [np.exp(-a * t) * np.cos(2 * np.pi * f * t) for a, f in ((0.6, 12.0), (1.5, 31.0))]
    y = np.array([x[0] + x[1], x[0] - 0.6 * x[1]]) + rng.normal(0, 0.005, (2, t.size))
    np.savetxt(folder / "run.csv", np.column_stack([1000 * t, *y]), "%.6f", ",", header="t,one,two", comments="")
    (folder / "claims").symlink_to(REPOSITORY / "claims")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("command", runnable())
def test_a_command_of_a_guide_runs(command: str, folder: Path) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    python_path = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PATH": path, "PYTHONPATH": python_path}
    run = subprocess.run(
        ["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, timeout=500
    )
    allowed = {0, 1} if "data=" in command else {0}  # 1: a record has no answer to be trusted
    assert run.returncode in allowed, run.stderr
    assert "Traceback" not in run.stderr
