"""A check: a name, what it is about, what to do where it fails, and the function that tries it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from bench.isolation.failure import one_line, traceback_text, without_places

Subject = TypeVar("Subject")


class Refusal(Exception):
    """What a check found wrong, in a sentence; ``remedy`` where that of the check is not the one."""

    def __init__(self, found: str, remedy: str = "") -> None:
        self.remedy = remedy
        super().__init__(found)


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """One thing that a method or a system must keep: what the docstring of ``run`` says.

    ``run`` returns a remark, or nothing, and raises :class:`Refusal`; any other exception is one of what is checked.
    ``long``: it asks for a fit of data unlike those of most checks, for which some methods prepare anew. ``gate``:
    where it fails, those behind it would say the same.
    """

    name: str
    run: Callable[[Subject], str]
    remedy: str
    long: bool = False
    gate: bool = False

    @property
    def about(self) -> str:
        """What must hold."""
        return str(inspect.getdoc(getattr(self.run, "func", self.run)))


@dataclass(frozen=True)
class Outcome:
    """What a check found: ``remark`` where it passed, ``found`` and ``remedy`` where it did not."""

    name: str
    about: str
    passed: bool
    remark: str = ""
    found: str = ""
    remedy: str = ""
    traceback: str = ""


RAISED = "end a fit that goes wrong with bench.NoEstimate('why, and what to do'), which becomes a status and a sentence"


def outcome(check: Check[Any], subject: Any) -> Outcome:
    """Run a check; whatever the subject raises becomes a failure of it."""
    try:
        return Outcome(check.name, check.about, True, remark=check.run(subject))
    except Refusal as refusal:
        remedy = refusal.remedy or check.remedy
        return Outcome(check.name, check.about, False, found=str(refusal), remedy=remedy)
    except Exception as error:
        said = without_places(traceback_text())
        return Outcome(check.name, check.about, False, found=f"raised {one_line(error)}", remedy=RAISED, traceback=said)
