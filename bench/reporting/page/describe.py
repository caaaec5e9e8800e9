"""A scenario in words: what vibrates, what is measured, what is told."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bench.reporting.frame import Result
from bench.reporting.page.reading import ScenarioPanel, decibels
from bench.reporting.page.words import number

KINDS = ("mass", "damping", "stiffness", "other")
FEW = 4
"""Parameters that are named where scenarios differ in them."""
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def masses(n: int) -> str:
    """``one mass``, ``two masses``."""
    word = NUMBERS[n] if n < len(NUMBERS) else str(n)
    return f"{word} mass{'es' if n != 1 else ''}"


def system_words(facts: Result) -> str:
    """What vibrates: how many masses, what is special, and whether a force drives it."""
    model = facts.known_model
    what = masses(model.n_dof if model else facts.n_dof or 1)
    what = what[:1].upper() + what[1:]
    if model and not model.linear:
        what += f", nonlinear ({facts.kind.replace('_', ' ')})"
    if facts.added_mass:
        return f"{what}, free decays without and with a known added mass"
    return f"{what}, {'driven by a known ' + facts.force if facts.forced else 'free decay'}"


def scenario_words(panel: ScenarioPanel) -> str:
    """A title: system, noise, initial state, and what is special about the data."""
    facts = panel.facts
    special = "" if panel.kind == "undisturbed" else f"; {panel.kind}"
    return f"{system_words(facts)}, {decibels(facts.snr_db)} dB, initial state {facts.initial_state}{special}"


def distinct_words(panels: Sequence[ScenarioPanel]) -> list[str]:
    """The titles of scenarios, with what tells apart those that would have the same."""
    titles = [scenario_words(panel) for panel in panels]
    first: dict[str, Result] = {}
    found = []
    for words, panel in zip(titles, panels, strict=True):
        facts = panel.facts
        other = first.setdefault(words, facts)
        length = f"{facts.samples} samples in {facts.duration:g} s"
        special = [length] if (other.samples, other.duration) != (facts.samples, facts.duration) else []
        special += [values(facts)] if other.parameters != facts.parameters and len(facts.parameters) <= FEW else []
        special += [f"prior: {_prior(facts)}"] if other.prior != facts.prior and facts.prior else []
        found.append(f"{words}; {', '.join(special)}" if special else words)
    return found


def told(panel: ScenarioPanel) -> tuple[tuple[str, str], ...]:
    """What the methods were told of a scenario, and what they were not."""
    facts = panel.facts
    duration = f"{facts.duration:g}" if math.isfinite(facts.duration) else "?"
    sigma = ", ".join(map(number, facts.sigma))
    lines = [
        ("Samples", f"{facts.samples or '?'} a sensor, over {duration} s"),
        ("Initial state", "told" if facts.initial_state == "known" else "not told; estimated with the rest"),
        ("Force", f"{facts.force}; told" if facts.forced else "none: free vibration"),
        ("Prior", "none" if facts.prior is None else _prior(facts)),
        ("Noise", f"{decibels(facts.snr_db)} dB" + (f", standard deviation {sigma} m" if sigma else "") + "; not told"),
    ]
    if facts.added_mass:
        added = ", ".join(f"{mass:g}" for mass in facts.added_mass)
        lines.append(("Second record", f"of the same rig with {added} kg added, told"))
    if panel.disturbance:
        lines.append(("Disturbance", f"{panel.disturbance}; not told"))
    true = values(facts)
    lines.append(("True values", f"{true} (SI units); told to nobody" if true else "not recorded"))
    return tuple(lines)


def values(facts: Result) -> str:
    """The true parameters, in SI units."""
    return ", ".join(f"{name} = {number(float(value))}" for name, value in facts.parameters.items())


def _prior(facts: Result) -> str:
    """How far the nominal values may be off, by kind of parameter."""
    prior, system = facts.prior or {}, facts.known_model
    there = {parameter.kind for parameter in system.parameters} if system else set(KINDS)
    kinds = [f"{kind} {100 * float(prior[kind]):g} %" for kind in KINDS if kind in prior and kind in there]
    off = "; deliberately three standard deviations off" if prior.get("wrong") else ""
    return f"nominal values, off by about: {', '.join(kinds)}{off}"


def again(panel: ScenarioPanel) -> str:
    """The command that computes a scenario again."""
    if panel.experiments:
        return f"python -m bench -m experiment={panel.experiments[0].name}"
    return f"python -m bench reproduce cell={panel.facts.identity[:8]}"
