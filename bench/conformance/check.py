"""A check: a name, a sentence, the function that tries it, and what to do where it fails."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from bench.isolation.failure import one_line, traceback_text, without_folders

RAISED = "end a fit that goes wrong with bench.NoEstimate('why, and what to do'), which becomes a status and a sentence"


class Refusal(Exception):
    """The reason why a check fails, in a sentence; ``remedy`` replaces that of the check."""

    def __init__(self, reason: str, remedy: str = "") -> None:
        super().__init__(reason)
        self.remedy = remedy


@dataclass(frozen=True)
class CheckOutcome:
    """The result of a check: a remark or the reason of a failure, and a remedy."""

    name: str
    about: str
    passed: bool
    message: str = ""
    remedy: str = ""
    traceback: str = ""


@dataclass(frozen=True)
class Check:
    """One requirement on a method or a system.

    Attributes:
        name: The name that the command prints.
        about: The requirement in a sentence.
        run: Returns a remark or nothing, and raises :class:`Refusal`; another exception is one of the subject.
        remedy: What to do where it fails.
        gate: Where it fails, the later checks are not tried.
    """

    name: str
    about: str
    run: Callable[[Any], str | None]
    remedy: str
    gate: bool = False

    def failed(self, message: str, remedy: str = "", traceback: str = "") -> CheckOutcome:
        """Return the outcome of a failure."""
        return CheckOutcome(self.name, self.about, False, message, remedy or self.remedy, traceback)

    def outcome(self, subject: Any) -> CheckOutcome:
        """Run the check; whatever the subject raises makes it fail."""
        try:
            return CheckOutcome(self.name, self.about, True, self.run(subject) or "")
        except Refusal as refusal:
            return self.failed(str(refusal), refusal.remedy)
        except Exception as error:
            return self.failed(f"raised {one_line(error)}", RAISED, without_folders(traceback_text()))


class Checks(list[Check]):
    """The checks of one kind of subject, in the order in which they run."""

    def add(self, name: str, remedy: str, gate: bool = False, **arguments: Any) -> Callable[[Any], Any]:
        """Return a decorator that adds a function; ``arguments`` are given to it, its docstring is the requirement."""

        def decorate(function: Callable[..., str | None]) -> Callable[..., str | None]:
            self.append(Check(name, inspect.getdoc(function) or "", partial(function, **arguments), remedy, gate))
            return function

        return decorate
