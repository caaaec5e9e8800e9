"""What methods are called: by their cards, and by nothing in the harness."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from importlib.resources import files

import pytest
from conftest import REPOSITORY

from bench import Card, Identifier
from bench.config.choices import choices
from bench.entrants.registry import load_method, registered
from bench.reporting import labels
from bench.reporting.labels import cards, counterparts, in_order, information_used, title

BENCH = sorted(path for path in (REPOSITORY / "bench").rglob("*.py") if path.name != "sentences.py")
"""But for the conclusions of the documents, which are about methods by name."""


def texts(tree: ast.AST) -> set[str]:
    """All strings and names of a module."""
    found = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return found | {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def test_the_harness_names_no_method() -> None:
    """Neither a registered method nor a variant is a string of bench: what is special about one is on its card."""
    names = {*registered(), *(name for name in choices("method") if name not in labels.REFERENCE_CARDS)}
    names -= {"frequency"}  # a word of physics too
    named = {str(path): names & texts(ast.parse(path.read_text(encoding="utf-8"))) for path in BENCH}
    assert {path: found for path, found in named.items() if found} == {}


def test_every_variant_of_conf_has_a_card_of_its_own() -> None:
    for name in choices("method"):
        if files("conf").joinpath("method", f"{name}.yaml").is_file():
            assert title(name) != name
            assert [method for method in registered() if name in load_method(method).card.variants]


@dataclass(frozen=True)
class Plain(Identifier):
    """A third party's method whose card says nothing of how it looks."""

    card = Card("s", "used when known", "groups", "simulated", "u", "d")


def test_a_card_without_a_title_is_called_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(labels, "registered", lambda: {"zebra": None, "antelope": None})
    monkeypatch.setattr(labels, "load_method", lambda name: Plain)
    cards.cache_clear()
    try:
        assert title("zebra") == "zebra"
        assert in_order(["zebra", "unheard", "antelope", "oracle"]) == ["oracle", "antelope", "unheard", "zebra"]
        assert information_used("zebra") == "initial state, prior after"
        assert counterparts("ls") == []
    finally:
        cards.cache_clear()
