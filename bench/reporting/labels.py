"""What methods, their variants and the reference rows are called, from their cards alone.

A label is what a cell calls its method: a registered name, a file of ``conf/method``, a reference row, or any of these
with settings behind it. What no card speaks of is called by its label, and stands behind the others. The label of a
cell that was submitted carries a mark, which its name for people keeps.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from bench.contract.method import Card
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method, registered
from bench.errors import InputError
from bench.store.stored import unmarked


def _reference(title: str, order: int) -> Card:
    return Card("", "not used", "native", "simulated", "", "", title=title, order=order, remarks=True)


REFERENCE_CARDS = {"prior": _reference("prior (no data)", 0), "oracle": _reference("oracle", 1)}
TOLD = {"oracle": "truth as start", "prior": "prior only"}
"""What the reference rows are told beyond the data."""


@cache
def cards() -> dict[str, Card]:
    """By label, the cards of the reference rows, of the methods that load, and of their variants."""
    found = dict(REFERENCE_CARDS)
    for name in registered():
        try:
            card = load_method(name).card
        except InputError:
            continue  # said when, and only if, that method is chosen
        found[name] = card
        found |= {variant: card.variant(variant) for variant in card.variants}
    return found


def card_of(label: str) -> Card | None:
    """The card of a label, if there is one; a submitted cell has that of its method."""
    return cards().get(unmarked(label))


def title(label: str) -> str:
    """The name of a method for people."""
    card = card_of(label)
    return f"{card.title}{label[len(unmarked(label)) :]}" if card and card.title else label


def states_terms(label: str) -> bool:
    """Return whether the messages of a method's estimates name the terms of its model."""
    card = card_of(label)
    return bool(card and card.states_terms)


def warns(label: str) -> bool:
    """Return whether the message of an answer is a warning: not where it names terms or says how the fit ended."""
    card = card_of(label)
    return bool(card and not (card.states_terms or card.remarks))


def in_order(labels: Iterable[str]) -> list[str]:
    """Each label once, in the order that their cards give, all others behind by name."""
    return sorted(set(labels), key=place_of)


def place_of(label: str) -> tuple[float, str]:
    """What sorts a label."""
    card = card_of(label)
    return card.order if card else 1000, label


def told(method: str) -> str:
    """What a method is told beyond the data: the start where it is known, and the prior.

    ``prior after``: it returns the identifiable groups only, and the shared step combines them with the prior.
    """
    if method in REFERENCES:
        return TOLD[method]
    card = load_method(method).card
    start = "start, " if card.start == "used when known" else ""
    return start + ("prior" if card.scale == "native" else "prior after")


def beside_paper(name: str) -> list[str]:
    """The labels that stand beside a method of the paper, in order: first the method itself, then its variants."""
    return in_order(label for label, card in cards().items() if card.paper == name)
