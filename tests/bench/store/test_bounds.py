"""Bounds on disk: computed once, read by whoever asks again, named by all that they depend on."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from bench.errors import InputError
from bench.information.fisher import compute_bound
from bench.isolation.limits import limited
from bench.scenario.scenario import ForceSpec, PriorSpec, Scenario
from bench.store import bounds as bound_module
from bench.store.bounds import Replicates, bound_identity, load_bounds
from bench.store.seal import sealed
from bench.store.store import BOUND_FORMAT

SDOF_TRUE = {"m": 1.0, "c": 0.4, "k": 8.0}
SDOF_FREE = Scenario("sdof", SDOF_TRUE, ((1.0,), (0.0,)), 20.0)
MULTISINE = ForceSpec(1.0, 0.1, 1.0, tones=5, samples=41)
NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})


def test_a_bound_is_computed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    linear = replace(SDOF_FREE, dense=25, forecast=0.5)
    assert load_bounds([Replicates(linear), Replicates(linear, 1)], tmp_path) == [compute_bound(linear)] * 2
    assert [path.suffix for path in tmp_path.iterdir()] == [".bound"]
    monkeypatch.setattr(bound_module, "compute_bound", None)
    assert load_bounds([Replicates(linear, 5)], tmp_path)[0].names == ("m", "c", "k")


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that not even root can write")
def test_a_bound_that_cannot_be_written_is_one_line() -> None:
    with pytest.raises(InputError, match="store=/proc/self: the bounds cannot be written") as caught:
        load_bounds([Replicates(SDOF_FREE)], Path("/proc/self"))
    assert len(str(caught.value).splitlines()) == 1


def test_a_bound_is_shared_where_nothing_that_it_depends_on_differs() -> None:
    scenario = replace(SDOF_FREE, prior=NOMINAL)
    assert bound_identity(Replicates(scenario, 0)) == bound_identity(Replicates(replace(scenario, label="other"), 1))
    different = [
        replace(scenario, snr_db=21.0),
        replace(scenario, initial_state="unknown"),
        replace(scenario, prior=None),
        replace(scenario, samples=26),
        replace(scenario, parameters={**SDOF_TRUE, "m": 1.1}),
        replace(scenario, dense=500),
        replace(scenario, forecast=5.0),
    ]
    assert len({bound_identity(Replicates(s, 0)) for s in [scenario, *different]}) == 1 + len(different)
    forced = replace(scenario, force=MULTISINE)
    assert bound_identity(Replicates(forced, 0)) != bound_identity(Replicates(forced, 1))


BARE = json.dumps(asdict(compute_bound(replace(SDOF_FREE, snr_db=30.0))))


@pytest.mark.parametrize(
    "content",
    [
        b'{"names": ["m"',
        BARE.encode(),
        None,
        sealed(BOUND_FORMAT, '{"names": ["m"]}'),
        sealed(BOUND_FORMAT, "[" * 10**5),
    ],
    ids=["cut", "without a checksum", "a pipe", "another shape", "nested"],
)
def test_a_bound_that_is_not_whole_is_computed_anew(tmp_path: Path, content: bytes | None) -> None:
    """Where its number would have been believed, it would have been that of another noise level; no pipe is awaited."""
    path = tmp_path / f"{bound_identity(Replicates(SDOF_FREE, 0))}.bound"
    os.mkfifo(path) if content is None else path.write_bytes(content)
    with limited(60.0):
        assert load_bounds([Replicates(SDOF_FREE)], tmp_path) == [compute_bound(SDOF_FREE)]
    assert path.is_fifo() or path.read_bytes() != content
