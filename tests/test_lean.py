"""An installation without extras, so without jax, torch and CasADi, certifies a record."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import REPOSITORY

from bench.records import law_simulation


def test_numpy_simulates_the_law_of_motion_as_jax_does() -> None:
    """Complex steps against forward differentiation, over displacement, velocity and acceleration."""
    rng = np.random.default_rng(5)
    coefficients = np.abs(rng.normal([0.5, 0.04, 0.5, 0.5, 0.05, 0.02, 0.02, 0.01, 1.0], 0.02, (4, 3, 9)))
    unknowns = np.concatenate([coefficients, rng.normal(0.0, 1.0, (4, 3, 2))], axis=2)
    push, force = rng.normal(0.0, 0.1, (3, 256)), rng.normal(0.0, 0.1, (3, 40))
    places = np.sort(rng.uniform(0.0, 15.0, (3, 40)), axis=1)
    arguments = unknowns, 250, push, places, force, np.arange(3), 0.7
    for ours, compiled in zip(
        law_simulation._simulate(*arguments), law_simulation._compiled()(*arguments), strict=True
    ):
        np.testing.assert_allclose(ours, compiled, rtol=1e-8, atol=1e-10)


@pytest.mark.slow
def test_an_installation_without_extras_certifies_a_record(tmp_path: Path) -> None:
    """A damped sine with noise: natural frequency 1.5 Hz, damping ratio 2 %."""
    rng, t = np.random.default_rng(11), np.arange(400) / 40.0
    rate = 2 * np.pi * 1.5
    x = np.exp(-0.02 * rate * t) * np.cos(rate * np.sqrt(1 - 0.02**2) * t) + 0.01 * rng.standard_normal(t.size)
    np.savetxt(tmp_path / "record.csv", np.column_stack([t, x]), delimiter=",", header="t [s],x [mm]", comments="")
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "lean")], check=True)
    lean = str(tmp_path / "lean" / "bin" / "python")
    install = [lean, "-m", "pip", "install", "-q", "-c", "constraints.txt", "."]
    done = subprocess.run(install, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    absent = (
        "import importlib.util as u; print([n for n in ('jax', 'torch', 'casadi', 'matplotlib') if u.find_spec(n)])"
    )
    assert subprocess.run([lean, "-c", absent], capture_output=True, text=True).stdout.strip() == "[]"
    command = [lean, "-m", "bench", "certify", "data=record.csv", "twins=0"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    certificate = json.loads((tmp_path / "certificate" / "certificate.json").read_text())
    assert certificate["verdict"] == "trust", certificate["reasons"]
    values = certificate["values"]
    for name, truth in (("natural_frequency", 1.5), ("damping_ratio", 0.02)):
        assert values[name]["low"] <= truth <= values[name]["high"], values[name]
        assert values[name]["high"] - values[name]["low"] < 0.5 * truth
    assert "jax" not in done.stderr
