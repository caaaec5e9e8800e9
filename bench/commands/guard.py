"""What every command ends with: its exit status, and one line where it could not be done."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable

from bench.commands.streams import OUTPUT, check_output, drop_output, prepare_streams
from bench.errors import InputError, line_of
from bench.isolation.signals import Ended, ended_by_signals, interrupts_again


def guarded(name: str, body: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Run a command; its exit status, which is 130 for Ctrl-C and 141 where its reader has gone.

    It is 2 for bad input, and where the machine does not give what the command needs: a file that cannot be read or
    written, a full disk, no memory. SIGTERM and SIGHUP give 143 and 129. Each of these is one line on the error stream,
    that of a reader that has gone none; letters that the output cannot hold become ``?``. Anything else is a fault of
    the program, and a traceback.
    """
    prepare_streams()
    try:
        interrupts_again()
        check_output()
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
        with contextlib.suppress(OSError):  # the terminal may be gone
            print(f"{name}: {interrupted}", file=sys.stderr)
        return ended.status
    except BrokenPipeError:
        drop_output()
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
        drop_output()
    return 2


def _of_system(error: OSError) -> InputError:
    """What the system refused, as bad input: a file by its name, or the output."""
    reason = error.strerror or str(error)
    if error.filename == OUTPUT:
        return InputError("output", OUTPUT, f"cannot be written: {reason}; make room, or send it elsewhere")
    if error.filename is not None:
        return InputError("file", error.filename, f"{reason}; see to it, and run the command again")
    return InputError("system", type(error).__name__, f"{reason}; see to it, and run the command again")


def _check_folder() -> None:
    """Raise InputError where the working folder has been removed."""
    try:
        os.getcwd()
    except OSError as error:
        where = os.environ.get("PWD", ".")
        raise InputError("folder", where, f"where you are: {error.strerror}; change to one that is there") from None
