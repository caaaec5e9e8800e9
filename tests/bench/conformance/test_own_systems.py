"""What every system must keep: ours do, and one with a fault is refused by the check of that fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from bench.commands.main import main
from bench.conformance.check import Check
from bench.conformance.system_checks import SYSTEM_CHECKS, Specimen
from bench.systems import (
    DAMPING,
    MASS,
    SDOF,
    STIFFNESS,
    Parameter,
    Quantity,
    System,
    make_system,
    registered_systems,
)

SUMS: Mapping[str, dict[str, Any]] = {
    "cubic": {"terms": ("viscous", "spring", "cubic")},
    "all damping": {"terms": ("viscous", "spring", "coulomb", "quadratic"), "smoothing_velocity": 0.3},
    "softening": {"terms": ("viscous", "spring", "softening")},
    "pendulum of a known length": {"terms": ("pendulum", "viscous", "coulomb"), "fixed": (("l", 0.7),)},
    "driven axis": {"terms": ("viscous", "coulomb", "bias"), "bias_sign": -1},
}
SPECIMENS: Mapping[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {"n": 3} if name == "chain" else {}) for name in registered_systems() if name != "sum"},
    **{f"sum, {label}": ("sum", options) for label, options in SUMS.items()},
}
"""Systems by label: registered name and options."""
checks = pytest.mark.parametrize("check", SYSTEM_CHECKS, ids=lambda check: check.name)


@pytest.mark.parametrize("label", SPECIMENS)
@checks
def test_every_system_of_ours_keeps_the_contract(label: str, check: Check) -> None:
    name, options = SPECIMENS[label]
    check.run(Specimen(name, options, make_system(name, options)))


@dataclass(frozen=True)
class Faulty(System):
    """A linear oscillator with one fault."""

    fault: str = ""
    name: ClassVar[str] = "faulty"

    @property
    def linear(self) -> bool:  # type: ignore[override]
        return self.fault in ("not_linear", "bilinear")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        damping = STIFFNESS if self.fault == "dimension" else DAMPING
        third = Parameter("k", "" if self.fault == "no_unit" else "N/m", "stiffness", STIFFNESS)
        return (Parameter("m", "kg", "mass", MASS), Parameter("c", "N s/m", "damping", damping), third)

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return SDOF().groups

    def residual(self, p: Any, x: Any, v: Any, a: Any, f: Any, z: Any, ops: Any) -> list[Any]:
        inertia = p["m"] * a[0] + p["c"] * v[0]
        restoring = p["k"] * x[0]
        if self.fault == "numpy":
            inertia = inertia + p["c"] * np.sin(v[0])
        if self.fault == "squared_acceleration":
            inertia = inertia + p["m"] * a[0] ** 2
        if self.fault == "not_affine":
            restoring = p["k"] ** 2 * x[0]
        if self.fault == "not_linear":
            restoring = p["k"] * x[0] ** 3
        if self.fault == "bilinear":
            restoring = p["k"] * x[0] * ops.where(x[0] > 0, 1.0, 2.0)
        if self.fault == "idle_parameter":
            restoring = 8.0 * x[0]
        if self.fault == "changes_the_input":
            x[0] *= 1.0 + 1e-9
        if self.fault == "two_rows":
            return [inertia + restoring - f[0], restoring]
        return [inertia + restoring - f[0]]


FAULTS = {
    "no_unit": "declaration",
    "numpy": "libraries",
    "two_rows": "libraries",
    "changes_the_input": "input",
    "squared_acceleration": "affinity",
    "not_affine": "affinity",
    "not_linear": "affinity",
    "bilinear": "affinity",
    "idle_parameter": "parameters",
    "dimension": "dimensions",
}
"""The fault, and the check that must see it."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_seen_by_its_check(fault: str) -> None:
    (check,) = (check for check in SYSTEM_CHECKS if check.name == FAULTS[fault])
    found = check.outcome(Specimen("faulty", {}, Faulty(fault)))
    assert not found.passed
    assert len(found.remedy.split()) >= 4


GROUPS = '''
from dataclasses import dataclass
from bench.systems import SDOF, Quantity

@dataclass(frozen=True)
class Own(SDOF):
    """An oscillator."""

    name = "own_oscillator"

    @property
    def groups(self):
        return {groups}
'''


@pytest.mark.parametrize(
    ("groups", "status", "words"),
    [
        ("SDOF().groups", 0, "10 of 10 checks passed"),
        ('(*SDOF().groups, Quantity("m", "kg", {"m": 1.0}))', 1, "does not determine m; it determines"),
        ("SDOF().groups[:1]", 1, "1 more are determined than it declares"),
    ],
)
def test_declared_groups_are_held_against_what_free_vibration_determines(
    groups: str, status: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "own.py").write_text(GROUPS.replace("{groups}", groups))
    assert main(["check", f"package={tmp_path / 'own.py'}"]) == status
    assert words in " ".join(capsys.readouterr().out.split())
