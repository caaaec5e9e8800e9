"""The first screen: which method for which situation, at what error, risk and time, over all scenarios of its kind.

A situation is a predicate over scenarios; its numbers are pooled over every stored scenario, noise level and start that
it names. A method is recommended only where it ran on all of them and does not run away, there or in the atlas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import beta

from bench.reporting.frame import Result
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.page.standing import fit_seconds
from bench.scoring.comparison import gross
from bench.scoring.statistics import LEVEL, more_often

ALIKE = 1.05
"""Errors within this factor of the least are alike for a user: the fastest of them is named first."""
MOST_EXTRA = 0.02
"""A method is fragile where it has gross errors more often than the steadiest, surely and by more than this share."""
HOPELESS = 0.5
"""No method is advised where the best of them has gross errors on more than this share of the data sets."""
FEWEST_SETS = 20
"""Scenarios with fewer data sets a method are studies of reach, and tell no risk."""
FEWEST_METHODS = 0.5
"""Scenarios with less than this share of the situation's methods are studies of a few, and compare no others."""


@dataclass(frozen=True)
class Situation:
    """What a user has before him: a name for addresses, words, and which scenarios are of that kind."""

    name: str
    words: str
    has: Callable[[ScenarioPanel], bool]


@dataclass(frozen=True)
class SituationRecord:
    """What a method did in a situation.

    ``excess``: median over scenarios and quantities of the root mean square error over the bound, gross errors left
    out; ``worst``: the largest of them. ``gross`` of ``fits``: data sets on which any quantity that the data tell is
    off by a gross error, or without an answer. ``p_gross``: that it has them no more often than the steadiest.
    """

    label: str
    method: str
    excess: float
    worst: float
    gross: int
    fits: int
    seconds: float
    p_gross: float = 1.0
    extra: float = 0.0

    @property
    def risk(self) -> float:
        """The share of gross errors."""
        return self.gross / self.fits if self.fits else math.nan

    @property
    def risk_at_most(self) -> float:
        """The upper end of its one-sided 95 % interval (C. J. Clopper, E. S. Pearson, Biometrika 26:404, 1934)."""
        return 1.0 if self.gross == self.fits else float(beta.ppf(0.95, self.gross + 1, self.fits - self.gross))


@dataclass(frozen=True)
class Order:
    """Methods as they are advised: errors alike, fastest first; ``behind`` them by error; ``fragile`` never advised."""

    advised: tuple[SituationRecord, ...]
    behind: tuple[SituationRecord, ...]
    fragile: tuple[SituationRecord, ...]


@dataclass(frozen=True)
class Advice:
    """A situation and the order of its methods; ``partial`` ran on some of its scenarios only.

    ``elsewhere``: labels of fragile methods that run away not here, but over the atlas.
    """

    situation: Situation
    panels: tuple[ScenarioPanel, ...]
    advised: tuple[SituationRecord, ...]
    behind: tuple[SituationRecord, ...]
    fragile: tuple[SituationRecord, ...]
    partial: tuple[SituationRecord, ...]
    elsewhere: frozenset[str] = frozenset()

    @property
    def hopeless(self) -> bool:
        """Whether the best of them has gross errors on most data sets: then none is advised."""
        return not self.advised or self.advised[0].risk > HOPELESS


def _linear(panel: ScenarioPanel, masses: int) -> bool:
    model = panel.facts.known_model
    return model is not None and model.linear and (model.n_dof == 1) == (masses == 1) and not model.n_hidden


def _free(panel: ScenarioPanel) -> bool:
    return panel.plain and not panel.facts.forced and not panel.facts.added_mass


def _regime(panel: ScenarioPanel) -> bool:
    return "regimes" in {one.name for one in panel.experiments}


def _nonlinear(panel: ScenarioPanel) -> bool:
    model = panel.facts.known_model
    return panel.plain and model is not None and not model.linear


SITUATIONS = (
    Situation(
        "free-decay-start-unknown", "One mass, free decay, initial state unknown",
        lambda p: _free(p) and _linear(p, 1) and p.facts.initial_state == "unknown" and not _regime(p),
    ),
    Situation(
        "free-decay-start-known", "One mass, free decay, initial state known",
        lambda p: _free(p) and _linear(p, 1) and p.facts.initial_state == "known" and not _regime(p),
    ),
    Situation(
        "few-samples-a-cycle", "One mass, near or beyond two samples a cycle, or nearly aperiodic",
        lambda p: p.plain and _linear(p, 1) and _regime(p),
    ),
    Situation("known-force", "One mass, known force", lambda p: p.plain and p.facts.forced and _linear(p, 1)),
    Situation(
        "added-mass", "One mass, a second record with known mass added",
        lambda p: p.plain and bool(p.facts.added_mass) and _linear(p, 1),
    ),
    Situation("several-masses", "Several masses, linear", lambda p: p.plain and _linear(p, 2)),
    Situation("nonlinear-free", "Nonlinear, free decay", lambda p: _nonlinear(p) and not p.facts.forced),
    Situation("nonlinear-forced", "Nonlinear, known force", lambda p: _nonlinear(p) and p.facts.forced),
    Situation(
        "disturbed", "One mass, noise that is not white and Gaussian, bias, drift, jitter or outliers",
        lambda p: bool(p.disturbance) and not p.facts.truth_drawn and not _wrong_model(p) and not _regime(p),
    ),
    Situation(
        "wrong-model", "One mass, and the rig has friction, a cubic spring or a mode that the model lacks",
        lambda p: _wrong_model(p),
    ),
)  # fmt: skip
WRONG_MODEL = ("added_friction", "cubic_spring", "second_mode")


def _wrong_model(panel: ScenarioPanel) -> bool:
    return panel.facts.disturbance in WRONG_MODEL


def advise(panels: Sequence[ScenarioPanel], unsteady: frozenset[str] = frozenset()) -> list[Advice]:
    """The situations of which anything is stored; ``unsteady`` methods run away in other free decays of one mass."""
    found = []
    for situation in SITUATIONS:
        own = [p for p in panels if situation.has(p) and p.experiments and max_n(p) >= FEWEST_SETS]
        most = max((len(p.methods) for p in own), default=0)
        own = [p for p in own if len(p.methods) >= FEWEST_METHODS * most]
        if own:
            elsewhere = unsteady if situation.name.startswith("free-decay") else frozenset()
            found.append(advice(situation, own, elsewhere))
    return found


def max_n(panel: ScenarioPanel) -> int:
    """The data sets of the method that has most."""
    return max((cell.n for cell in panel.methods), default=0)


def advice(situation: Situation, panels: Sequence[ScenarioPanel], unsteady: frozenset[str] = frozenset()) -> Advice:
    """Who is advised over some scenarios."""
    cells = {label: _cells(panels, label) for label in dict.fromkeys(c.label for p in panels for c in p.methods)}
    whole = {label: own for label, own in cells.items() if len(own) == len(panels)}
    runs = {label: [_gross(panel, cell) for panel, cell in own] for label, own in whole.items()}
    records = {label: _record(label, own) for label, own in cells.items() if any(c.n_ok for _, c in own)}
    records = _with_p_gross(records, runs)
    found = ordered(records, frozenset(whole), unsteady)
    partial = sorted((r for label, r in records.items() if label not in whole), key=_by_excess)
    return Advice(situation, tuple(panels), found.advised, found.behind, found.fragile, tuple(partial), unsteady)


def ordered(records: Mapping[str, SituationRecord], whole: frozenset[str], unsteady: frozenset[str]) -> Order:
    """The methods that ran on the ``whole`` of a situation, in the order in which they are advised."""
    several = max(len(whole), 1)
    fragile = {
        label for label in whole & records.keys()
        if (records[label].p_gross <= LEVEL / several and records[label].extra > MOST_EXTRA) or label in unsteady
    }  # fmt: skip
    steady = [records[label] for label in records if label in whole and label not in fragile]
    steady = [one for one in steady if math.isfinite(one.excess)]
    least = min((one.excess for one in steady), default=math.nan)
    alike = sorted((o for o in steady if o.excess <= ALIKE * least), key=lambda o: (_last(o.seconds), o.label))
    behind = sorted((o for o in steady if o.excess > ALIKE * least), key=_by_excess)
    return Order(tuple(alike), tuple(behind), tuple(sorted((records[label] for label in fragile), key=_by_excess)))


def _by_excess(one: SituationRecord) -> tuple[float, str]:
    return _last(one.excess), one.label


def _last(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _cells(panels: Iterable[ScenarioPanel], label: str) -> list[tuple[ScenarioPanel, Result]]:
    return [(p, c) for p in panels for c in p.methods if c.label == label and c.n]


def _gross(panel: ScenarioPanel, cell: Result) -> np.ndarray:
    """On which data sets (n,) a cell has a gross error in a quantity that the data tell, or no answer."""
    wrong = ~cell.ok
    for metric in panel.ranked:
        if metric in cell.summary and math.isfinite(cell.bound(metric)):
            wrong = wrong | gross(cell.errors(metric), cell.bound(metric))
    return np.asarray(wrong)


def core_excess(cell: Result, metric: str) -> float:
    """Root mean square over the bound of the errors that are not gross; NaN where there is none, or no bound."""
    return core_error(cell, metric) / cell.bound(metric)


def core_error(cell: Result, metric: str) -> float:
    """Root mean square of the errors that are not gross; NaN where there is none, or no bound."""
    bound, errors = cell.bound(metric), cell.errors(metric)
    good = errors[~gross(errors, bound)]
    if not (math.isfinite(bound) and bound > 0 and good.size):
        return math.nan
    return float(np.sqrt(np.mean(good**2)))


def _record(label: str, own: Sequence[tuple[ScenarioPanel, Result]]) -> SituationRecord:
    excess = [core_excess(cell, metric) for panel, cell in own for metric in panel.ranked if metric in cell.summary]
    finite = [value for value in excess if math.isfinite(value)]
    wrong = [_gross(panel, cell) for panel, cell in own]
    times = [seconds for _, cell in own if math.isfinite(seconds := fit_seconds(cell))]
    return SituationRecord(
        label, own[0][1].method, float(np.median(finite)) if finite else math.nan, max(finite, default=math.nan),
        sum(int(w.sum()) for w in wrong), sum(w.size for w in wrong), float(np.median(times)) if times else math.nan,
    )  # fmt: skip


def _with_p_gross(
    records: Mapping[str, SituationRecord], runs: Mapping[str, Sequence[np.ndarray]]
) -> dict[str, SituationRecord]:
    """Each compared with the method that has gross errors least often, on the data sets of both."""
    full = {label: sum(w.size for w in own) for label, own in runs.items()}
    most = [label for label, n in full.items() if n == max(full.values())]
    if not most:
        return dict(records)
    rarest = min(most, key=lambda label: (sum(int(w.sum()) for w in runs[label]), label))
    found = dict(records)
    for label, own in runs.items():
        if label in records:
            pairs = [
                (a[: min(a.size, b.size)], b[: min(a.size, b.size)]) for a, b in zip(own, runs[rarest], strict=True)
            ]
            mine, steadiest = (np.concatenate(side) for side in zip(*pairs, strict=True))
            extra = float(mine.mean() - steadiest.mean()) if mine.size else 0.0
            found[label] = replace(found[label], p_gross=more_often(mine, steadiest), extra=extra)
    return found
