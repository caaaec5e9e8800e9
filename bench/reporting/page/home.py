"""Format the facts of a ranking for the home page and for "Which method?"."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bench.entrants.registry import load_method, registered
from bench.errors import InputError
from bench.reporting.frame import ERROR
from bench.reporting.labels import card_of
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.page.words import USUAL_DB, decibels, percent, quantity
from bench.reporting.ranking import Ranked
from bench.reporting.tables.pooling import pooled_quantities
from bench.store.stored_cell import unmarked

FEW = 3
"""Largest number of quantities that are listed by name."""


def between(values: Sequence[float], text: Callable[[float], str] = "{:.2f}".format) -> str:
    """Format the range of some values; a dash without any."""
    return " to ".join(dict.fromkeys((text(min(values)), text(max(values))))) if values else "–"


def lost(rows: Sequence[Ranked]) -> str:
    """Format the range of the shares of outlier fits of some methods."""
    return between([row.lost / row.fits for row in rows], percent)


def levels(panels: Sequence[ScenarioPanel]) -> str:
    """Format the range of noise levels (dB)."""
    return between([panel.facts.snr_db for panel in panels], decibels)


def bound(panels: Sequence[ScenarioPanel]) -> str:
    """List the identifiable quantities with their Cramér-Rao bounds in percent at the usual noise level."""
    level = min((panel.facts.snr_db for panel in panels), key=lambda snr: (abs(snr - USUAL_DB), snr), default=USUAL_DB)
    bounds: dict[str, list[float]] = {}
    for panel in (panel for panel in panels if panel.facts.snr_db == level and panel.facts.known_model):
        for name in pooled_quantities(panel.facts.model, panel.identifiable):
            bounds.setdefault(quantity(name), []).append(panel.bound(f"{name}{ERROR}"))
    medians = {name: float(np.median(values)) for name, values in bounds.items()}
    if not np.isfinite(list(medians.values())).all():
        return ""
    few = ", ".join(f"{name} {value:.2g} %" for name, value in medians.items())
    many = f"{len(medians)} quantities, {between(list(medians.values()), '{:.2g}'.format)} %"
    return f"{few if len(medians) <= FEW else many} at {decibels(level)} dB" if medians else ""


def method_name(label: str) -> str:
    """Return the registered name of a method, variant or submitted method."""
    plain = unmarked(label)
    return next((name for name in registered() if (card := card_of(name)) and plain in card.variants), plain)


def needs(label: str) -> str:
    """Return the requirements of a method, from its card: a prior, and packages."""
    try:
        method = load_method(method_name(label))
    except InputError:
        return ""
    free = method.card.scale == "groups" or method.scope.free_without_prior
    packages = f"; package {', '.join(method.requires)}" if method.requires else ""
    return ("no prior needed" if free else "a prior") + packages
