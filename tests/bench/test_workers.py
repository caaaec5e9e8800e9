"""Processes that fit: whatever a fit does costs its own replicate only, and is recorded as what it was."""

from __future__ import annotations

import os
import pickle
from typing import Any

import numpy as np
import pytest
from misbehaving import FitByName

from bench import Problem, Status
from bench.scenario import Scenario
from bench.workers import Outcome, Task, perform

BAD = {
    "raise": (Status.CRASHED, "ValueError: two lines of reasons"),
    "exit": (Status.CRASHED, "exited with status 3"),
    "kill": (Status.KILLED, "SIGKILL"),
    "sleep": (Status.TIMEOUT, "limit of 3 s"),
    "memory": (Status.OOM, "out of memory"),
    "type": (Status.CRASHED, "Estimate objects were expected"),
    "nan": (Status.NONFINITE, "not finite"),
    "empty": (Status.NONFINITE, "not finite"),
    "unpicklable": (Status.INVALID, "cannot be pickled: this stays here"),
    "trap": (Status.INVALID, "unpickled"),
}


@pytest.fixture(scope="module")
def problem(reference: Scenario) -> Problem:
    return reference.replicates(0, 1)[0][0]


def a_task(problem: Problem, kinds: list[str], key: str = "task", timeout_s: float = 60.0) -> Task:
    rngs = tuple(np.random.default_rng(i) for i in range(len(kinds)))
    payloads = tuple((kind, problem) for kind in kinds)
    return Task(key, tuple(range(len(kinds))), FitByName(), payloads, rngs, timeout_s)


def outcomes(tasks: list[Task], workers: int = 1) -> dict[tuple[str, int], Outcome]:
    found: dict[tuple[str, int], Outcome] = {}
    for task, done in perform(tasks, workers):
        for outcome in done:
            assert (task.key, outcome.replicate) not in found, "answered twice"
            found[task.key, outcome.replicate] = outcome
    return found


def test_whatever_a_fit_does_is_its_own_status_and_the_good_one_beside_it_is_done(problem: Problem) -> None:
    """Each kind shares its task with a good replicate, and all tasks share two workers."""
    kinds = sorted(BAD, key=lambda kind: kind != "sleep")  # the one that waits first, the others meanwhile
    tasks = [a_task(problem, ["good", kind], kind, 3.0 if kind == "sleep" else 60.0) for kind in kinds]
    found = outcomes(tasks, workers=2)
    assert len(found) == 2 * len(BAD)
    for kind, (status, part) in BAD.items():
        good, bad = found[kind, 0], found[kind, 1]
        assert (kind, bad.status) == (kind, status), bad.message
        assert part in bad.message
        assert len(bad.message.splitlines()) == 1
        assert (kind, good.status) == (kind, Status.OK)
        assert good.estimate is not None
        assert good.estimate.cost.evaluations == 7


def test_a_bad_replicate_that_is_alone(problem: Problem) -> None:
    found = outcomes([a_task(problem, [kind], kind) for kind in ("raise", "exit", "trap")])
    assert {key: o.status for (key, _), o in found.items()} == {
        "raise": Status.CRASHED,
        "exit": Status.CRASHED,
        "trap": Status.INVALID,
    }


def test_what_a_library_prints_or_warns_of_is_no_failure(problem: Problem) -> None:
    found = outcomes([a_task(problem, ["print", "warn"])])
    assert {o.status for o in found.values()} == {Status.OK}


def test_an_outcome_says_what_the_fit_took(problem: Problem) -> None:
    outcome = outcomes([a_task(problem, ["good"])])["task", 0]
    assert 0 < outcome.wall_s < 60
    assert 0 <= outcome.cpu_s < 60
    assert 1 < outcome.peak_memory_mb < 100_000


def test_no_tasks_no_processes() -> None:
    assert outcomes([]) == {}


def test_workers_are_gone_when_the_caller_stops_early(problem: Problem) -> None:
    import multiprocessing

    before = {child.pid for child in multiprocessing.active_children()}
    running = perform([a_task(problem, ["good"], str(i)) for i in range(4)], 2)
    next(running)
    running.close()  # type: ignore[attr-defined]
    assert {child.pid for child in multiprocessing.active_children()} <= before


class Pid:
    """A fit that says in which process, and with which threads, it ran."""

    def __call__(self, payloads: Any, rngs: Any) -> Any:
        from misbehaving import answer

        threads = os.environ.get("OMP_NUM_THREADS")
        return [answer(problem, message=f"{os.getpid()} {threads}") for problem in payloads]


def test_fits_run_in_another_process_with_one_thread(problem: Problem) -> None:
    from bench.workers import single_threaded

    single_threaded()
    tasks = [Task(i, (0,), Pid(), (problem,), (np.random.default_rng(0),), 60.0) for i in range(4)]
    messages = [done[0].message for _, done in perform(tasks, 2)]
    pids = {message.split()[0] for message in messages}
    assert str(os.getpid()) not in pids
    assert 1 <= len(pids) <= 2
    assert {message.split()[1] for message in messages} == {"1"}


def test_splitting_a_task_keeps_payloads_and_streams_together(problem: Problem) -> None:
    task = a_task(problem, ["good", "nan", "exit"], timeout_s=2.0)
    assert task.limit == 6.0
    parts = task.split()
    assert [part.replicates for part in parts] == [(0,), (1,), (2,)]
    assert [part.payloads[0][0] for part in parts] == ["good", "nan", "exit"]
    drawn = [pickle.loads(pickle.dumps(part.rngs[0])).standard_normal() for part in parts]
    assert drawn == [np.random.default_rng(i).standard_normal() for i in range(3)]
    assert all(part.limit == 2.0 for part in parts)
