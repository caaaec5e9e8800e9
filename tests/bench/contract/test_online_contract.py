"""What every tracker gets for nothing: the clock of the samples, values that say nothing, a step that goes wrong."""

import numpy as np
import pytest

from bench import InputError, Layout, Normal, Sample, SampleStatus, Sensor, Tracker, TrackerOutput
from bench.systems import make_system


class Counting(Tracker):
    """Keeps what it was given; goes wrong where a value is above 100."""

    state_names = ("given",)

    def __init__(self, layout: Layout) -> None:
        super().__init__(layout)
        self.given: list[float] = []

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        if sample.values[0] > 100:
            raise ValueError("too large")
        self.given.append(sample.values[0])
        return TrackerOutput(sample.time, SampleStatus.OK, Normal(("c", "k"), np.zeros(2), np.eye(2), log=True))


def tracker(**sensor) -> Counting:
    return Counting(Layout(make_system("sdof", {}), (Sensor(**sensor),), 0.1))


def test_a_repeated_or_an_earlier_time_is_left_out() -> None:
    one = tracker()
    found = [one.update(Sample(t, (v,))) for t, v in ((0.0, 1.0), (0.1, 2.0), (0.1, 9.0), (0.05, 9.0), (0.2, 3.0))]
    assert [standing.status.value for standing in found] == ["ok", "ok", "repeated", "repeated", "ok"]
    assert one.given == [1.0, 2.0, 3.0]


def test_a_gap_is_said_with_its_length() -> None:
    one = tracker()
    one.update(Sample(0.0, (1.0,)))
    found = one.update(Sample(0.5, (2.0,)))
    assert found.status is SampleStatus.GAP
    assert "4 sample" in found.message


def test_a_missing_value_reaches_the_method_as_nan() -> None:
    one = tracker()
    assert one.update(Sample(0.0, (float("inf"),))).status is SampleStatus.MISSING
    assert np.isnan(one.given[0])


def test_beyond_its_limits_a_sensor_says_nothing() -> None:
    one = tracker(limits=(-1.0, 1.0))
    assert one.update(Sample(0.0, (1.0,))).status is SampleStatus.SATURATED
    assert one.update(Sample(0.1, (0.99,))).status is SampleStatus.OK


def test_a_sensor_at_a_limit_that_nobody_told_is_found_by_its_repeated_extreme() -> None:
    one = tracker()
    values = np.clip(np.sin(np.arange(60) * 0.3), -0.8, 0.8)
    found = [one.update(Sample(0.1 * i, (v,))).status for i, v in enumerate(values.tolist())]
    at_limit = np.flatnonzero(np.abs(values) == 0.8)
    said = np.flatnonzero([status is SampleStatus.SATURATED for status in found])
    assert set(said) <= set(at_limit)
    assert len(said) >= len(at_limit) - 6


def test_a_step_that_goes_wrong_is_a_status_and_the_next_one_goes_on() -> None:
    one = tracker()
    one.update(Sample(0.0, (1.0,)))
    failed = one.update(Sample(0.1, (101.0,)))
    assert failed.status is SampleStatus.FAILED
    assert failed.distribution is not None
    assert one.update(Sample(0.2, (2.0,))).status is SampleStatus.OK


def test_a_sample_that_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="1 value"):
        tracker().update(Sample(0.0, (1.0, 2.0)))


def test_a_state_goes_on_where_it_was_and_another_methods_is_refused() -> None:
    one = tracker()
    one.update(Sample(0.0, (1.0,)))
    other = tracker().restored(one.saved())
    assert other.update(Sample(0.0, (5.0,))).status is SampleStatus.REPEATED
    with pytest.raises(InputError, match="state"):
        tracker().restored({"something": 1})


def test_without_a_known_force_the_groups_are_told_and_a_marginal_is_theirs() -> None:
    layout = tracker().layout
    assert layout.free == ("c", "k")
    names = [quantity.name for quantity in layout.quantities]
    assert names == ["k_over_m", "c_over_m", "natural_frequency", "damping_ratio"]
    standing = TrackerOutput(0.0, SampleStatus.OK, Normal(("c", "k"), np.log([0.5, 9.0]), 0.01 * np.eye(2), log=True))
    found = {q.name: standing.marginal(q).value for q in layout.quantities}
    assert found["k_over_m"] == pytest.approx(9.0)
    assert found["natural_frequency"] == pytest.approx(3.0 / (2 * np.pi))
    assert found["damping_ratio"] == pytest.approx(0.5 / (2 * 3.0))
