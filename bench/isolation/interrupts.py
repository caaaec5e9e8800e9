"""Ctrl-C while a command's modules are imported: one line, as later, where Python would show a traceback.

Importing this module is what begins it; the command ends it.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

PROGRAMS = ("-m", "vibration-bench")
"""What Python says that it runs while it imports the package of a command."""


def _quiet_while_importing() -> None:
    """Have Ctrl-C end this process in one line; nothing where it runs no command, or where Ctrl-C is not its own."""
    ours = Path(sys.argv[0]).name in PROGRAMS if sys.argv else False
    if ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _ended)


def interrupts_again() -> None:
    """Have Ctrl-C raise KeyboardInterrupt again, once the command takes care of it."""
    if signal.getsignal(signal.SIGINT) is _ended:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _ended(*_: Any) -> None:
    try:
        os.write(2, b"\nbench: interrupted\n")
    finally:
        os._exit(130)


_quiet_while_importing()
