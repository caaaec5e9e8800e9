"""A check: what must hold, the function that tries it, and what to do where it fails."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from bench.isolation.failure import one_line, traceback_text, without_places

Subject = TypeVar("Subject")
RAISED = "end a fit that goes wrong with bench.NoEstimate('why, and what to do'), which becomes a status and a sentence"


class Refusal(Exception):
    """What a check found wrong, in a sentence; ``remedy`` replaces that of the check."""

    def __init__(self, found: str, remedy: str = "") -> None:
        self.remedy = remedy
        super().__init__(found)


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """One requirement on a method or a system; the docstring of ``run`` says which.

    Attributes:
        name: What the command prints.
        run: Returns a remark, or nothing, and raises :class:`Refusal`; another exception is one of the subject.
        remedy: What to do where it fails.
        long: It fits data of another kind than most checks, for which some methods prepare anew.
        gate: Where it fails, the later checks are not tried.
    """

    name: str
    run: Callable[[Subject], str]
    remedy: str
    long: bool = False
    gate: bool = False

    @property
    def about(self) -> str:
        """The requirement in a sentence."""
        return str(inspect.getdoc(getattr(self.run, "func", self.run)))


@dataclass(frozen=True)
class Outcome:
    """The result of a check: ``remark`` where it passed, ``found`` and ``remedy`` where it did not."""

    name: str
    about: str
    passed: bool
    remark: str = ""
    found: str = ""
    remedy: str = ""
    traceback: str = ""


def outcome(check: Check[Any], subject: Any) -> Outcome:
    """Run a check; whatever the subject raises makes it fail."""
    try:
        return Outcome(check.name, check.about, True, remark=check.run(subject))
    except Refusal as refusal:
        remedy = refusal.remedy or check.remedy
        return Outcome(check.name, check.about, False, found=str(refusal), remedy=remedy)
    except Exception as error:
        log = without_places(traceback_text())
        return Outcome(check.name, check.about, False, found=f"raised {one_line(error)}", remedy=RAISED, traceback=log)
