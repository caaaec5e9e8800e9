"""The model of the atlas, on an atlas whose rule is known."""

import numpy as np
import pandas as pd
import pytest

from bench.atlas.design import Slice, sobol
from bench.atlas.model import AtlasModel, cross_validate, determined, unknown
from bench.atlas.point import FreeDecay
from bench.commands.main import main
from bench.reporting.atlas import point_frame

pytest.importorskip("sklearn")
pytest.importorskip("vl_convert")

from bench.reporting.pictures.maps import draw_atlas

SPREAD = 0.1


def atlas(number: int = 512) -> pd.DataFrame:
    """Below 10 dB a third of the fits is gross; the log excess rises with the logarithm of the samples."""
    rng = np.random.default_rng(4)
    lines = [
        {"samples": p.samples, "cycles": p.cycles, "damping_ratio": p.damping_ratio, "snr_db": p.snr_db,
         "phase": p.phase, "start_known": p.start_known, "aliased": p.aliased, "wrong_basin": 0.0}
        for p in sobol(FreeDecay, number, 3)
    ]  # fmt: skip
    frame = pd.DataFrame(lines)
    frame["bound_k_over_m"], frame["bound_c_over_m"], frame["bound_displacement"] = 0.01, 0.5, 1.0
    frame["method"], frame["fits"], frame["seconds"] = "output_error", 50.0, 0.01
    frame["k_over_m_core"] = np.exp(rule(frame) + SPREAD * rng.standard_normal(number))
    frame["k_over_m_gross"] = rng.binomial(50, np.where(frame.snr_db < 10.0, 1 / 3, 0.02)) / 50
    return frame


@pytest.fixture(scope="module")
def model() -> AtlasModel:
    return AtlasModel(atlas(), "k_over_m")


def rule(frame: pd.DataFrame) -> np.ndarray:
    return np.asarray(0.5 * (np.log10(frame.samples.to_numpy(float)) - 1.0))


@pytest.mark.slow
def test_points_that_were_left_out_are_predicted_to_what_is_random_in_them() -> None:
    found = cross_validate(atlas(), "k_over_m")
    assert found.error < 0.095  # 0.6745 times the spread is the least there can be
    assert 0.65 < found.within < 0.9
    assert found.calibration < 0.05
    assert found.points == len(determined(atlas(), "k_over_m"))


def test_the_model_knows_the_rule(model: AtlasModel) -> None:
    frame = atlas()
    few, many = (model.expected(frame[frame.samples.between(*size)]) for size in ((8, 16), (250, 500)))
    assert np.median([one.excess[1] for one in few]) == pytest.approx(np.exp(0.5 * 0.05), abs=0.1)
    assert np.median([one.excess[1] for one in many]) == pytest.approx(np.exp(0.5 * 1.55), abs=0.25)
    noisy, quiet = (model.expected(frame[frame.snr_db.between(*size)]) for size in ((-5, 5), (20, 60)))
    assert np.mean([one.gross for one in noisy]) == pytest.approx(1 / 3, abs=0.07)
    assert np.mean([one.gross for one in quiet]) < 0.06


@pytest.mark.parametrize(
    ("point", "why"),
    [
        (FreeDecay(5, 2.0, 0.02, 20.0, 0.0, False), "outside the range of the atlas"),
        (FreeDecay(50, 40.0, 0.02, 20.0, 0.0, False), "half the sampling rate"),
        (FreeDecay(20, 0.5, 0.5, -5.0, 0.0, False), "not identifiable"),
        (FreeDecay(100, 5.0, 0.02, 40.0, 0.0, False), ""),
    ],
)
def test_it_says_where_it_does_not_know(point: FreeDecay, why: str) -> None:
    assert why in unknown(point_frame(point), "k_over_m")
    assert bool(why) == bool(unknown(point_frame(point), "k_over_m"))


def test_the_command_names_methods_and_refuses_what_it_cannot_read(tmp_path, capsys) -> None:
    path = tmp_path / "atlas.csv.gz"
    atlas().to_csv(path, index=False)
    test = ["samples=100", "cycles=5", "damping=0.02", "snr=40", f"atlas={path}"]
    assert main(["design", *test]) == 0
    assert "Output error" in capsys.readouterr().out
    assert main(["design", *test[:1], "cycles=90", *test[2:]]) == 0
    assert "does not cover" in capsys.readouterr().out
    for wrong, field in (
        ("samples=0", "samples"),
        ("initial_state=maybe", "initial_state"),
        ("snr=nan", "snr"),
        ("quantity=m", "quantity"),
    ):
        assert main(["design", *(one for one in test if one.partition("=")[0] != field), wrong]) == 2
        assert f"bench: {field}=" in capsys.readouterr().err
    assert main(["design", *test[:4], f"atlas={tmp_path}/none.csv"]) == 2
    assert "bench: atlas=" in capsys.readouterr().err


def test_a_map_has_the_states_of_its_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Near where the core error is within 1.2 bounds and at most 5 % are gross; by the rule that is at 23 samples."""
    frame = atlas()
    own = Slice("samples_snr", FreeDecay(50, 2.0, 0.05, 20.0, 0.5, False), "samples", "snr_db", (6, 5))
    drawn = draw_atlas(own, frame)
    shown = drawn.chart.vconcat[1].data
    assert (shown.state == "above Nyquist").sum() == frame.aliased.sum()
    good = (frame.k_over_m_core <= 1.2) & (frame.k_over_m_gross <= 0.05) & ~frame.aliased
    assert (shown.state == "error ≤ 1.2 × bound").sum() == good.sum()
    assert drawn.caption.startswith("Output error is within 1.2 times the bound on the largest part of this map")
    assert f", {100 * good.sum() / (~frame.aliased).sum():.0f} %." in drawn.caption
