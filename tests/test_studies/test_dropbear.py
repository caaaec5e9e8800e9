"""The study of the moving support: on a made record with known frequencies, and on the real one where it is."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bench.reporting.pictures.png import KEYWORD
from tests.studies.dropbear import REFERENCE, caption, draw, followed, main, read, stays

PLACES = [os.environ.get("BENCH_SHARED_DATA"), Path(__file__).parents[2].parent / "shared" / "data"]
FOLDERS = [Path(place) / "dropbear_slow" for place in PLACES if place]


def test_a_folder_without_the_record_is_said(tmp_path, capsys) -> None:
    assert main([f"data={tmp_path}"]) == 2
    assert "ten_steps.txt" in capsys.readouterr().err


@pytest.mark.slow
def test_stays_and_frequencies_of_a_made_record(tmp_path) -> None:
    """A hit at each of the six places, and the decay of that place's frequency behind it, at 5 kHz."""
    rng, rows = np.random.default_rng(0), [(1.23, 26.9), *REFERENCE.items()]
    t = np.arange(6000) / 5000.0
    parts = [np.exp(-1.2 * t) * np.sin(2 * np.pi * f * t) + 0.004 * rng.standard_normal(t.size) for _, f in rows]
    low = np.concatenate([0.1 * part for part in parts])
    place = np.concatenate([np.full(t.size, v) + 1e-4 * rng.standard_normal(t.size) for v, _ in rows])
    columns = np.stack([low, low, place, np.arange(low.size) / 5000.0], axis=1)
    lines = ["header"] * 9 + ["\t".join(f"{value:.6e}" for value in row) for row in columns]
    (tmp_path / "ten_steps.txt").write_text("\n".join(lines))
    record = read(tmp_path)
    found, sds = followed(record)
    told = stays(record)
    assert [stay.place for stay in told[-6:]] == list(REFERENCE)
    for stay in told[-6:]:
        late = stay.samples[stay.samples.size // 2 :]
        assert np.nanmedian(found[late]) == pytest.approx(stay.reference, rel=0.01)
        assert np.nanmin(sds[late]) > 0
    draw(record, found, sds, tmp_path / "figures")
    with Image.open(tmp_path / "figures" / "online_dropbear.png") as picture:
        assert picture.info[KEYWORD] == caption(record, found)
    assert caption(record, np.full(found.shape, 1.5) * found).startswith(
        "The tracker follows the moving support to within 5"
    )


@pytest.mark.skipif(not any((f / "ten_steps.txt").is_file() for f in FOLDERS), reason="the record is not there")
@pytest.mark.slow
def test_on_the_record_the_tracker_is_near_each_stays_own_spectrum() -> None:
    record = read(next(f for f in FOLDERS if (f / "ten_steps.txt").is_file()))
    found, _ = followed(record)
    off = []
    for stay in stays(record)[1:]:
        late = stay.samples[stay.samples.size // 2 :]
        off.append(abs(np.nanmedian(found[late]) / stay.reference - 1))
    assert sorted(off)[len(off) // 2] < 0.012
