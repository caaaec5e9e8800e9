"""The study of the moving support: on a made record with known frequencies, and on the real one where it is."""

import numpy as np
import pytest
from PIL import Image

from bench.reporting.pictures.png import KEYWORD
from tests.studies.dropbear import REFERENCE, caption, draw, followed, read, stays


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
