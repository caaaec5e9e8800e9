"""Commands of the benchmark, each run in a fork of one process that has loaded their modules.

A fork takes milliseconds where a new Python takes a second, and a command that hangs, eats memory or ends its process
harms nobody. ``Forked.run`` gives what a shell would see.
"""

from __future__ import annotations

import contextlib
import encodings.ascii  # noqa: F401 - another user cannot read this Python
import importlib
import io
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.commands.verbs import VERBS

REPOSITORY = Path(__file__).parents[1]
Main = Callable[[Sequence[str]], int]
WARM = (
    ["method=ls", "snr=nan"], ["method=ls", "data=nowhere.csv"], ["experiment=online", "x=1"],
    ["experiment=atlas", "x=1"], ["experiment=measured", "x=1"], ["experiment=modal", "x=1"],
    ["method=ls", "system.duration=-1"],
    ["certify", "data=nowhere.csv"], ["track", "from=nowhere.csv"], ["identifiability", "snr=nan"],
    ["new", "method=new", "out=/dev/null"], ["design", "given=nowhere.csv"],
    ["report", "out=/dev/null"], ["tables", "archive=nowhere"], ["tables", "what=claims", "results=nowhere"],
    ["tables", "what=figures", "out=/dev/null"], ["status", "method=nobody"], ["reproduce", "cell=00", "store=nowhere"],
    ["share", "action=submit", "method=nobody"], ["share", "action=merge", "submission=nowhere"],
    ["share", "action=export", "form=petab", "snr=nan"], ["share", "action=publish", "store=nowhere"],
)  # fmt: skip
"""Lines of which each ends early, but brings modules."""
CPU_S, WALL_S, MEMORY = 20, 90.0, 3 * 2**30
"""What a command that should end at once may take, the memory in bytes beyond what is loaded."""


@dataclass(frozen=True)
class Call:
    """A command by the words of its line, and what it finds: the folder, who runs it, and room on the disk."""

    arguments: Sequence[str]
    folder: str
    user: int = 0
    """Another user's number, where the tests run as root and file permissions are to count."""
    largest_file: int = 0
    """Bytes that a file may have, which stands for a disk that is full; 0: any."""


@dataclass(frozen=True)
class Ended:
    """How a command ended: the exit status, negative for a signal, and what it printed."""

    status: int
    out: str
    err: str


class Forked:
    """The process that forks; one for many commands."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY), *sys.path])}
        self.process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )

    def run(self, call: Call) -> Ended:
        """Run a command to its end."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(asdict(call)) + "\n")
        self.process.stdin.flush()
        return Ended(**json.loads(self.process.stdout.readline()))

    def close(self) -> None:
        """End it."""
        self.process.communicate(timeout=60)


def _serve() -> None:
    from bench.commands.main import main

    for verb in VERBS:
        importlib.import_module(f"bench.commands.{verb}")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        for line in WARM:
            main(line)
    for text in sys.stdin:
        print(json.dumps(_ended(main, json.loads(text))), flush=True)


def _ended(main: Main, call: dict[str, Any]) -> dict[str, Any]:
    places = [Path(call["folder"]).with_name(f"{Path(call['folder']).name}.{name}") for name in ("out", "err")]
    child = os.fork()
    if not child:
        _become(main, call, places)
    try:
        status = _waited(child)
        out, err = (place.read_text(encoding="utf-8", errors="replace")[:100_000] for place in places)
    finally:
        for place in places:
            place.unlink(missing_ok=True)
    return {"status": status, "out": out, "err": err}


def _waited(child: int) -> int:
    """Return the status of a child, which is killed with all its own where it takes too long."""
    until = time.monotonic() + WALL_S
    while True:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            break
        if time.monotonic() > until:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.002)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what it left behind
    return os.waitstatus_to_exitcode(status)


def _become(main: Main, call: dict[str, Any], places: Sequence[Path]) -> None:
    """In the fork: the command; it never comes back."""
    status = 70
    try:
        os.setsid()
        for number, place in enumerate([Path(os.devnull), *places]):
            os.dup2(os.open(place, os.O_RDWR | os.O_CREAT, 0o666), number)
        os.chdir(call["folder"])
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        if call["largest_file"]:
            resource.setrlimit(resource.RLIMIT_FSIZE, (call["largest_file"], resource.RLIM_INFINITY))
        if call["user"]:
            os.setgroups([])
            os.setgid(call["user"])
            os.setuid(call["user"])
        sys.argv = ["bench", *call["arguments"]]
        status = main(call["arguments"])
        sys.stdout.flush()
    except BaseException as error:
        import traceback

        traceback.print_exception(error, file=sys.stderr)
        status = 1
    finally:
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    _serve()
