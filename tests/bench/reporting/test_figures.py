"""The command of the pictures: what it draws from what store, the same each time, and bad input in one line."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import REPOSITORY, Python
from stored import described, fill, save, scored

from bench.commands.main import main
from bench.reporting.figures.pictures import PICTURES
from bench.reporting.figures.png import MOST_BYTES, RESOLUTIONS, caption_of, packed, png_file
from bench.reporting.labels import cards
from bench.store.store import Store

pytest.importorskip("vl_convert")
ALONE = {
    "record", "reconstruction", "training_loss", "scatter", "basin", "band", "error_against_noise",
    "forest", "coverage", "accuracy_against_time",
}  # fmt: skip
"""What a method alone gives on one mass that never failed: no comparison, no failure, no second mass."""


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Two methods at three noise levels, as if they had run."""
    store = Store(tmp_path / "rows")
    store.prepare()
    fill(store, ["shooting", "somebody's"], (40.0, 20.0, 10.0))
    return store


def pictures(out: Path) -> set[str]:
    return {path.stem for path in out.glob("*.png")}


def test_every_picture_is_the_same_each_time_and_has_a_caption(store: Store, tmp_path: Path, python: Python) -> None:
    out, again = tmp_path / "out", tmp_path / "again"
    assert main(["tables", "what=figures", f"store={store.folder}", f"out={out}"]) == 0
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    assert pictures(out) == {*ALONE, "profiles"}
    assert set(first) == {f"{name}.png" for name in pictures(out)}
    for path in out.iterdir():
        caption = caption_of(path)
        assert caption.endswith(".")
        assert len(caption.splitlines()) == 1
        assert "nan" not in caption
    done = python(
        "-m", "bench", "tables", "what=figures", f"store={store.folder}", f"out={again}", env={"PYTHONHASHSEED": "7"}
    )
    assert done.returncode == 0, done.stderr
    assert {path.name: path.read_bytes() for path in again.iterdir()} == first


def test_pictures_are_drawn_as_svg_where_a_folder_is_named(store: Store, tmp_path: Path) -> None:
    out, svg = tmp_path / "out", tmp_path / "svg"
    assert main(["tables", "what=figures", f"store={store.folder}", f"out={out}", f"svg={svg}"]) == 0
    assert {path.name for path in svg.glob("*.svg")} == {f"{name}.svg" for name in pictures(out)}
    assert all(ElementTree.parse(path).getroot().tag.endswith("svg") for path in svg.glob("*.svg"))
    specification = json.loads((svg / "forest.vl.json").read_text())
    assert specification["description"] == caption_of(out / "forest.png")
    assert specification["config"]["background"] == "#ffffff"


def test_a_picture_too_large_for_its_file_is_drawn_with_fewer_pixels() -> None:
    """Noise cannot be packed."""
    from PIL import Image

    from bench.reporting.figures.style import pyplot

    figure = pyplot().figure(figsize=(4.0, 3.0))
    figure.figimage(np.random.default_rng(0).uniform(size=(900, 1200)), resize=False)
    with Image.open(io.BytesIO(png_file(figure, "Noise: 5 µm."))) as image:
        assert image.size == (4 * RESOLUTIONS[-1], 3 * RESOLUTIONS[-1])
        assert image.info["dpi"] == pytest.approx((RESOLUTIONS[-1], RESOLUTIONS[-1]), abs=0.1)
        assert image.info["Description"] == "Noise: 5 µm."


def test_the_palette_keeps_the_colours_of_thin_lines() -> None:
    """Thirty lines, each of them a small part of a picture with all shades of grey."""
    from PIL import Image, ImageColor, ImageDraw

    colours = [card.colour for card in cards().values() if card.colour][:30]
    image = Image.new("RGB", (1378, 1200), "white")
    draw = ImageDraw.Draw(image)
    for grey in range(0, 256, 2):
        draw.rectangle((5 * grey, 1100, 5 * grey + 10, 1200), fill=(grey, grey, grey))
    for i, colour in enumerate(colours):
        draw.rectangle((100, 30 * i + 10, 300, 30 * i + 13), fill=colour)
    with Image.open(io.BytesIO(packed(image, 200, ""))) as small:
        drawn = small.convert("RGB")
    for i, colour in enumerate(colours):
        seen = drawn.getpixel((200, 30 * i + 12))
        assert isinstance(seen, tuple)
        assert max(abs(a - b) for a, b in zip(seen, ImageColor.getrgb(colour), strict=True)) <= 16, (colour, seen)


@pytest.mark.parametrize("path", sorted((REPOSITORY / "results" / "figures").iterdir()), ids=lambda path: path.name)
def test_a_published_picture_is_small_and_has_a_caption(path: Path) -> None:
    assert path.suffix == ".png"
    assert path.stat().st_size <= MOST_BYTES
    assert caption_of(path).endswith(".")


def test_a_store_of_one_method_gives_all_but_comparisons(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(tmp_path / "rows")
    store.prepare()
    fill(store, ["pinn"])
    assert main(["tables", "what=figures", f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 0
    assert pictures(tmp_path / "out") == ALONE
    missing = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1] for line in missing] == [name for name in PICTURES if name not in ALONE]


def test_a_store_without_arrays_still_gives_what_rows_determine(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows")
    store.prepare()
    save(store, described("shooting"), scored("shooting", 30))
    assert main(["tables", "what=figures", f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 0
    assert pictures(tmp_path / "out") == {
        "scatter", "error_against_noise", "forest", "coverage", "accuracy_against_time"
    }  # fmt: skip


@pytest.mark.parametrize("bad", [["store=nowhere"], ["stor=x"], ["out="]])
def test_bad_input_is_one_line(
    bad: list[str], store: Store, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["tables", "what=figures", *bad, *([f"store={tmp_path}"] if bad == ["out="] else [])]) == 2
    assert_one_line(capsys)


def test_an_empty_store_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Store(tmp_path / "rows").prepare()
    assert main(["tables", "what=figures", f"store={tmp_path / 'rows'}", f"out={tmp_path / 'out'}"]) == 2
    assert_one_line(capsys)
    assert not (tmp_path / "out").exists()


def test_a_damaged_cell_is_one_line(store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = store.path(store.identities()[0])
    path.write_text(path.read_text()[:1000])
    assert main(["tables", "what=figures", f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 2
    assert_one_line(capsys)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_one_line(
    store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    assert main(["tables", "what=figures", f"store={store.folder}", f"out={tmp_path / 'locked' / 'out'}"]) == 2
    assert_one_line(capsys)


def assert_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    err = capsys.readouterr().err
    assert err.startswith("bench: ")
    assert len(err.splitlines()) == 1
