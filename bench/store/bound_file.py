"""A bound as a file of a store: its text under a seal. The archive has the text alone, in a file with its own."""

from __future__ import annotations

from bench.store.seal import sealed, unsealed_text

FORMAT = 1


def bound_file(text: str) -> bytes:
    """The bytes of a bound's file."""
    return sealed(FORMAT, text)


def bound_text(content: bytes) -> str:
    """The text of a bound's file; raises :class:`bench.store.seal.Unsealed` where it is not whole."""
    return unsealed_text(FORMAT, content)
