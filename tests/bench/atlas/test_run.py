"""The blocks of the atlas: computed once, found again, and a fit that goes wrong has failed."""

import io
from dataclasses import dataclass, replace

import numpy as np
import pytest

from bench import Card, Estimate, Identifier
from bench.atlas.point import FreeDecay
from bench.atlas.run import PointBlock, fit_point, read_block
from bench.commands.main import main
from bench.config.atlas import SAMPLED, atlas_blocks, atlas_content, atlas_methods, part_names
from bench.engine.pool import Limits, run_tasks
from bench.entrants.registry import make_method
from bench.store.results import result_path

EASY = FreeDecay(100, 10.0, 0.05, 40.0, 0.4, False)
BLOCK = PointBlock([EASY, replace(EASY, snr_db=30.0)], "matrix_pencil", {}, 10, 1, "matrix_pencil")


@dataclass(frozen=True)
class Raising(Identifier):
    card = Card("s", "not used", "groups", "simulated", "u", "d")

    def estimate(self, problem, rng) -> Estimate:
        raise RuntimeError("made to fail")


def test_a_block_is_computed_once_and_found_again(tmp_path) -> None:
    assert run_tasks([BLOCK], tmp_path, Limits(), ("fit", "block")) == {}
    written = result_path(tmp_path, BLOCK.key).stat().st_mtime_ns
    assert run_tasks([BLOCK], tmp_path, Limits(), ("fit", "block")) == {}
    assert result_path(tmp_path, BLOCK.key).stat().st_mtime_ns == written
    statistics = read_block(tmp_path, BLOCK)
    assert [at.fits for at in statistics] == [10, 10]
    assert statistics[0].values[0, 0] < 5  # a bias in units of the bound
    assert read_block(tmp_path, replace(BLOCK, seed=2)) is None


def test_a_method_that_raises_has_failed_fits() -> None:
    found = fit_point(BLOCK, Raising(), EASY)
    assert found.failed == 1.0
    assert np.all(found.values[:, 4] == 1.0)


def test_near_the_bound_a_good_method_has_an_error_of_about_one() -> None:
    found = fit_point(replace(BLOCK, replicates=40), make_method("output_error", {}), EASY)
    assert found.values[0, 1] == pytest.approx(1.0, abs=0.35)
    assert found.values[0, 5] > 0.8
    assert found.values[2, 2] == pytest.approx(1.0, abs=0.35)


def test_every_method_of_the_atlas_can_be_made_and_every_part_is_planned() -> None:
    tasks = atlas_blocks(SAMPLED)
    assert {task.label for task in tasks} == set(atlas_methods())
    for part in part_names():
        fits = [block.size for block in atlas_blocks(part) if block.label == "output_error"]
        assert sum(fits) >= 400 * 50, part
    assert atlas_content()["points"] * len(atlas_methods()) > len(tasks)


@pytest.mark.slow
def test_a_slice_is_drawn_from_its_first_row_on(tmp_path) -> None:
    given = ["part=cycles_snr", "method=frequency", "points=3", f"store={tmp_path / 'store'}", f"out={tmp_path}"]
    assert main(["-m", "experiment=atlas", *given, "workers=1"]) == 0
    assert (tmp_path / "figures" / "atlas_cycles_snr.png").exists()


@pytest.mark.slow
def test_a_launcher_computes_the_blocks_that_this_machine_does_and_writes_the_atlas(tmp_path) -> None:
    given = ["-m", "experiment=atlas", "part=points", "method=log_decrement", "points=32"]
    here, there = tmp_path / "here", tmp_path / "there"
    assert main([*given, f"store={here}", f"out={tmp_path / 'out'}", "workers=1"]) == 0
    assert main([*given, f"store={there}", f"out={tmp_path / 'out2'}", "hydra/launcher=basic"]) == 0
    for path in here.glob("*.result"):
        ours, theirs = (np.load(io.BytesIO((folder / path.name).read_bytes())) for folder in (here, there))
        assert np.array_equal(np.delete(ours, 2, 1), np.delete(theirs, 2, 1), equal_nan=True)  # all but the seconds
    assert len(list(there.glob("*.result"))) == 2
    assert not (there / "launches").exists()
    assert (tmp_path / "out2" / "atlas.md").exists()
