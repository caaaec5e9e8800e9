"""The verdict on an answer: the worst of the reasons for caution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class Trust(StrEnum):
    """How far an answer can be trusted; the value is what is printed, the gravest last."""

    TRUST = "trust"
    CAUTION = "use with caution"
    NO = "do not trust"


@dataclass(frozen=True)
class Reason:
    """A reason for caution, in a sentence, and the verdict that it asks for."""

    verdict: Trust
    text: str


def verdict(reasons: Sequence[Reason]) -> Trust:
    """Return the worst verdict that the reasons ask for; trust without any."""
    return max((reason.verdict for reason in reasons), key=list(Trust).index, default=Trust.TRUST)
