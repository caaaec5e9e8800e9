"""Statistics of fits, against numbers that are counted by hand."""

import numpy as np
import pytest

from bench.atlas.statistics import COLUMNS, LARGEST, Statistics, columns, summarise_fits

NAN = float("nan")


def fit(error: float, held: float) -> np.ndarray:
    return np.array([[error, held], [0.0, NAN], [1.0, NAN]])


def test_gross_errors_are_counted_and_left_out_of_the_core() -> None:
    fits = [fit(1.0, 1.0), fit(-3.0, 0.0), fit(5.1, 0.0), fit(LARGEST, NAN)]
    found = summarise_fits(fits, [False, False, False, True], [1.0, 2.0, 3.0, 4.0])
    k = dict(zip(COLUMNS, found.values[0], strict=True))
    assert k["bias"] == pytest.approx(-1.0)
    assert k["core"] == pytest.approx(np.sqrt(5.0))
    assert k["gross"] == 0.5
    assert k["median"] == pytest.approx((3.0 + 5.1) / 2)
    assert k["held"] == pytest.approx(1 / 3)
    assert k["told"] == 0.75
    assert (found.fits, found.failed, found.seconds) == (4, 0.25, 2.5)


def test_a_row_holds_everything() -> None:
    found = summarise_fits([fit(1.0, 1.0), fit(9.0, 0.0)], [False, False], [1.0, 2.0])
    again = Statistics.from_row(found.row())
    assert found.row().size == len(columns(("k_over_m", "c_over_m")))
    np.testing.assert_allclose(again.values, found.values, rtol=1e-6)
    assert (again.fits, again.failed, again.seconds) == (2, 0.0, 1.5)
