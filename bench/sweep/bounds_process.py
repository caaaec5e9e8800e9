"""The bounds of a run's cells, computed in a process of their own within the limits of the run.

A bound that cannot be computed, or not within the limits, costs the cells of its scenario, and no others. The process
is none of those that fit or score: bounds of nonlinear systems load jax.
"""

from __future__ import annotations

import pickle
import time
from collections import defaultdict
from collections.abc import Iterable
from multiprocessing.connection import Connection

from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.store.bounds import bound_path, keep_bound, kept_bound
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.progress import BoundsProgress, OnLook, firsts_first
from bench.sweep.workers import Limits


def serve(connection: Connection) -> None:
    """Keep the bound of one cell after another; the answers say why there is none, or are InputError."""
    connection.send_bytes(b"ready")
    while True:
        cell, folder = pickle.loads(connection.recv_bytes())
        answer: str | InputError = ""
        try:
            keep_bound(cell, folder)
        except InputError as error:
            answer = error
        except Exception as error:
            answer = one_line(error)
        connection.send_bytes(pickle.dumps(answer))


def make_bounds(
    cells: Iterable[Cell], store: Store, children: Children, limits: Limits, on_look: OnLook | None = None
) -> dict[str, str]:
    """Have the store keep the bound of every cell, or as many as can be computed.

    Args:
        cells: The cells.
        store: Where the bounds are kept.
        children: The processes of the run.
        limits: Of one bound.
        on_look: Gets how far it is, where any bound is missing.

    Returns:
        Why a cell has no bound, by the identity of the cell.

    Raises:
        InputError: where the store cannot be written.
    """
    sharing: dict[str, list[Cell]] = defaultdict(list)
    lost = {}
    for cell in cells:
        try:
            sharing[cell.bound_identity].append(cell)
        except Exception as error:  # it draws the times of a scenario that may be absurd
            lost[cell.identity] = one_line(error)
    store.fetch_bounds(sharing.keys())
    process = _BoundsProcess(store, children, limits)
    missing = [group for group in sharing.values() if not kept_bound(bound_path(group[0], store.bounds))]
    missing = firsts_first(missing, lambda group: group[0].scenario.label)
    progress = BoundsProgress([group[0].scenario.label for group in missing])
    if missing and on_look is not None:
        on_look(progress.begin())
    for group in missing:
        if why := process.why_none(group[0]):
            lost |= dict.fromkeys((cell.identity for cell in group), why)
        if on_look is not None:
            on_look(progress.made(process.seconds))
    process.retire()
    return {identity: f"its bound cannot be computed: {why}" for identity, why in lost.items()}


class _BoundsProcess:
    """The process, started when the first bound is missing, and again where it was ended."""

    def __init__(self, store: Store, children: Children, limits: Limits) -> None:
        self.store, self.children, self.limits = store, children, limits
        self.child: Child | None = None
        self.seconds = 0.0
        """What the last bound took, without the start of the process."""

    def why_none(self, cell: Cell) -> str:
        """Have a bound kept that is missing; returns why there is none, or nothing."""
        try:
            if self.child is None:
                self.child = self.children.start(serve)
                self.child.receive(READY_S)
            answer = self._answer(self.child, cell)
        except Died as died:
            self.child = None
            return died.message
        if isinstance(answer, InputError):
            raise answer
        return answer

    def _answer(self, child: Child, cell: Cell) -> str | InputError:
        started = time.monotonic()
        try:
            child.send(pickle.dumps((cell, self.store.bounds)))
            answer: str | InputError = pickle.loads(child.receive(self.limits.timeout_s, self.limits.memory_mb))
            return answer
        finally:
            self.seconds = time.monotonic() - started

    def retire(self) -> None:
        if self.child is not None:
            self.child.retire()
