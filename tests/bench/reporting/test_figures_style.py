"""How the pictures look: methods told apart, by those who see colours differently too, and letters that can be read."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stored import described, fill, fill_family, recorded, save, scored

from bench.contract.estimate import Status
from bench.reporting.labels import REFERENCE_CARDS, cards
from bench.scoring.row import Row
from bench.store.store import Store

pytest.importorskip("vl_convert")

import altair as alt
import vl_convert

from bench.reporting.figures.gallery import Gallery, Picture
from bench.reporting.figures.pictures import PICTURES, write_picture
from bench.reporting.figures.png import caption_of
from bench.reporting.figures.style import (
    FULL,
    HALF,
    MORE_COLOURS,
    MORE_MARKERS,
    drawable,
    looks,
    width_of,
    wrapped,
)
from bench.reporting.page.pictures import first_sentence
from bench.reporting.pictures.style import FULL as FULL_CHART
from bench.reporting.pictures.style import HALF as HALF_CHART
from bench.reporting.pictures.style import SERIES, specification, theme

STYLES = {label: (card.colour, card.marker) for label, card in cards().items()}
DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
PROTANOPIA = np.array(
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
)
"""G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, IEEE Trans. Vis. Comput. Graph. 15:1291, 2009, severity 1."""
OTHER_SCRIPTS = ["方法", "метод", "طريقة", "μέθοδος", "שיטה", "_hidden", "a$b^{c", "x" * 60, "x" * 59 + "y", "két szó"]


def lab(colour: str, seen: np.ndarray) -> np.ndarray:
    """CIE L*a*b* (D65) of a colour as it is seen."""
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(seen @ linear, 0.0, 1.0)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    t = xyz / [0.9505, 1.0, 1.089]
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_every_method_with_a_title_has_a_colour_and_a_marker_of_its_own() -> None:
    assert set(REFERENCE_CARDS) < set(STYLES)
    assert all(card.title and card.colour and card.marker for card in cards().values())
    assert len({colour for colour, _ in STYLES.values()}) == len(STYLES)
    assert len({marker for _, marker in STYLES.values()}) == len(STYLES)
    assert not {colour for colour, _ in STYLES.values()} & set(MORE_COLOURS)
    assert not {marker for _, marker in STYLES.values()} & set(MORE_MARKERS)


@pytest.mark.parametrize("seen", [np.eye(3), DEUTERANOPIA, PROTANOPIA], ids=["usual", "deuteranopia", "protanopia"])
def test_methods_that_lie_on_each_other_differ_in_colour(seen: np.ndarray) -> None:
    """A difference of 10 in L*a*b* is seen at a glance."""
    on_the_bound = ("oracle", "shooting", "mcmc", "pinn", "pinn_adam", "collocation", "output_error", "nuts")
    for a, b in itertools.combinations(on_the_bound, 2):
        assert np.linalg.norm(lab(STYLES[a][0], seen) - lab(STYLES[b][0], seen)) > 10.0, (a, b)


def test_unknown_methods_look_different_and_keep_their_look() -> None:
    names = [f"somebody's {i}" for i in range(60)]
    found = looks([*names, *STYLES])
    assert len({(look.colour, look.marker) for look in found.values()}) == 60 + len(STYLES)
    alone = looks(["somebody's 7"])["somebody's 7"]
    assert alone == looks(["shooting", "somebody's 7", "pinn"])["somebody's 7"]


def test_names_in_any_script_can_be_drawn_and_told_apart() -> None:
    titles = [look.title for look in looks(OTHER_SCRIPTS).values()]
    assert len(set(titles)) == len(OTHER_SCRIPTS)
    assert drawable("метод") == "метод"
    assert drawable("方法") == r"\u65b9\u6cd5"
    assert drawable("a$b") == r"a\$b"
    assert drawable("a\nb\t") == "a b"
    assert max(map(len, titles)) < 40


def test_titles_are_broken_at_words() -> None:
    title = "Output error, one cold start"
    assert wrapped(title, 30.0).replace("\n", " ") == title
    assert len(wrapped(title, 30.0).splitlines()) == 2
    assert wrapped(title, 60.0) == title
    for line in wrapped("one_very_long_word_of_somebody and", 20.0).splitlines():
        assert width_of(line) <= 20.0


def shown_texts(figure: Any) -> list[tuple[str, float, Any]]:
    """What can be read outside the panels, and inside: text, size, and extent in pixels."""
    figure.canvas.draw()
    texts = [text for axis in figure.axes for text in (*axis.texts, axis._left_title, axis.title)]
    for axis in figure.axes:
        for own, visible in ((axis.xaxis, "bottom"), (axis.yaxis, "left")):
            texts.append(own.label)
            low, high = sorted(own.get_view_interval())
            ticks = [t for t in (*own.get_major_ticks(), *own.get_minor_ticks()) if low <= t.get_loc() <= high]
            texts += [t.label1 for t in ticks if t.label1.get_visible() and visible]
    texts += [text for legend in figure.legends for text in legend.get_texts()]
    texts += [figure._supylabel] if figure._supylabel is not None else []
    return [(t.get_text(), t.get_fontsize(), t.get_window_extent()) for t in texts if t.get_visible() and t.get_text()]


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Gallery:
    """All known methods and ten strange ones, with failures of every kind, one of two masses, and a family."""
    store = Store(tmp_path_factory.mktemp("full") / "rows")
    store.prepare()
    fill(store, [*STYLES, *OTHER_SCRIPTS], (40.0, 20.0, 5.0), ("unknown",), n=20)
    fill(store, [*STYLES, *OTHER_SCRIPTS], (20.0,), ("known",), n=20)
    for i, status in enumerate(Status):
        rows = [Row(0, Status.OK, scores=scored("x", 1)[0].scores), *(Row(j, status) for j in range(1, 40))]
        save(store, described(list(STYLES)[i], 10.0, n=40, duration=5.0), rows)
    rows, arrays = scored("two", 3), recorded(scored("two", 3), True, False)
    pair = {name: np.tile(arrays[name], (2, 1)) for name in ("true_displacement", "displacement", "displacement_sd")}
    samples = {name: np.tile(arrays[name], 2) for name in ("sample_times", "sample_values")}
    arrays = {**arrays, **pair, **samples, "sample_dof": np.repeat([0, 1], 25)}
    chain = {"initial": [[1.0, 0.0], [0.0, 0.0]], "options": {"n": 2}}
    save(store, described("pinn", n=3, **chain), rows, arrays)
    fill_family(store)
    return Gallery(store)


@pytest.fixture(scope="module")
def drawn(full: Gallery) -> Callable[[str], Picture]:
    """The picture of a name, drawn once."""
    return cache(lambda name: PICTURES[name](full))


CHARTS = [name for name, draw in PICTURES.items() if draw.__module__.startswith("bench.reporting.pictures")]
FIGURES = [name for name in PICTURES if name not in CHARTS]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", FIGURES)
def test_of_thirty_methods_every_letter_can_be_read(name: str, drawn: Callable[[str], Picture]) -> None:
    """No text under 7 points at the size of print, none on another, none outside the page."""
    figure = drawn(name).figure
    width = figure.get_size_inches()[0]
    assert width <= FULL + 1e-9
    assert any(abs(width - wanted) < 1e-9 for wanted in (FULL, HALF)) or HALF < width < FULL
    texts = shown_texts(figure)
    assert min(size for _, size, _ in texts) >= 7.0
    page = figure.bbox
    for text, _, box in texts:
        assert box.x0 > page.x0 - 1, text
        assert box.x1 < page.x1 + 1, text
        assert box.y0 > page.y0 - 1, text
        assert box.y1 < page.y1 + 1, text
    for (a, _, one), (b, _, other) in itertools.combinations(texts, 2):
        wide = min(one.x1, other.x1) - max(one.x0, other.x0)
        high = min(one.y1, other.y1) - max(one.y0, other.y0)
        assert wide < 1.5 or high < 1.5, (a, b)


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_has_a_unit(name: str, drawn: Callable[[str], Picture]) -> None:
    """In its own label, that of the axis it shares, or the title over it; names of methods need none."""
    figure = drawn(name).figure
    below = [axis.get_xlabel() for axis in figure.axes if axis.get_xlabel()]
    beside = [axis.get_ylabel() for axis in figure.axes] + [figure.get_supylabel()]
    beside = [label for label in beside if label]
    assert below
    assert beside
    assert all("(" in label for label in (*below, *beside))


@pytest.mark.parametrize(("name", "dark"), [*((name, False) for name in CHARTS), ("accuracy_against_time", True)])
def test_a_chart_can_be_read_at_its_size(name: str, dark: bool, drawn: Callable[[str], Picture]) -> None:
    """A page wide, or half; no text under 7 points, none on another, all in the colour that stands out."""
    picture = drawn(name)
    width = HALF_CHART if picture.half else FULL_CHART
    spec = specification(picture.figure, width, dark)
    scene = vl_convert.vegalite_to_scenegraph(spec)
    assert abs(scene["width"] - width) <= 3.0
    texts = list(texts_of(scene["scenegraph"], scene["origin"][0], scene["origin"][1]))
    assert texts
    assert min(size for _, size, _, _ in texts) >= 7.0
    assert {colour for *_, colour in texts} <= {theme(dark)["text"]["color"], *SERIES}
    for text, _, (left, _, right, _), _ in texts:
        assert left > -2.0, text
        assert right < scene["width"] + 2.0, text
    for (a, _, first, _), (b, _, second, _) in itertools.combinations(texts, 2):
        wide = min(first[2], second[2]) - max(first[0], second[0])
        high = min(first[3], second[3]) - max(first[1], second[1])
        assert wide < 1.0 or high < 1.0, (a, b)


def texts_of(item: Any, x: float, y: float) -> Iterator[tuple[str, float, tuple[float, float, float, float], str]]:
    """Texts below an item of a scene graph: text, size, extent in points and colour."""
    for child in item.get("items", ()):
        if "text" in child and child.get("opacity", 1) > 0 and child["text"] not in ("", None):
            lines = child["text"] if isinstance(child["text"], list) else str(child["text"]).split("\n")
            size = child["fontSize"]
            wide = max(width_of(str(line), size) for line in lines) * 72.0 / 25.4
            high = size * (1.0 + 1.2 * (len(lines) - 1))
            left = {"right": -wide, "center": -wide / 2.0}.get(child.get("align", "left"), 0.0)
            top = {"middle": -0.5, "top": 0.0, "line-top": 0.0}.get(child.get("baseline", "alphabetic"), -0.8) * high
            at = x + child.get("x", 0.0) + child.get("dx", 0.0), y + child.get("y", 0.0) + child.get("dy", 0.0)
            box = (at[0] + left, at[1] + top, at[0] + left + wide, at[1] + top + 0.9 * high)
            if child.get("angle", 0) in (-90, 270):
                box = (at[0] + top, at[1] - left - wide, at[0] + top + 0.9 * high, at[1] - left)
            yield " ".join(map(str, lines)), size, box, child["fill"]
        yield from texts_of(child, x + child.get("x", 0.0), y + child.get("y", 0.0))


@pytest.mark.parametrize("name", [name for name in CHARTS if name != "failures"])
def test_every_axis_of_a_chart_has_a_unit(name: str, drawn: Callable[[str], Picture]) -> None:
    """In its own title or in that of the picture; names of methods need none."""
    with alt.data_transformers.enable("default", max_rows=None):
        spec = drawn(name).figure.to_dict(validate=False) | {"datasets": {}}
    titles = re.findall(r'"(?:title|text)": "([^"]+)"', json.dumps(spec))
    assert any("(" in title for title in titles)


SENTENCE = 140
"""Letters of a caption's first sentence: two lines beside a picture."""


@pytest.mark.parametrize("name", PICTURES)
def test_a_caption_begins_with_one_short_sentence(name: str, drawn: Callable[[str], Picture]) -> None:
    """As the page takes it apart; what follows explains."""
    first, rest = first_sentence(drawn(name).caption)
    assert first.endswith(".")
    assert len(first) <= SENTENCE
    assert rest


@pytest.mark.parametrize("name", FIGURES)
def test_no_legend_has_more_than_six_entries_and_no_panel_is_empty(name: str, drawn: Callable[[str], Picture]) -> None:
    """But where the entries are few in all that is stored, or are the letters of a table."""
    figure = drawn(name).figure
    entries = [
        len(legend.get_texts()) for legend in (*figure.legends, *(axis.get_legend() for axis in figure.axes)) if legend
    ]
    assert all(n <= 6 for n in entries)
    for axis in figure.axes:
        assert axis.lines or axis.collections or axis.images or axis.patches


def test_only_names_that_are_drawn_are_explained(full: Gallery, tmp_path: Path) -> None:
    write_picture(full, "record", tmp_path)
    assert "stands for" not in caption_of(tmp_path / "record.png")
    write_picture(full, "error_against_noise", tmp_path)
    assert "\\u65b9\\u6cd5 stands for 方法." in caption_of(tmp_path / "error_against_noise.png")
