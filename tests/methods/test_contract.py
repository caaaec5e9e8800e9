"""The contract, over every registered method and variant: the checks of ``python -m bench check``."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from bench.conformance.check import Check
from bench.conformance.method_checks import METHOD_CHECKS, Candidate
from bench.entrants.registry import load_method, make_method, registered

VARIANTS: dict[str, dict[str, Any]] = {
    "ddnn": {"name": "ddnn", "iterations": 8, "draws": 10},  # as far as needed: what is asked is not accuracy
    "ls_spline": {"name": "ls", "derivative": "spline"},
    "npe": {"name": "npe", "steps": 150, "batch": 64, "width": 48, "depth": 2},
    "rival_deepxde": {"name": "rival_deepxde", "adam_steps": 40, "second_steps": 20},
    "rival_jinns": {"name": "rival_jinns", "adam_steps": 40, "second_steps": 20},
    "rival_pina": {"name": "rival_pina", "adam_steps": 40, "second_steps": 20},
    "pinn_adam": {"name": "pinn", "optimizer": "adam_lbfgs", "slack": 0.5, "adam_steps": 60, "lbfgs_steps": 60},
}
NAMES = sorted({*registered(), *VARIANTS})
WITHOUT_FIT = ("card", "imports")
QUICK = {"nuts": WITHOUT_FIT, "pinn_adam": (*WITHOUT_FIT, "answer")}
"""Quick checks of methods whose other checks are slow: one compiles for each layout, the other descends."""
IN_ANOTHER_PROCESS = ("ekf", "ls", "shooting")
"""Methods for which the start of another process is worth its time in the quick tests."""


def is_slow(name: str, check: Check) -> bool:
    of_another = check.name == "state" and name not in IN_ANOTHER_PROCESS
    return of_another or (name in QUICK and check.name not in QUICK[name])


@pytest.fixture(scope="module")
def candidate(request: pytest.FixtureRequest) -> Candidate:
    variant = dict(VARIANTS.get(request.param, {"name": request.param}))
    base = variant.pop("name")
    for package in load_method(base).requires:
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    return Candidate(make_method(base, variant))


@pytest.mark.parametrize(
    ("candidate", "check"),
    [
        pytest.param(name, check, id=f"{name}-{check.name}", marks=[pytest.mark.slow] * is_slow(name, check))
        for name in NAMES
        for check in METHOD_CHECKS
    ],
    indirect=["candidate"],
)
def test_a_method_keeps_the_contract(candidate: Candidate, check: Check) -> None:
    check.run(candidate)
