"""The runs of the atlas: finished blocks are kept, damaged ones are not read, what goes wrong is a failed fit."""

import io
import os
import random
import secrets
import subprocess
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
import pytest

from bench import Card, Estimate, Identifier
from bench.atlas.cost import hours, progress
from bench.atlas.point import FreeDecay
from bench.atlas.run import Blocks, Task, at_point, run
from bench.commands.main import main
from bench.config.atlas import SAMPLED, atlas_content, atlas_methods, atlas_tasks, part_names
from bench.entrants.registry import make_method

EASY = FreeDecay(100, 10.0, 0.05, 40.0, 0.4, False)
TASK = Task([EASY, replace(EASY, snr_db=30.0)], "matrix_pencil", {}, 10, 1, "matrix_pencil")


@dataclass(frozen=True)
class Raising(Identifier):
    card = Card("s", "not used", "groups", "simulated", "u", "d")

    def estimate(self, problem, rng) -> Estimate:
        raise RuntimeError("made to fail")


def test_a_block_is_computed_once_and_found_again(tmp_path) -> None:
    blocks = Blocks(tmp_path)
    assert [error for _, error in run([TASK], blocks, 1)] == [""]
    assert list(run([TASK], blocks, 1)) == []
    found = blocks.get(TASK)
    assert found is not None
    assert [statistics.fits for statistics in found] == [10, 10]
    assert found[0].values[0, 0] < 5  # a bias in units of the bound
    assert blocks.get(replace(TASK, seed=2)) is None


def test_a_damaged_block_is_not_read(tmp_path) -> None:
    blocks = Blocks(tmp_path)
    (tmp_path / f"{TASK.key}.npy").write_bytes(b"\x93NUMPY")
    assert blocks.get(TASK) is None


def test_every_flipped_bit_of_a_block_is_noticed_and_the_block_computed_again(tmp_path) -> None:
    blocks, path = Blocks(tmp_path), tmp_path / f"{TASK.key}.npy"
    assert [error for _, error in run([TASK], blocks, 1)] == [""]
    whole = path.read_bytes()
    seed = secrets.randbits(32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    for at in rng.sample(range(8 * len(whole)), 400):
        path.write_bytes(whole[: at // 8] + bytes([whole[at // 8] ^ 1 << at % 8]) + whole[at // 8 + 1 :])
        assert blocks.get(TASK) is None, at
        assert not blocks.holds(TASK)
    assert [error for _, error in run([TASK], blocks, 1)] == [""]
    before, after = (np.delete(np.load(io.BytesIO(content)), 2, 1) for content in (whole, path.read_bytes()))
    assert np.array_equal(before, after, equal_nan=True)  # all but the seconds


def test_a_block_of_before_checksums_is_read_as_it_is(tmp_path) -> None:
    blocks = Blocks(tmp_path)
    statistics = [at_point(TASK, Raising(), point) for point in TASK.points]
    np.save(tmp_path / f"{TASK.key}.npy", np.stack([one.row() for one in statistics]))
    found = blocks.get(TASK)
    assert found is not None
    assert [one.row().tobytes() for one in found] == [one.row().tobytes() for one in statistics]


def test_a_block_that_is_cut_or_goes_on_is_not_read(tmp_path) -> None:
    blocks, path = Blocks(tmp_path), tmp_path / f"{TASK.key}.npy"
    blocks.add(TASK, [at_point(TASK, Raising(), point) for point in TASK.points])
    whole = path.read_bytes()
    for content in (b"", whole[:100], whole[:-1], whole + b"\0", whole + whole):
        path.write_bytes(content)
        assert blocks.get(TASK) is None
    path.unlink()
    os.mkfifo(path)
    assert not blocks.holds(TASK)


def test_a_method_that_raises_has_failed_fits() -> None:
    found = at_point(TASK, Raising(), EASY)
    assert found.failed == 1.0
    assert np.all(found.values[:, 4] == 1.0)


def test_near_the_bound_a_good_method_has_an_error_of_about_one() -> None:
    found = at_point(replace(TASK, replicates=40), make_method("output_error", {}), EASY)
    assert found.values[0, 1] == pytest.approx(1.0, abs=0.35)
    assert found.values[0, 5] > 0.8
    assert found.values[2, 2] == pytest.approx(1.0, abs=0.35)


def test_every_method_of_the_atlas_can_be_made_and_a_million_fits_are_planned() -> None:
    tasks = atlas_tasks(SAMPLED)
    assert {task.label for task in tasks} == set(atlas_methods())
    every = [task for part in part_names() for task in atlas_tasks(part)]
    assert sum(task.fits for task in every) >= 1_000_000
    assert atlas_content()["points"] * len(atlas_methods()) > len(tasks)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [("part=slices", "part=slices"), ("method=shoting", "did you mean shooting"), ("points=0", "points=0"),
     ("fit=maybe", "true or false"), ("snr=3", "snr"), ("shard=4/3", "3/10"), ("shard=2", "3/10")],
)  # fmt: skip
def test_a_mistype_is_one_line(arguments, said, capsys) -> None:
    assert main(["-m", "experiment=atlas", arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_the_command_writes_the_atlas_and_its_maps(tmp_path, capsys) -> None:
    given = [f"store={tmp_path / 'store'}", f"out={tmp_path / 'out'}"]
    assert main(["-m", "experiment=atlas", "part=points", "method=matrix_pencil", "points=2", *given]) == 0
    assert "2 points" in (tmp_path / "out" / "atlas.md").read_text()
    assert main(["-m", "experiment=atlas", "fit=false", f"store={tmp_path / 'none'}"]) == 2
    assert "finished blocks" in capsys.readouterr().err


def test_shards_are_all_of_the_blocks_and_none_twice(tmp_path) -> None:
    given = ["-m", "experiment=atlas", "part=points", "method=log_decrement", "points=64", f"store={tmp_path}"]
    for number in (1, 2, 3):
        assert main([*given, f"out={tmp_path / 'out'}", f"shard={number}/3", "workers=1"]) == 0
    assert len(list(tmp_path.glob("*.npy"))) == 4
    assert not (tmp_path / "out").exists()
    assert main([*given, "dry_run=true"]) == 0


def test_progress_and_hours_are_those_of_the_blocks(tmp_path) -> None:
    blocks = Blocks(tmp_path)
    tasks = [replace(TASK, seed=seed) for seed in range(4)]
    list(run(tasks[:3], blocks, 1))
    (line,) = progress(tasks, blocks)
    assert (line.done, line.blocks, line.fits_done, line.fits) == (3, 4, 60, 80)
    assert 0 < line.fit_s < 10
    assert hours(tasks, {TASK.label: 180.0}, 1) == pytest.approx(4.0)  # four blocks of 20 fits of three minutes
    assert hours(tasks, {TASK.label: 180.0}, 3) == pytest.approx(2.0)
    assert hours(tasks, {TASK.label: 180.0}, 100) == pytest.approx(1.0)


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on_where_it_was(tmp_path) -> None:
    """SIGKILL leaves whole blocks alone, and the rest is computed once."""
    arguments = ["part=points", "method=log_decrement", "points=128", f"store={tmp_path}", "workers=1", "shard=1/1"]
    command = [sys.executable, "-m", "bench", "-m", "experiment=atlas", f"out={tmp_path / 'out'}", *arguments]
    killed = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 120.0
    while len(list(tmp_path.glob("*.npy"))) < 3 and time.monotonic() < until:
        time.sleep(0.05)
    killed.kill()
    killed.wait()
    whole = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npy")}
    assert 3 <= len(whole) < 8
    assert subprocess.run(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL).returncode == 0
    assert len(list(tmp_path.glob("*.npy"))) == 8
    assert all(path.stat().st_mtime_ns == written for path, written in whole.items())
