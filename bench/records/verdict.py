"""Verdict on an estimate: the most severe of its reasons for caution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class Trust(StrEnum):
    """Trustworthiness of an estimate, from best to worst; the values are printed."""

    TRUST = "trust"
    CAUTION = "use with caution"
    NO = "do not trust"

    @property
    def severity(self) -> int:
        """Position in the order from best to worst."""
        return list(Trust).index(self)


@dataclass(frozen=True)
class Reason:
    """Reason for caution: a sentence, and the verdict that it leads to."""

    verdict: Trust
    text: str


def verdict(reasons: Sequence[Reason]) -> Trust:
    """Return the most severe verdict of the reasons; ``TRUST`` if there are none."""
    return max((reason.verdict for reason in reasons), key=lambda trust: trust.severity, default=Trust.TRUST)
