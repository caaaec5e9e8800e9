"""A short soak: a sweep under faults at random, beside readers, ends as an undisturbed one."""

from __future__ import annotations

import secrets

import pytest

from tests.studies.sweeps.shim import why_not
from tests.studies.sweeps.soak import soak

CELLS, MINUTES = 120, 0.75


@pytest.mark.slow
@pytest.mark.skipif(why_not() != "", reason=f"needs what a shim is made of: {why_not()}")
def test_a_sweep_under_faults_ends_as_an_undisturbed_one() -> None:
    seed = secrets.randbelow(10**6)
    assert soak(CELLS, MINUTES, seed) == 0, f"seed={seed}"
