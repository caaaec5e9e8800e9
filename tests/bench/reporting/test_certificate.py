"""The certificate of a measured record: what is gathered, said and drawn, and that the page needs nothing else."""

from __future__ import annotations

import math
import re
from base64 import b64decode
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench.face.results import nulls
from bench.records import certificate as gathering
from bench.records import classes
from bench.records.certificate import (
    Certificate,
    _comparison,
    agreement_of,
    certify,
    with_reasons,
)
from bench.records.classes import NAME
from bench.records.held_out import held_out_fit
from bench.records.intervals import StatedInterval
from bench.records.models import ClassComparison
from bench.records.problem import Measured, read_measured
from bench.records.reading import of_arrays
from bench.records.replicas import ReplicaCoverage
from bench.records.request import Request, request_of
from bench.records.verdict import Trust
from bench.records.workers import Workers
from bench.reporting.answer import answer, quantity_text
from bench.reporting.certificate.contents import contents
from bench.reporting.certificate.figures import thinned
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
def compared() -> Iterator[ClassComparison]:
    """The classes of the record, compared once."""
    with pytest.MonkeyPatch.context() as patch:
        found = classes.compare_classes(asked("auto")[1])
        assert found is not None
        patch.setattr(gathering, "_comparison", lambda measured, workers, missing: found)
        yield found


@pytest.fixture(scope="module")
def made(compared: ClassComparison) -> Certificate:
    return certify(*asked(), 0)


@pytest.fixture(scope="module")
def shown(made: Certificate) -> Mapping[str, Any]:
    return contents(made, "python -m bench certify data=decay.csv")


@pytest.fixture(scope="module")
def text(shown: Mapping[str, Any]) -> str:
    return page(shown)


def test_where_the_primary_method_finds_nothing_the_fit_of_the_class_stands(compared: ClassComparison) -> None:
    """Only where the system was chosen; which method found nothing, and why, is said."""
    failed = ("era",)  # it cannot estimate the sensor's offset
    chosen = certify(*asked("auto", failed), 0)
    assert [one.method for one in chosen.findings] == [NAME, "era"]
    assert {"k_over_m", "c_over_m"} <= set(chosen.primary.intervals)
    own = chosen.primary.intervals["k_over_m"]
    assert own.low < RATE**2 + DECAY**2 < own.high
    assert any("era found no answer: it cannot estimate" in reason.text for reason in chosen.primary.reasons)
    assert NAME in page(contents(chosen, "certify"))
    named = certify(*asked("sdof", failed), 0)
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
    assert len(shown["sentences"]) == 2
    for name, own in shown["values"].items():
        scale = 100.0 if name == "damping_ratio" else 1.0
        value, low, high = rounded(*(scale * own[end] for end in ("value", "low", "high")))
        assert f"<td>{value}</td>" in text
        assert f"<td>{low} to {high}</td>" in text


def test_all_that_can_be_drawn_is_drawn_once_and_its_names_do_not_clash(text: str) -> None:
    drawings = [b64decode(code).decode() for code in re.findall(r'<img src="data:image/svg[^,]*,([^"]+)"', text)]
    assert len(drawings) == 5
    names = re.findall(r' id="([^"]+)"', text)
    assert len(names) == len(set(names))
    for drawing in drawings:
        assert "mathdefault" not in drawing
        assert "prefers-color-scheme: dark" in drawing
        assert "var(--ink)" in drawing


def test_the_fit_is_in_the_units_of_the_record(shown: Mapping[str, Any]) -> None:
    series = shown["series"]
    clean = np.exp(-DECAY * TIMES) * np.cos(RATE * TIMES)
    assert np.max(np.abs(series["fit"] - clean)) < 0.01
    assert np.allclose(series["fit"] + series["residuals"], series["values"])
    assert series["spectrum"]["natural_frequency"] == pytest.approx(math.hypot(RATE, DECAY) / (2 * math.pi), rel=0.01)
    rate = 20.0
    total = np.sum(series["spectrum"]["periodogram"]) * rate / TIMES.size
    assert total == pytest.approx(np.var(series["residuals"]), rel=0.03)


def test_the_prediction_is_that_of_held_out_fit(made: Certificate, shown: Mapping[str, Any]) -> None:
    at = made.primary.fit
    assert at is not None
    assert shown["prediction"]["fit_pct"] == pytest.approx(held_out_fit(at), abs=1e-3)
    assert shown["prediction"]["split"] == pytest.approx(0.6 * TIMES[-1], abs=0.06)
    assert np.max(np.abs(shown["series"]["prediction"] - np.exp(-DECAY * TIMES) * np.cos(RATE * TIMES))) < 0.05


def test_the_chosen_class_is_what_system_auto_takes(compared: ClassComparison) -> None:
    _, measured = asked("auto")
    assert "system=auto chose" in " ".join(classes.best_class(measured, compared).notes)
    assert "sdof is used" in classes.best_class(measured, None).notes[-1]


def test_classes_that_take_too_long_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    missing: dict[str, str] = {}
    monkeypatch.setattr(gathering, "CLASSES_SECONDS", 0.0)
    with Workers() as workers:
        assert _comparison(asked()[1], workers, missing) is None
    assert "limit" in missing["classes"]


def interval(value: float, low: float, high: float) -> StatedInterval:
    return StatedInterval(value, low, high, low, high, low, high, "1/s²")


@pytest.mark.parametrize(
    ("value", "low", "high", "agreement"),
    [(1.05, 1.0, 1.1, "agrees"), (1.3, 0.9, 1.7, "tied"), (1.3, 1.15, 1.5, "off")],
)
def test_agreement(value: float, low: float, high: float, agreement: str) -> None:
    own = interval(1.0, 0.9, 1.1)
    assert agreement_of(interval(value, low, high), own) == agreement
    assert agreement_of(own, None) == "-"


def test_a_sound_method_that_disagrees_is_a_reason_for_caution(made: Certificate) -> None:
    other = replace(made.primary, method="iqml", stated={"c_over_m": interval(2.0, 1.9, 2.1)})
    alike = replace(made.primary, method="ls", stated={"c_over_m": interval(2.0, 0.1, 2.1)})
    primary = with_reasons(replace(made.primary, reasons=()), [other, alike], {})
    assert primary.trust is Trust.CAUTION
    assert [reason.text for reason in primary.reasons] == ["iqml disagrees in c/m"]


def test_replicas_and_better_records_are_shown(made: Certificate) -> None:
    lines = (ReplicaCoverage("k_over_m", 200, 0.123, 0.87, 1.4, (30.0, 42.0)),)
    text = page(contents(replace(made, replicas=lines), "again"))
    assert "<td>200</td><td>0.123</td><td>87 (82 to 91)</td><td>1.4</td><td>30.0 to 42.0</td>" in text
    assert "twice the sampling rate" in text
    without = page(contents(replace(made, missing={"replicas": "none were asked for (twins=0)"}), "again"))
    assert "Not simulated: none were asked for (twins=0)." in without


def test_the_first_line_is_the_answer_with_an_uncertainty(shown: Mapping[str, Any], text: str) -> None:
    assert re.fullmatch(r"natural frequency = 0.9\d+ ± 0.0\d+ Hz, damping ratio = \d.\d+ [^=]* %", shown["answer"])
    assert re.findall("<h1>(.*?)</h1>", text) == [shown["answer"]]


@pytest.mark.parametrize(
    ("name", "own", "expected"),
    [
        ("k_over_m", interval(52.1, 51.9, 52.3), "k/m = 52.10 ± 0.20 1/s²"),
        ("k_over_m", interval(52.1, 40.0, 80.0), "k/m = 52 (40 to 80) 1/s²"),
        ("damping_ratio", interval(0.0213, 0.0195, 0.0231), "damping ratio = 2.13 ± 0.18 %"),
        ("c_over_m", replace(interval(0.1, 0.0, 0.4123), limit="at most"), "c/m at most 0.41 1/s²"),
        ("m", replace(interval(3.0, 2.0, math.inf), limit="at least"), "m at least 2 1/s²"),
    ],
)
def test_uncertainties_in_words(name: str, own: StatedInterval, expected: str) -> None:
    assert quantity_text(name, vars(own)) == expected


def test_parameters_are_the_answer_where_their_scale_is_determined() -> None:
    own = vars(replace(interval(2.0, 1.9, 2.1), unit="kg"))
    assert answer({"m": own, "k_over_m": own, "natural_frequency": own}) == "m = 2.00 ± 0.10 kg"
    assert answer({"k_over_m": own, "mu_over_m": own, "natural_frequency": own}).count("=") == 2


def test_numbers_without_a_value_are_no_text() -> None:
    assert fit_text(math.nan) == "–"
    assert fit_text(-1e9) == "below −100"
    plain = nulls({"a": np.array([1.0, np.nan]), "b": (np.float64(3.0), "text")})
    assert plain == {"a": [1.0, None], "b": [3.0, "text"]}


def test_thinning_keeps_the_extremes() -> None:
    x = np.arange(100_000.0)
    y = np.sin(x)
    y[54_321] = 7.0
    few, values = thinned(x, y)
    assert few.size <= 1200
    assert np.max(values) == 7.0
    assert np.all(np.diff(few) > 0)
