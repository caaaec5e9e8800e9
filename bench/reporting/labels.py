"""Titles and order of methods, their variants and the reference rows, from their cards.

A label is the name of a method in a cell: a registered name, a file of ``conf/method``, or a reference row, each
possibly followed by settings. A label without a card is its own title and comes last. The label of a submitted cell
ends in a mark, which its title keeps.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from bench.contract.method import Card
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method, registered
from bench.errors import InputError
from bench.store.stored_cell import unmarked


def _reference(title: str, order: int) -> Card:
    return Card("", "not used", "native", "simulated", "", "", title=title, order=order, remarks=True)


REFERENCE_CARDS = {"prior": _reference("prior (no data)", 0), "oracle": _reference("oracle", 1)}
REFERENCE_INFORMATION = {"oracle": "true values as initial guess", "prior": "prior only"}
"""Information beyond the data that the reference rows use."""


@cache
def cards() -> dict[str, Card]:
    """Return the cards of the reference rows, of the methods that load, and of their variants, by label."""
    by_label = dict(REFERENCE_CARDS)
    for name in registered():
        try:
            card = load_method(name).card
        except InputError:
            continue  # reported when that method is chosen
        by_label[name] = card
        by_label |= {variant: card.variant(variant) for variant in card.variants}
    return by_label


def card_of(label: str) -> Card | None:
    """Return the card of a label, or None; a submitted cell has the card of its method."""
    return cards().get(unmarked(label))


def title(label: str) -> str:
    """Return the title of a method."""
    card = card_of(label)
    return f"{card.title}{label[len(unmarked(label)) :]}" if card and card.title else label


def states_terms(label: str) -> bool:
    """Return whether the messages of a method's estimates name the terms of its model."""
    card = card_of(label)
    return bool(card and card.states_terms)


def warns(label: str) -> bool:
    """Return whether the message of a successful fit is a warning, and not a list of terms or a remark on the end."""
    card = card_of(label)
    return bool(card and not (card.states_terms or card.remarks))


def in_order(labels: Iterable[str]) -> list[str]:
    """Return each label once, in the order of the cards; labels without a card last, by name."""
    return sorted(set(labels), key=place_of)


def place_of(label: str) -> tuple[float, str]:
    """Return the sort key of a label."""
    card = card_of(label)
    return card.order if card else 1000, label


def information_used(method: str) -> str:
    """List the information that a method uses beyond the data: a known initial state, and the prior.

    ``prior after``: it returns the identifiable groups only, and a shared step combines them with the prior.
    """
    if method in REFERENCES:
        return REFERENCE_INFORMATION[method]
    card = load_method(method).card
    initial_state = "initial state, " if card.start == "used when known" else ""
    return initial_state + ("prior" if card.scale == "native" else "prior after")


def counterparts(name: str) -> list[str]:
    """Return the labels compared with a method of the paper, in order: the method itself, then its variants."""
    return in_order(label for label, card in cards().items() if card.paper == name)
