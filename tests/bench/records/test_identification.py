"""Identification: the robust fit of records with outliers."""

from __future__ import annotations

import numpy as np

from bench.records.identification import identify_all
from bench.records.problem import read_measured
from bench.records.reading import of_arrays
from bench.records.request import request_of
from bench.records.verdict import Trust


def test_outliers_do_not_affect_a_method_with_a_robust_likelihood() -> None:
    """Ten samples of a decay in closed form deviate by 40 times the noise, to one side, where the motion is small."""
    times, rng = np.linspace(0.0, 10.0, 300), np.random.default_rng(3)
    x = np.exp(-0.2 * times) * np.cos(6.0 * times) + 0.01 * rng.standard_normal(times.size)
    x[rng.choice(np.flatnonzero((x > 0.0) & (times > 5.0)), 10, replace=False)] += 0.4
    request = request_of({"data": ["arrays"], "method": ["shooting", "matrix_pencil"]})
    shooting, other = identify_all(request, read_measured(request, (of_arrays(times, x),)))
    assert any("Student's t" in note for note in shooting.measured.notes)
    assert not any("Student's t" in note for note in other.measured.notes)
    assert shooting.trust is Trust.CAUTION
    error, other_error = (abs(np.log(f.stated["c_over_m"].value / 0.4)) for f in (shooting, other))
    assert error < 0.02 < other_error
