"""The PINN's benchmark: its command line, the loss it shares with the rivals, and its page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bench.reporting.pictures.png import caption_of
from bench.scenario.scenario import Scenario
from tests.studies.pinn.__main__ import main
from tests.studies.pinn.common import Comparison
from tests.studies.pinn.scaling import chain, horizon, ratios

pytest.importorskip("torch")

from tests.studies.pinn import rivals


def test_the_rivals_loss_is_theirs() -> None:
    """The noted loss against the loss written out, with derivatives of the response by finite differences.

    A response that solves the equation, without noise: the sum of squares of the data misfit is all that is left.
    """
    found = rivals.descend(0, np.random.default_rng(0), 200, 1e-9)
    times, values = rivals.rivals_data(0)

    def misfit(theta: np.ndarray) -> np.ndarray:
        k, c, x0, v0 = theta
        return rivals.closed_form({"m": 1.0, "c": c, "k": k}, x0, v0, times) - values

    from scipy.optimize import least_squares

    exact = least_squares(misfit, [8.0, 0.4, 1.0, 0.0])
    hard = float(np.mean(exact.fun**2))  # the least loss of a response that solves the equation exactly
    assert 0.5 * hard < found.losses[-1] <= hard * (1 + 1e-6)
    assert found.k_over_m == pytest.approx(exact.x[0], rel=0.02)
    assert found.losses[-1] < 0.05 * found.losses[0]


def test_whole_fits_are_compared_with_whole_fits() -> None:
    """Ours is near the minimum after 0.1 s and ends after 0.5 s; a rival ends after 50 s, 2 % above, another within."""
    ours = rivals.Descent([0.05, 0.1, 0.5], [9.0, 1.005, 1.0], 8.0)
    found = [rivals.Rival("naive PyTorch", 50.0, 1.02), rivals.Rival("DeepXDE", 5.0, 1.001)]
    own, shipped, naive, other = rivals.lines([ours], [1.0], {"pinn": 2.0}, found)
    assert own[1:] == ["0.500", "0.100", "0.00", "100 ×", "10 ×"]
    assert shipped == ["method=pinn", "2.000", "-", "-", "25 ×", "2.5 ×"]
    assert naive[1:4] == ["50.00", "never reached", "2.0"]
    assert other[1:4] == ["5.00", "at the end, 1 of 1", "0.1"]


def test_growing_scenarios_are_what_they_say() -> None:
    cell = horizon(20)
    assert np.sqrt(cell.parameters["k"] / cell.parameters["m"]) * cell.duration / (2 * np.pi) == pytest.approx(20.0)
    assert cell.samples == 100
    assert isinstance(chain(3), Scenario)
    assert chain(3).make_system().n_dof == 3
    assert chain(3).samples == 245


def test_errors_of_groups_are_pooled_over_their_bounds() -> None:
    """Two groups at 2 and 4 bounds, the oracle's at 1 and 3: the root of 20 over the root of 10; displacement apart."""
    over_oracle, over_bound = np.array([5.0, 2.0, 4.0 / 3.0]), np.array([9.0, 2.0, 4.0])
    own = ratios(Comparison(["rmse", "a", "b"], over_oracle, over_bound, 0.1, 0))
    assert own.groups == pytest.approx(np.sqrt(2.0))
    assert own.displacement == 5.0


def point(method: str, size: int, seconds: float, ratio: float) -> dict[str, object]:
    return {"method": method, "size": size, "seconds": seconds, "ratio": ratio}


GROWTH = {
    "residuals": [point("pinn", 10, 1.0, 1.0), point("collocation", 10, 0.5, 1.0)],
    "masses": [point("pinn", 2, 4.0, 1.25), point("collocation", 2, 1.0, 1.0), point("shooting", 2, 0.5, 0.9)],
    "cycles": [point("pinn", 2, 6.0, 1.0), point("collocation", 2, 2.0, 1.0), point("shooting", 2, 1.5, 1234.0)],
}


def test_pictures_are_made_from_stored_parts_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pinn").mkdir()
    part = {"title": "scaling", "text": "", "columns": ["a"], "rows": [["b"]], "data": GROWTH}
    (tmp_path / "pinn" / "scaling.json").write_text(json.dumps(part), encoding="utf-8")
    assert main(["fit=false", f"out={tmp_path}"]) == 0
    written = capsys.readouterr().out.split()
    assert [Path(path).name for path in written] == ["pinn_scaling.png", "pinn.md"]
    text = (tmp_path / "pinn.md").read_text(encoding="utf-8")
    assert caption_of(tmp_path / "figures" / "pinn_scaling.png") in text
