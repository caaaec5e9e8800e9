"""A sweep that is watched: what a look says, where no run is at work, how it ends; with a run under way beside it."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from conftest import StoreFactory

from bench.commands import status, watch
from bench.commands.main import main
from bench.commands.watch import Look, Progress, block, line, rate, time_left
from bench.engine.plan import plan
from bench.engine.pool import Limits
from bench.engine.runner import run_cells
from bench.errors import InputError
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.locks import Claims, under_way
from bench.store.store import Store

SWEEP = ["method=prior,oracle,ls", "replicates=2,3,4,5"]
ENVIRONMENT = {**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "80"}


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Children can be interrupted, also from a suite in the background of a shell, which ignores Ctrl-C.

    An ignored signal is inherited, a handled one goes back to its default in the child; so nothing is run between
    fork and exec, where JAX, which the suite may have imported, warns.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def cells_of(reference: Scenario, *replicates: int) -> list[Cell]:
    return [Cell(reference, "prior", {}, n, 0, "prior") for n in replicates]


@pytest.fixture
def store(reference: Scenario, new_store: StoreFactory) -> Store:
    """A store with one of the cells of 2, 3 and 4 replicates."""
    store = new_store()
    run_cells(plan(cells_of(reference, 2), store), store, Limits(1))
    return store


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", *arguments]


def test_the_rate_is_of_what_came_after_the_first_arrival_of_the_last_five_minutes() -> None:
    """At 1000 s: 20 and 30 fits in the 100 s since the first of three cells; what came at 600 s is too long ago."""
    arrivals = [(600.0, 500), (900.0, 7), (950.0, 20), (990.0, 30)]
    assert rate(arrivals, 1000.0) == pytest.approx((20 + 30) / 100.0)
    assert rate(arrivals[:2], 1000.0) != rate(arrivals[:2], 1000.0)  # one arrival is no rate: NaN
    assert rate([], 1000.0) != rate([], 1000.0)


def test_the_time_left_is_the_longer_of_two_estimates() -> None:
    """100 fits at 2 a second are 50 s; 300 s of fits on 3 processes are 100 s, 30 s of fits 10 s."""
    assert time_left(100, 2.0, 300.0, 3) == 100.0
    assert time_left(100, 2.0, 30.0, 3) == 50.0
    assert time_left(100, 2.0, float("nan"), 3) == 50.0
    assert time_left(100, float("nan"), 300.0, 3) == 100.0
    assert time_left(0, float("nan"), float("nan"), 0) == 0.0
    assert str(time_left(100, 2.0, 300.0, 0)) == "nan"  # nobody is at work
    assert str(time_left(100, float("nan"), float("nan"), 2)) == "nan"


def test_only_claims_that_somebody_holds_count(tmp_path: Path) -> None:
    """A run that was killed leaves its claim behind as a file without a lock."""
    claims = Claims(tmp_path)
    assert under_way(tmp_path / "nowhere") == {}
    assert claims.take("held")
    assert claims.take("given_back")
    claims.release("given_back")
    taken = f"Claims(Path({str(tmp_path)!r})).take('left')"
    script = f"from bench.store.locks import Claims\nfrom pathlib import Path\n{taken}\n"
    killed = "import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n"
    done = subprocess.run([sys.executable, "-c", script + killed], timeout=120)
    assert done.returncode == -signal.SIGKILL
    assert (tmp_path / "left.claim").exists()
    assert set(under_way(tmp_path)) == {"held"}
    assert Claims(tmp_path).take("left")


def test_a_look_tells_stored_cells_from_those_under_way_and_to_come(store: Store, reference: Scenario) -> None:
    cells = cells_of(reference, 2, 3, 4)
    progress = Progress(cells, store)
    look = progress.look()
    assert (look.cells, look.done, look.failed, look.left) == (3, 1, 0, 2)
    assert (look.fits, look.fits_left) == (9, 7)
    assert look.running == ()
    assert watch.NO_RUN in line(look)
    assert watch.NO_RUN in block(look)
    claims = Claims(store.claims)
    assert claims.take(cells[1].identity)
    assert claims.take("a cell of another sweep")
    look = progress.look()
    assert [cell.identity for cell, _ in look.running] == [cells[1].identity]
    assert watch.NO_RUN not in line(look)
    claims.release_all()
    run_cells(plan(cells, store), store, Limits(1))
    look = progress.look()
    assert (look.done, look.left, look.fits_left, look.seconds_left) == (3, 0, 0, 0.0)
    walls = {cell.identity: cell.wall_s for cell in store}
    assert [seconds for _, seconds in look.slowest] == pytest.approx(sorted(walls.values(), reverse=True))


def test_a_cell_that_fails_while_it_is_watched_is_counted_as_failed(
    reference: Scenario, new_store: StoreFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = new_store()
    cells = [Cell(reference, "ls", {}, 2, 0, "ls")]
    progress = Progress(cells, store)
    run_cells(plan(cells, store), store, Limits(1, timeout_s=1e-6))
    look = progress.look()
    assert (look.done, look.failed, look.left) == (0, 1, 0)
    assert "1 failed" in line(look)
    again = Progress(cells, store).look()
    assert (again.done, again.failed, again.left) == (0, 1, 0)


def test_a_retried_cell_is_left_until_it_has_been_stored_again(reference: Scenario, new_store: StoreFactory) -> None:
    from bench.engine.plan import FAILURES

    store = new_store()
    cells = [Cell(reference, "ls", {}, 2, 0, "ls")]
    run_cells(plan(cells, store), store, Limits(1, timeout_s=1e-6))
    progress = Progress(cells, store, FAILURES)
    look = progress.look()
    assert (look.done, look.failed, look.left) == (0, 0, 1)
    run_cells(plan(cells, store, FAILURES), store, Limits(1))
    look = progress.look()
    assert (look.done, look.failed, look.left) == (1, 0, 0)


def test_no_line_of_a_look_is_wider_than_the_terminal(reference: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = Cell(reference, "pinn", {}, 2, 0, "pinn " + " ".join(f"setting{i}=0.123" for i in range(9)))
    look = Look(12345, 6789, 1234, 4321, 10**7, 10**6, ((cell, 1e6),) * 5, ((cell, 1e6),) * 3, 1.23e-3, 1e7)
    for places in (40, 60, 80):
        monkeypatch.setenv("COLUMNS", str(places))
        assert all(len(text) < places for text in block(look))


def numbers(text: str) -> list[int]:
    """The cells that each line of a watch says are stored."""
    return [int(found) for found in re.findall(r"^\d\d:\d\d:\d\d (\d+)/\d+ cells", text, re.MULTILINE)]


def test_a_running_sweep_is_followed_to_its_end(new_store: StoreFactory) -> None:
    """Two processes, as in two terminals: the one that watches never counts down, and ends by itself."""
    store = new_store()
    fields = [*SWEEP, f"store={store.folder}"]
    sweep = subprocess.Popen(
        command("bench", "-m", *fields, "workers=1"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=ENVIRONMENT,
    )
    try:
        done = subprocess.run(
            command("bench", "status", *fields, "watch=0.2"),
            capture_output=True,
            text=True,
            timeout=240,
            env=ENVIRONMENT,
        )
    finally:
        assert sweep.wait(240) == 0
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[-1].endswith("12/12 cells, all stored")
    counts = numbers(done.stdout)
    assert len(counts) == len(lines)
    assert counts == sorted(counts)
    assert all(len(text) <= 80 for text in lines)
    assert "\x1b" not in done.stdout


def interrupted(arguments: Sequence[str]) -> tuple[int, str, str]:
    """Exit status, output and errors of a command that is sent Ctrl-C after its first line."""
    process = subprocess.Popen(
        command(*arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )
    assert process.stdout is not None
    first = process.stdout.readline()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    return process.returncode, first + out, err


def test_ctrl_c_ends_a_watch_of_a_sweep_that_nobody_runs(new_store: StoreFactory) -> None:
    store = new_store()
    code, out, err = interrupted(["bench", "status", *SWEEP, f"store={store.folder}", "watch=30"])
    assert code == 130
    assert out.endswith(f" 0/12 cells; {watch.NO_RUN}\n")
    assert err.strip() == "bench: interrupted"


def test_a_reader_of_a_watch_that_goes_away_ends_it(new_store: StoreFactory) -> None:
    store = new_store()
    watching = command("bench", "status", *SWEEP, f"store={store.folder}", "watch=0.2")
    process = subprocess.Popen(watching, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.wait(120) == 141
    assert process.stderr.read() == ""
    process.stderr.close()


def test_on_a_terminal_a_look_takes_the_place_of_the_one_before(store: Store) -> None:
    """Each look but the first goes up as many lines as the one before it had, and clears from there."""
    ours, theirs = pty.openpty()
    environment = {**ENVIRONMENT, "TERM": "xterm", "NO_COLOR": "1", "COLUMNS": "60"}
    watching = command("bench", "status", "method=prior", "replicates=2,3", f"store={store.folder}", "watch=0.1")
    process = subprocess.Popen(watching, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    text, deadline = "", time.monotonic() + 120
    while text.count("\x1b[J") < 2 and time.monotonic() < deadline:
        text += os.read(ours, 4096).decode()
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 130
    os.close(ours)
    looks = re.split(r"\x1b\[(\d+)F\x1b\[J", text)
    assert len(looks) >= 5
    assert all(int(up) == looks[i].count("\n") for i, up in zip(range(0, len(looks), 2), looks[1::2], strict=False))
    assert not re.search(r"\x1b\[[0-9;]*m", text)
    assert max(len(part) for part in looks[0].split("\r\n")) <= 60


@pytest.mark.parametrize("text", ["maybe", "0", "-1", "nan", "inf", "1e9", "5s", "True"])
def test_a_watch_that_makes_no_sense_is_one_line(text: str, store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "method=prior", f"store={store.folder}", f"watch={text}"]) == 2
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert err.startswith(f"bench: watch={text}: true, false, or the seconds between two looks")


def test_a_watch_says_what_it_needs(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", f"store={store.folder}", "watch=true"]) == 2
    assert "name the sweep: experiment=<name>" in capsys.readouterr().err
    with pytest.raises(InputError, match="true, false"):
        status.seconds_of("watch", "maybe")
    assert tuple(status.seconds_of("watch", text) for text in ("false", "true", "7.5")) == (0.0, 2.0, 7.5)
    assert main(["status", f"store={store.folder}", "watch=false"]) == 0


def test_a_watch_of_what_is_done_ends_at_once(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "method=prior", "replicates=2", f"store={store.folder}", "watch=3600"]) == 0
    assert capsys.readouterr().out.endswith(" 1/1 cells, all stored\n")
