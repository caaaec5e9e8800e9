"""A short soak: a sweep under faults at random ends as an undisturbed one."""

from __future__ import annotations

import secrets
import shutil

import pytest

from tests.studies.sweeps.soak import soak

CELLS, MINUTES = 120, 0.75


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")
def test_a_sweep_under_faults_ends_as_an_undisturbed_one() -> None:
    seed = secrets.randbelow(10**6)
    assert soak(CELLS, MINUTES, seed) == 0, f"seed={seed}"
