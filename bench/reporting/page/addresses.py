"""Permanent addresses: what each page is called, from names alone, so that a link outlives new results."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence

from bench.reporting.page.reading import ScenarioPanel, decibels

LONGEST = 80


def slug(name: str) -> str:
    """A name as part of an address: lower case, digits, ``-`` and ``_``; what loses letters gets a hash of the name."""
    plain = re.sub(r"[^a-z0-9_.]+", "-", name.lower()).strip("-.")[:LONGEST]
    return (
        plain
        if re.fullmatch(r"[\w .,=()-]+", name, re.ASCII) and plain and len(name) <= LONGEST
        else _hashed(plain, name)
    )


def _hashed(plain: str, name: str) -> str:
    digest = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{plain}-{digest}" if plain else digest


def slugs(names: Sequence[str]) -> Mapping[str, str]:
    """The addresses of several names, all different."""
    found: dict[str, str] = {}
    for name in names:
        own = slug(name)
        found.setdefault(name, _hashed(own, name) if own in found.values() else own)
    return found


def scenario_slugs(panels: Sequence[ScenarioPanel]) -> list[str]:
    """One a scenario: system, noise, start and what is special; where that is not enough, a hash of the whole question.

    Panels come in the order of the tables, so that a scenario of a table keeps the plain name.
    """
    found: list[str] = []
    for panel in panels:
        facts = panel.facts
        special = "" if panel.kind == "undisturbed" else f" {panel.kind}"
        plain = slug(f"{facts.system} {decibels(facts.snr_db)}db start {facts.initial_state}{_ascii(special)}")
        found.append(_hashed(plain, facts.question) if plain in found else plain)
    return found


def _ascii(text: str) -> str:
    return re.sub(r"[^\w .,-]+", "", text, flags=re.ASCII)
