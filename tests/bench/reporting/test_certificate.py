"""The certificate of a measured record: what is gathered, said and drawn, and that the page needs nothing else."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bench.records import certificate as gathering
from bench.records import classes
from bench.records.certificate import Certificate, _ranked, certify, prediction_of, standing_of
from bench.records.classes import ModelClass
from bench.records.continued import NAME
from bench.records.held_out import held_out_fit
from bench.records.intervals import StatedInterval
from bench.records.record import Measured, of_arrays, read_measured
from bench.records.request import Request, request_of
from bench.reporting.certificate.contents import contents, listed
from bench.reporting.certificate.figures import power_of_ten, thinned
from bench.reporting.certificate.page import fit_text, page
from bench.reporting.rounding import rounded

RATE, DECAY = 6.0, 0.2
TIMES = np.arange(120) / 20.0
NOISE = 0.01 * np.random.default_rng(3).standard_normal(TIMES.size)


def asked(system: str = "sdof", methods: tuple[str, ...] = ("output_error", "ls")) -> tuple[Request, Measured]:
    request = request_of({"data": ["arrays"], "method": list(methods), "system": [system]})
    values = np.exp(-DECAY * TIMES) * np.cos(RATE * TIMES) + NOISE
    return request, read_measured(request, [of_arrays(TIMES, values)])


@pytest.fixture(scope="module")
def ranked() -> Iterator[list[ModelClass]]:
    """Two classes of the record, which stand in for all: fitting them all takes a minute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(classes, "SIMPLE", ("viscous", "Duffing"))
        patch.setattr(classes, "_damped", lambda base: {})
        found = classes.ranked_classes(asked("auto")[1])
        patch.setattr(gathering, "_ranked", lambda measured, missing, limit_s: found)
        yield found


@pytest.fixture(scope="module")
def made(ranked: list[ModelClass]) -> Certificate:
    return certify(*asked(), twins=0)


@pytest.fixture(scope="module")
def shown(made: Certificate) -> Mapping[str, Any]:
    return contents(made, "python -m bench certify data=decay.csv")


@pytest.fixture(scope="module")
def text(shown: Mapping[str, Any]) -> str:
    return page(shown)


def test_where_the_primary_method_finds_nothing_the_fit_of_the_class_stands(ranked: list[ModelClass]) -> None:
    """Only where the system was chosen; which method found nothing, and why, is said."""
    failed = ("era",)  # it cannot estimate the sensor's offset
    chosen = certify(*asked("auto", failed), twins=0)
    assert [one.method for one in chosen.findings] == [NAME, "era"]
    assert {"k_over_m", "c_over_m"} <= set(chosen.primary.intervals)
    own = chosen.primary.intervals["k_over_m"]
    assert own.low < RATE**2 + DECAY**2 < own.high
    assert any("era found no answer: it cannot estimate" in reason.text for reason in chosen.primary.reasons)
    assert NAME in page(contents(chosen, "certify"))
    named = certify(*asked("sdof", failed), twins=0)
    assert [one.method for one in named.findings] == ["era"]


def test_the_page_asks_for_nothing(text: str) -> None:
    assert not re.search(r"""(?:src|href)\s*=\s*(?!["']?(?:#|data:))""", text)
    assert not re.search(r"url\((?!#|data:)", text)
    assert "<script" not in text
    assert "@import" not in text
    assert "http" not in re.sub(r"http-equiv", "", text)
    assert "default-src 'none'" in text


def test_the_page_shows_verdict_and_intervals_of_the_contents(text: str, shown: Mapping[str, Any]) -> None:
    for sentence in shown["sentences"]:
        assert sentence in text
    assert len(shown["sentences"]) == 3
    for own in shown["values"].values():
        value, low, high = rounded(own["value"], own["low"], own["high"])
        assert f"<td>{value}</td>" in text
        assert f"<td>{low} to {high}</td>" in text


def test_all_that_can_be_drawn_is_drawn_once_and_its_names_do_not_clash(text: str) -> None:
    assert text.count("<svg") == 6
    names = re.findall(r' id="([^"]+)"', text)
    assert len(names) == len(set(names))
    assert "mathdefault" not in text


def test_the_fit_and_the_motion_are_in_the_units_of_the_record(shown: Mapping[str, Any]) -> None:
    series = shown["series"]
    clean = np.exp(-DECAY * TIMES) * np.cos(RATE * TIMES)
    assert np.max(np.abs(series["fit"] - clean)) < 0.01
    assert np.allclose(series["fit"] + series["residuals"], series["values"])
    motion = series["motion"]
    assert motion["times"][-1] == pytest.approx(TIMES[-1])
    slope = np.gradient(motion["displacement"], motion["times"])
    assert np.max(np.abs(slope - motion["velocity"])[2:-2]) < 0.01 * RATE
    assert series["spectrum"]["natural_frequency"] == pytest.approx(math.hypot(RATE, DECAY) / (2 * math.pi), rel=0.01)
    rate = 20.0
    total = np.sum(series["spectrum"]["periodogram"]) * rate / TIMES.size
    assert total == pytest.approx(np.var(series["residuals"]), rel=0.03)


def test_the_prediction_is_that_of_held_out_fit(made: Certificate) -> None:
    at = made.primary.at
    assert at is not None
    own = prediction_of(at)
    assert own is not None
    assert own.fit == pytest.approx(held_out_fit(at), abs=1e-3)
    size, second = made.primary.channel_size, made.primary.units.time
    assert second * own.split == pytest.approx(0.6 * TIMES[-1], abs=0.06)
    assert np.max(np.abs(size * own.predicted - np.exp(-DECAY * TIMES) * np.cos(RATE * TIMES))) < 0.05


def test_the_best_of_ranked_classes_is_what_system_auto_takes(ranked: list[ModelClass]) -> None:
    _, measured = asked("auto")
    assert ranked
    assert "system=auto chose" in " ".join(classes.best_class(measured, ranked).notes)
    assert "sdof is used" in classes.best_class(measured, []).notes[-1]


def test_classes_that_take_too_long_are_missing() -> None:
    missing: dict[str, str] = {}
    assert _ranked(asked()[1], missing, 0.0) == []
    assert "limit" in missing["classes"]


@pytest.mark.parametrize(
    ("value", "low", "high", "standing"),
    [(1.05, 1.0, 1.1, "agrees"), (1.3, 0.9, 1.7, "level"), (1.3, 1.15, 1.5, "off")],
)
def test_standings(value: float, low: float, high: float, standing: str) -> None:
    own = StatedInterval(1.0, *(0.9, 1.1) * 3, "1/s²")
    assert standing_of(StatedInterval(value, *(low, high) * 3, "1/s²"), own) == standing
    assert standing_of(own, None) == "-"


@dataclass(frozen=True)
class Line:
    """What twins say of one method and quantity."""

    method: str = "output_error"
    quantity: str = "k_over_m"
    n_ok: int = 40
    median_error_pct: float = 0.123
    coverage_white: float = 0.9
    coverage_stated: float = 0.95
    stretch: float = math.nan


def test_twins_and_better_records_are_shown(made: Certificate) -> None:
    corrected = {name: replace(own, low=0.5 * own.low) for name, own in made.primary.intervals.items()}
    twins = SimpleNamespace(n=40, quantities=("k_over_m",), lines=(Line(),), corrected=corrected)
    also = replace(made, twins=twins)
    text = page(contents(also, "again"))
    assert "Corrected by twins" in text
    assert "0.123" in text
    assert "95 %" in text
    assert "twice the sampling rate" in text
    without = page(contents(replace(made, twins=SimpleNamespace(**{**vars(twins), "lines": ()})), "again"))
    assert "Corrected by twins:" not in without


def test_methods_for_twins_are_those_that_there_is_time_for(made: Certificate) -> None:
    def took(finding: Any, wall_s: float) -> Any:
        return replace(finding, outcome=replace(finding.outcome, wall_s=wall_s))

    first, second = made.findings
    assert gathering.affordable([took(first, 0.01), took(second, 0.01)], 200) == (["output_error", "ls"], 200)
    assert gathering.affordable([took(first, 0.01), took(second, 10.0)], 200) == (["output_error"], 200)
    assert gathering.affordable([took(first, 0.25), took(second, 10.0)], 200)[1] == 40


def test_numbers_without_a_value_are_no_text(made: Certificate) -> None:
    assert fit_text(math.nan) == "–"
    assert fit_text(-1e9) == "below −100"
    assert power_of_ten(1e-5) == "10⁻⁵"
    plain = listed({"a": np.array([1.0, 2.0]), "b": (np.float64(3.0), "text")})
    assert plain == {"a": [1.0, 2.0], "b": [3.0, "text"]}


def test_thinning_keeps_the_extremes() -> None:
    x = np.arange(100_000.0)
    y = np.sin(x)
    y[54_321] = 7.0
    few, values = thinned(x, y)
    assert few.size <= 1200
    assert np.max(values) == 7.0
    assert np.all(np.diff(few) > 0)
