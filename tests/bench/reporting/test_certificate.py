"""The certificate of a measured record: what is gathered, said and drawn, and that the page needs nothing else."""

from __future__ import annotations

import math
import re
from base64 import b64decode
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.resources import files
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from bench.records import certificate as gathering
from bench.records import classes
from bench.records.certificate import Certificate, _comparison, agreement_of, certify, with_reasons
from bench.records.intervals import StatedInterval
from bench.records.models import ClassComparison
from bench.records.prediction import held_out_fit
from bench.records.problem import Measured, read_measured
from bench.records.reading import of_arrays
from bench.records.replicas import ReplicaCoverage
from bench.records.request import Request, request_of
from bench.records.response import MOST_DRAWN, thinned
from bench.records.verdict import Trust
from bench.records.workers import Workers
from bench.reporting.answer import answer, quantity_text
from bench.reporting.certificate.contents import contents
from bench.reporting.certificate.page import page
from bench.reporting.pictures.theme import INK
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


def test_the_page_needs_nothing_else_and_states_the_contents(text: str, shown: Mapping[str, Any]) -> None:
    assert not re.search(r"""(?:src|href)\s*=\s*(?!["']?(?:#|data:))|url\((?!#|data:)|<script|@import""", text)
    assert "default-src 'none'" in text
    assert all(sentence in text for sentence in shown["sentences"])
    assert re.findall("<h1>(.*?)</h1>", text) == [shown["answer"]]
    assert re.fullmatch(r"natural frequency = 0.9\d+ ± 0.0\d+ Hz, damping ratio = \d.\d+ [^=]* %", shown["answer"])
    for name, own in shown["values"].items():
        scale = 100.0 if name == "damping_ratio" else 1.0
        value, low, high = rounded(*(scale * own[end] for end in ("value", "low", "high")))
        assert f"<td>{value}</td>" in text
        assert f"<td>{low} to {high}</td>" in text


def test_the_pictures_are_drawings_in_the_one_style(text: str) -> None:
    drawings = [b64decode(code).decode() for code in re.findall(r'<img src="data:image/svg[^,]*,([^"]+)"', text)]
    assert len(drawings) == 3
    for drawing in drawings:
        assert ElementTree.fromstring(drawing).tag == "{http://www.w3.org/2000/svg}svg"
        assert f'fill="{INK}"' in drawing
        assert "NaN" not in drawing


def test_text_stands_out_on_every_ground() -> None:
    """Contrast of 4.5 at least (WCAG 2.2, 1.4.3)."""
    style = files("bench.reporting.certificate").joinpath("certificate.css").read_text(encoding="utf-8")
    for scheme in re.findall(r":root \{(.*?)\}", style, re.S):
        colours = {name: luminance(colour) for name, colour in re.findall(r"--(\w+): (#[0-9a-f]{6})", scheme)}
        for ground in ("surface", "raised", "level", "warn"):
            for ink in ("ink", "muted"):
                low, high = sorted((colours[ink], colours[ground]))
                assert (high + 0.05) / (low + 0.05) >= 4.5, (ink, ground)


def luminance(colour: str) -> float:
    """Relative luminance of #rrggbb (WCAG 2.2)."""
    parts = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    return float(np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])


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
    without = page(contents(replace(made, missing={"replicas": "not requested (twins=0)"}), "again"))
    assert "Not simulated: not requested (twins=0)." in without


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


def test_thinning_keeps_the_extremes() -> None:
    x = np.arange(100_000.0)
    y = np.sin(x)
    y[54_321] = 7.0
    few, values = thinned(x, y)
    assert few.size <= MOST_DRAWN
    assert np.max(values) == 7.0
    assert np.all(np.diff(few) > 0)
