"""What the data of a scenario do not tell by themselves, whatever the method."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bench.reporting.frame import ERROR
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.page.told import ranked
from bench.reporting.page.words import joined, percent, quantity

WORDS = {"m": "mass m", "c": "damping c", "k": "stiffness k"}


@dataclass(frozen=True)
class Untold:
    """Sentences, and by quantity the share of the prior in the precision at the bound."""

    why: str
    told: str
    shares: tuple[tuple[str, str], ...]


def untold(panel: ScenarioPanel) -> Untold | None:
    """What a scenario's data do not tell; None where they tell everything."""
    lost = [name for name, told in panel.identifiable.items() if not told]
    if not lost:
        return None
    shares = sorted(((n, panel.prior_share.get(n, math.nan)) for n in lost), key=lambda pair: -_share(pair[1]))
    names, plain = joined([word(n) for n in lost]), all(n in WORDS for n in lost)
    first = f"{names[:1].upper()}{names[1:]}" if plain else f"The values of {names}"
    twice = "the mass, damping and stiffness" if plain else "every mass, damping and stiffness"
    alike = "a system that differs in them" if panel.facts.forced else f"in free vibration, a system with twice {twice}"
    groups = list(map(quantity, ranked(panel)))
    told = f"The motion tells only {joined(groups)}." if groups else ""
    given = tuple((word(n), percent(share)) for n, share in shares if math.isfinite(share)) if panel.facts.prior else ()
    return Untold(f"{first}: {alike} moves exactly alike.", told, given)


def word(name: str) -> str:
    """A quantity with what it is, where that is short."""
    return WORDS.get(name, quantity(f"{name}{ERROR}"))


def _share(value: float) -> float:
    return -1.0 if math.isnan(value) else value
