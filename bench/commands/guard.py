"""What every command ends with: its exit status, and one line where it could not be done; streams that are safe."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress

from bench.errors import InputError, line_of
from bench.isolation.signals import Ended, ended_by_signals, interrupts_again

OPTIONAL = {"jax": "jax"}
"""Packages that are imported where they are needed, each with the extra that installs it."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def guarded(name: str, body: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Run a command and return its exit status.

    It is 2 for bad input, and where the machine does not give what the command needs: a file that cannot be read or
    written, a full disk, no memory; 130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP; each with a line on the error
    stream. It is 141 where the reader of the output has gone. Anything else is a fault of the program: a traceback.
    """
    closed = _prepare_streams()
    try:
        interrupts_again()
        if closed:
            raise InputError("output", "closed", f"an output that can be written; > {os.devnull} where none is wanted")
        _check_folder()
        with ended_by_signals():
            status = body()
        sys.stdout.flush()  # here, where a reader that has gone is no traceback
        return status
    except InputError as error:
        return _refused(name, error)
    except KeyboardInterrupt:
        print(f"\n{name}: {interrupted}", file=sys.stderr)
        return 130
    except Ended as ended:
        with suppress(OSError):  # the terminal may be gone
            print(f"{name}: {interrupted}", file=sys.stderr)
        return ended.status
    except ModuleNotFoundError as error:
        if error.name not in OPTIONAL:
            raise
        remedy = f"missing: pip install 'vibration-bench[{OPTIONAL[error.name]}]'"
        return _refused(name, InputError("package", error.name, remedy))
    except BrokenPipeError:
        _drop_output()
        return 141
    except OSError as error:
        return _refused(name, _of_system(error))
    except MemoryError:
        return _refused(name, InputError("memory", "exhausted", "ask for less, or give the machine more"))


def _refused(name: str, error: InputError) -> int:
    print(f"{name}: {line_of(error)}", file=sys.stderr)
    try:
        sys.stdout.flush()
    except OSError:
        _drop_output()
    return 2


def _of_system(error: OSError) -> InputError:
    """Return what the system refused as bad input: a file by its name, or the output."""
    reason = error.strerror or str(error)
    if error.filename is None and error.errno in FULL:
        return InputError("output", "standard output", f"cannot be written: {reason}; make room, or send it elsewhere")
    field, value = ("file", error.filename) if error.filename is not None else ("system", type(error).__name__)
    return InputError(field, value, f"{reason}; see to it, and run the command again")


def _check_folder() -> None:
    """Raise InputError where the working folder has been removed."""
    try:
        os.getcwd()
    except OSError as error:
        where = os.environ.get("PWD", ".")
        raise InputError("folder", where, f"where you are: {error.strerror}; change to one that is there") from None


def _prepare_streams() -> bool:
    """Make the streams safe to use; return whether the output was closed, so that nobody would see what is computed.

    A stream that is closed is opened on nothing, or the next file to be opened would take its place. Letters that a
    stream cannot hold become ``?``. What cannot be written to the error stream is lost, and ends nothing.
    """
    closed = sys.stdout is None
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
    if closed:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115 - as long as the process
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - as long as the process
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        encoding, raw = getattr(sys.stderr, "encoding", "utf-8"), _Lossy(2, "w", closefd=False)
        sys.stderr = io.TextIOWrapper(raw, encoding, "backslashreplace", line_buffering=True, write_through=True)  # type: ignore[arg-type]
    if getattr(sys.stdout, "errors", None) == "strict" and hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")
    return closed


def _drop_output() -> None:
    """Send what is printed from now on to nothing, so that Python's end does not complain once more."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Lossy(io.FileIO):
    """A file whose writes never fail."""

    def write(self, content: object) -> int:
        """Write what can be written."""
        with suppress(OSError):
            return super().write(content)  # type: ignore[arg-type]
        return len(content)  # type: ignore[arg-type]
