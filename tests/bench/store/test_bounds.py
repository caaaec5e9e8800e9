"""Bounds on disk: computed once, read by whoever asks again, named by all that they depend on."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

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
DUFFING_FREE = Scenario("duffing", {**SDOF_TRUE, "k3": 5.0}, ((1.0,), (0.0,)), 20.0, 4.0, samples=40)
MULTISINE = ForceSpec(1.0, 0.1, 1.0, tones=5, samples=41)
NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})


SCRIPT = """if __name__ == "__main__":
    import sys
    from dataclasses import replace
    from pathlib import Path
    from bench.store.bounds import Replicates, load_bounds
    from bench.scenario.scenario import Scenario
    linear = Scenario("sdof", {"m": 1.0, "c": 0.4, "k": 8.0}, ((1.0,), (0.0,)), 20.0, dense=25, forecast=0.5)
    other = replace(linear, system="duffing", parameters={**linear.parameters, "k3": 5.0})
    print(repr(load_bounds([Replicates(linear), Replicates(linear, 1), Replicates(other)], Path(sys.argv[1]))))
    assert "jax" not in sys.modules, "jax is here"
"""


def test_bounds_are_computed_without_jax_here_and_then_read(
    tmp_path: Path, python: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """jax stays out of the process that asks; whoever asks again finds the bound and computes nothing."""
    (tmp_path / "ask.py").write_text(SCRIPT)
    asked = python(str(tmp_path / "ask.py"), str(tmp_path / "cache"))
    assert asked.returncode == 0, asked.stderr
    assert [path.suffix for path in (tmp_path / "cache").iterdir()] == [".bound", ".bound"]
    linear = replace(SDOF_FREE, dense=25, forecast=0.5)
    other = replace(linear, system="duffing", parameters=DUFFING_FREE.parameters)
    expected = [compute_bound(linear), compute_bound(other)]
    for name in ("multiprocessing", "compute_bound"):
        monkeypatch.setattr(bound_module, name, None)
    assert load_bounds([Replicates(linear, 5), Replicates(other, 5)], tmp_path / "cache") == expected
    assert asked.stdout.strip() == repr([expected[0], expected[0], expected[1]])


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that not even root can write")
@pytest.mark.parametrize("scenario", [SDOF_FREE, DUFFING_FREE], ids=["here", "in its own process"])
def test_a_bound_that_cannot_be_written_is_said_in_one_line(scenario: Scenario) -> None:
    with pytest.raises(InputError, match="store=/proc/self: the bounds cannot be written") as caught:
        load_bounds([Replicates(scenario)], Path("/proc/self"))
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
        b"",
        b'{"names": ["m"',
        BARE.encode(),
        sealed(BOUND_FORMAT, '{"names": ["m"]}'),
        sealed(BOUND_FORMAT, "[" * 10**5),
    ],
    ids=["empty", "cut", "without a checksum", "another shape", "nested"],
)
def test_a_bound_that_is_not_whole_is_computed_anew(tmp_path: Path, content: bytes) -> None:
    """Where its number would have been believed, it would have been that of another noise level."""
    path = tmp_path / f"{bound_identity(Replicates(SDOF_FREE, 0))}.bound"
    path.write_bytes(content)
    assert load_bounds([Replicates(SDOF_FREE)], tmp_path) == [compute_bound(SDOF_FREE)]
    assert path.read_bytes() != content


def test_a_pipe_in_the_place_of_a_bound_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / f"{bound_identity(Replicates(SDOF_FREE, 0))}.bound")
    with limited(60.0):
        assert load_bounds([Replicates(SDOF_FREE)], tmp_path) == [compute_bound(SDOF_FREE)]
