"""Messages of the commands on the error stream: the logger ``bench``, whose level ``-v`` and ``-q`` set."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

LOG = logging.getLogger("bench")
LEVELS = {"-v": logging.DEBUG, "--verbose": logging.DEBUG, "-q": logging.ERROR, "--quiet": logging.ERROR}


class _Lines(logging.Handler):
    """Prints to the error stream of the moment, above a progress bar if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one message."""
        print(f"bench: {record.getMessage()}", file=sys.stderr, flush=True)


@contextmanager
def messages(words: Sequence[str]) -> Iterator[list[str]]:
    """Print the messages of the level that the words of a command line select; yields the other words."""
    handler, before = _Lines(), (LOG.level, LOG.propagate)
    LOG.addHandler(handler)
    LOG.setLevel(next((LEVELS[word] for word in reversed(words) if word in LEVELS), logging.INFO))
    LOG.propagate = False
    try:
        yield [word for word in words if word not in LEVELS]
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(before[0])
        LOG.propagate = before[1]


def verbose() -> bool:
    """Return whether -v is among the words of the command line."""
    return LOG.isEnabledFor(logging.DEBUG)
