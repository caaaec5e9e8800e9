"""Work on measured records in a process of its own, which a limit of time can end."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any, TypeVar

from bench.isolation.processes import Children
from bench.records.record import Measured

Result = TypeVar("Result")


def apart(work: Callable[[Measured], Result], measured: Measured, limit_s: float) -> Result:
    """The result of a function of a module; raises :class:`bench.isolation.processes.Died` where it takes longer."""
    children = Children()
    try:
        child = children.start(_send, pickle.dumps((work, measured)))
        return pickle.loads(child.receive(limit_s))  # type: ignore[no-any-return]
    finally:
        children.close()


def _send(connection: Any, packed: bytes) -> None:
    work, measured = pickle.loads(packed)
    connection.send_bytes(pickle.dumps(work(measured)))
