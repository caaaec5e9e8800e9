"""Let Ctrl-C end the server without a traceback while it imports its modules; imported by the server, before them.

Only the import of the package itself, which this import includes, can still be interrupted with a traceback.
"""

import os
import signal
from typing import Any


def restore_interrupts() -> None:
    """Restore the default effect of Ctrl-C, which the children inherit."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: Any) -> None:
    os._exit(130)


if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end)
