"""Exit statuses and one-line errors of the commands, and robust standard streams."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress

from bench.errors import InputError, line_of
from bench.isolation.signals import Ended, raise_on_signals, restore_interrupts

OPTIONAL = {
    "jax": "jax", "sklearn": "atlas", **dict.fromkeys(("altair", "contourpy", "matplotlib", "PIL"), "figures"),
    **dict.fromkeys(("arviz", "libsbml", "nbformat"), "exchange"),
}  # fmt: skip
"""Extras by the packages that they install, which commands import where they need them."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def guarded(name: str, body: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Run a command and return its exit status.

    It is 2 for bad input and for faults of the machine (a file that cannot be read or written, a full disk, no memory),
    130 for Ctrl-C, 143 for SIGTERM and 129 for SIGHUP, each with a line on the error stream, and 141 for a closed pipe.
    Any other exception is a bug and gives a traceback.
    """
    closed = _prepare_streams()
    try:
        restore_interrupts()
        if closed:
            raise InputError("output", "closed", f"open it; > {os.devnull} discards the output")
        _check_folder()
        with raise_on_signals():
            status = body()
        sys.stdout.flush()  # here, where a closed pipe is caught
        return status
    except InputError as error:
        return _refused(name, error)
    except KeyboardInterrupt:
        print(f"\n{name}: {interrupted}", file=sys.stderr)
        return 130
    except Ended as ended:
        with suppress(OSError):  # the terminal may be closed
            print(f"{name}: {interrupted}", file=sys.stderr)
        return ended.status
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        if package not in OPTIONAL:
            raise
        remedy = f"missing: pip install 'vibration-bench[{OPTIONAL[package]}]'"
        return _refused(name, InputError("package", package, remedy))
    except BrokenPipeError:
        _drop_output()
        return 141
    except OSError as error:
        return _refused(name, _of_system(error))
    except MemoryError:
        return _refused(
            name, InputError("memory", "exhausted", "reduce the problem, or use a machine with more memory")
        )


def _refused(name: str, error: InputError) -> int:
    print(f"{name}: {line_of(error)}", file=sys.stderr)
    try:
        sys.stdout.flush()
    except OSError:
        _drop_output()
    return 2


def _of_system(error: OSError) -> InputError:
    """Return a system error as InputError, which names the file or the output."""
    reason = error.strerror or str(error)
    if error.filename is None and error.errno in FULL:
        return InputError("output", "standard output", f"cannot be written: {reason}; free some space, or redirect it")
    field, value = ("file", error.filename) if error.filename is not None else ("system", type(error).__name__)
    return InputError(field, value, f"{reason}; correct this, then run the command again")


def _check_folder() -> None:
    """Raise InputError if the working folder has been removed."""
    try:
        os.getcwd()
    except OSError as error:
        where = os.environ.get("PWD", ".")
        raise InputError("folder", where, f"working folder: {error.strerror}; change to an existing one") from None


def _prepare_streams() -> bool:
    """Make the standard streams safe to use; return whether standard output was closed.

    A closed stream is opened on the null device; otherwise the next file that is opened would take its number.
    Characters that the encoding of a stream lacks become ``?``. Failed writes to the error stream are ignored.
    """
    closed = sys.stdout is None
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
    if closed:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115 - open until the process ends
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - open until the process ends
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        encoding, raw = getattr(sys.stderr, "encoding", "utf-8"), _Lossy(2, "w", closefd=False)
        sys.stderr = io.TextIOWrapper(raw, encoding, "backslashreplace", line_buffering=True, write_through=True)  # type: ignore[arg-type]
    if getattr(sys.stdout, "errors", None) == "strict" and hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")
    return closed


def _drop_output() -> None:
    """Discard all further output, so that Python does not report the closed pipe again at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Lossy(io.FileIO):
    """A file that ignores failed writes."""

    def write(self, content: object) -> int:
        """Write the content, or ignore it where that fails."""
        with suppress(OSError):
            return super().write(content)  # type: ignore[arg-type]
        return len(content)  # type: ignore[arg-type]
