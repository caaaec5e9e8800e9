"""What somebody who mistyped a name may have meant."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches


def did_you_mean(written: object, names: Sequence[str]) -> str:
    """``did you mean ls? `` with the name that is nearest in spelling; empty where none is near."""
    near = get_close_matches(str(written), names, n=1, cutoff=0.6)
    if not near and len(str(written)) == 2:  # two letters that changed places are half a match
        near = [name for name in names if name == str(written)[::-1]]
    return f"did you mean {near[0]}? " if near else ""
