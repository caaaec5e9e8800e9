"""The study of the online methods: its faults are what they say, its stated levels those of the methods."""

from dataclasses import replace

import numpy as np
import pytest

from bench.config.online import online_scenario
from bench.entrants.online import make_online
from tests.studies.online.constant import ROWS, constant
from tests.studies.online.faults import AT, FAULTS, METHODS, faulty, followed


@pytest.fixture(scope="module")
def stream():
    return replace(online_scenario("constant_multisine"), samples=800).stream(2, 0)


def test_thresholds_of_the_table_are_those_of_the_methods() -> None:
    for row in ROWS:
        assert getattr(make_online(row.method, {}), "threshold", None) in (None, row.threshold)
    assert {row.method for row in ROWS} >= {"ekf", "ukf", "square_root", "imm", "change_points", "cusum", "glr"}
    for name in METHODS:
        assert make_online(name).objection(online_scenario("constant_multisine").layout()) is None


@pytest.mark.parametrize("kind", sorted(FAULTS))
def test_before_its_fault_a_stream_is_as_it_was(kind, stream) -> None:
    plain, found = stream.samples(), faulty(kind, stream)
    if kind != "saturation":
        assert found[:AT] == plain[:AT] or all(a.values == b.values for a, b in zip(found[:AT], plain, strict=False))
    changed = len(found) != len(plain) or any(
        not np.array_equal(a.values, b.values) for a, b in zip(found, plain, strict=True)
    )
    assert changed == (kind not in ("crash", "restart"))


@pytest.mark.parametrize("kind", ["restart", "crash", "gap"])
def test_behind_a_fault_a_method_goes_on(kind, stream) -> None:
    plain, found = (followed("rls", one, stream) for one in ("none", kind))
    if kind == "restart":
        assert np.array_equal(plain[0], found[0], equal_nan=True)
    assert np.isfinite(found[0][-1])
    assert ("failed" in found[1]) == (kind == "crash")


@pytest.mark.slow
def test_on_a_few_records_of_constants_the_table_is_whole(tmp_path) -> None:
    text = constant(4, tmp_path, 2)
    assert text.count("\n|") == len(ROWS) + 2
    assert "nan" not in text
