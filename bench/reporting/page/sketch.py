"""A sketch of a system: masses, springs, dampers, what is nonlinear and what drives it, in the page's own colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from bench.reporting.frame import Result

MOST_MASSES = 4
"""Of longer chains the first three and the last are drawn, with dots between."""
BODY, GAP, HEIGHT = 56, 64, 120
MIDDLE = 60
SPRING, DAMPER = 46, 76
HALF_A_LETTER = 3.3
"""Of the smallest text, across."""


def sketch(facts: Result) -> str:
    """An SVG element; its words are in ``aria-label``."""
    model = facts.known_model
    n = model.n_dof if model else max(facts.n_dof, 1)
    nonlinear = bool(model and not model.linear)
    if facts.kind == "pendulum":
        return _svg(240, _pendulum(), "A pendulum")
    shown = list(range(n)) if n <= MOST_MASSES else [0, 1, 2, n - 1]
    parts = [_wall()]
    for place, mass in enumerate(shown):
        gap = place > 0 and mass - shown[place - 1] > 1
        x = 20 + place * (GAP + BODY)
        parts += [_dots(x)] if gap else [_spring(x, nonlinear), _damper(x)]
        parts.append(_mass(x + GAP, mass + 1 if n > 1 else None))
    end = 20 + len(shown) * (GAP + BODY)
    if facts.forced:
        dof = int((facts.data.get("force") or {}).get("dof", 0))
        parts.append(_force(20 + (min(dof, len(shown) - 1) + 1) * (GAP + BODY)))
    said = (
        f"{n} mass{'es' if n > 1 else ''} between springs and dampers" if n > 1 else "A mass on a spring and a damper"
    )
    said += ", a law of the spring or damper that is not linear" if nonlinear else ""
    said += ", driven by a force" if facts.forced else ""
    if nonlinear:
        kind = facts.kind.replace("_", " ")
        parts.append(_text(max(20 + GAP / 2, HALF_A_LETTER * len(kind)), 20, kind))
    if facts.added_mass:
        parts.append(_added(20 + GAP))
        said += ", weighed once more with a known mass on it"
    return _svg(end + 60, parts, said)


def _svg(width: float, parts: Sequence[str], said: str) -> str:
    return (
        f'<svg class="sketch" viewBox="0 0 {width:g} {HEIGHT}" width="{width:g}" height="{HEIGHT}" role="img" '
        f'aria-label="Sketch: {said}">{"".join(parts)}</svg>'
    )


def _path(d: str, width: float = 1.6) -> str:
    return f'<path d="{d}" fill="none" stroke="currentColor" stroke-width="{width:g}" stroke-linejoin="round"/>'


def _wall() -> str:
    hatches = "".join(f"M20 {y} l-10 10" for y in range(30, 96, 11))
    return _path(f"M20 28 V100 {hatches}")


def _spring(x: float, nonlinear: bool) -> str:
    step = (GAP - 16) / 8
    zigzag = "".join(f" l{step:g} {dy}" for dy in (-8, 16, -16, 16, -16, 16, -16, 8))
    arrow = _path(f"M{x + 12} {SPRING + 12} l{GAP - 26} -26 m0 0 l-8 2 m8 -2 l-2 8", 1.2) if nonlinear else ""
    return _path(f"M{x} {SPRING} h8{zigzag} h8") + arrow


def _damper(x: float) -> str:
    half = GAP / 2
    return _path(
        f"M{x} {DAMPER} h{half - 8:g} M{x + half - 8:g} {DAMPER - 9} v18 "
        f"M{x + half - 14:g} {DAMPER - 11} h24 v22 h-24 M{x + half + 10:g} {DAMPER} H{x + GAP}"
    )


def _mass(x: float, number: int | None) -> str:
    box = f'<rect x="{x}" y="32" width="{BODY}" height="58" rx="3" class="body"/>'
    label = _text(x + BODY / 2, MIDDLE + 6, "m" if number is None else f"m{number}", 15)
    return box + label


def _dots(x: float) -> str:
    return _text(x + GAP / 2, MIDDLE, "· · ·", 18)


def _added(x: float) -> str:
    return f'<rect x="{x + 14}" y="14" width="{BODY - 28}" height="18" class="body" stroke-dasharray="3 2"/>'


def _force(x: float) -> str:
    return _path(f"M{x + 4} {MIDDLE} h40 m-9 -5 l9 5 l-9 5") + _text(x + 26, MIDDLE - 10, "f(t)")


def _pendulum() -> list[str]:
    return [
        _path("M80 14 h80 M120 14 L158 84"), '<circle cx="163" cy="94" r="12" class="body"/>',
        '<path d="M120 14 V86" fill="none" stroke="currentColor" stroke-dasharray="3 4"/>', _text(152, 46, "l"),
        _text(190, 100, "m"),
    ]  # fmt: skip


def _text(x: float, y: float, text: str, size: Literal[12, 15, 18] = 12) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size}" text-anchor="middle" fill="currentColor">{_plain(text)}</text>'
    )


def _plain(text: str) -> str:
    return text.replace("&", "and").replace("<", "").replace(">", "").replace('"', "")
