"""Pages of test plans: a table of tests, sampling times, forces or methods with their errors, and its meaning."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from bench.atlas.model import AtlasModel, unknown
from bench.atlas.point import FreeDecay
from bench.config.atlas import efficient_methods
from bench.contract.method import Identifier
from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.planning.extension import MeasuredDecay
from bench.planning.forced_test import FORCED_QUANTITIES, ForcedTest
from bench.planning.forces import LEAST_LINES, Forces, evaluate_force, line_frequencies
from bench.planning.free_decay import QUANTITIES, Decay
from bench.planning.multisine import ALL
from bench.planning.sampling_times import VOLUME, best_times, evaluate_times
from bench.planning.search import LEAST_RATE, SHARE, WITHIN, Likely, ProposedTest, cheapest, proposal
from bench.planning.verify import robust_deviation, share_within, simulate_decays, simulate_forced_tests
from bench.reporting.atlas import RARE, point_frame
from bench.reporting.terminal import table, wrapped

Simulation = Callable[[Identifier, int, Callable[[], object]], np.ndarray]
"""Function of a method, a number of tests, and a callback after each test; returns the errors of simulated tests."""
Row = dict[str, str]
"""Texts of a row, by heading."""
TITLES = {"k_over_m": "k/m", "c_over_m": "c/m", "natural_frequency": "frequency", "damping_ratio": "damping ratio"}
AMPLITUDES = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
"""Initial displacements that are proposed if none is given, in units of the noise."""
FACTORS, REPEATS = (1.25, 1.5, 2.0, 3.0), (2, 4)
"""Multiples of a record's duration, and numbers of repeated records, in the table."""
WRITTEN = "a file that python -m bench -m experiment=atlas has written"


@dataclass(frozen=True)
class PlanRequest:
    """A request for a test.

    Attributes:
        quantity: Requested quantity.
        error: Requested standard deviation of its logarithm.
        likely: Likely oscillators.
        noise: Standard deviation of the noise (m).
        method: Method that fits simulated tests.
        simulations: Number of simulations of each proposed test.
    """

    quantity: str
    error: float
    likely: Likely
    noise: float
    method: str
    simulations: int

    @property
    def title(self) -> str:
        """Name of the requested quantity."""
        return TITLES[self.quantity]

    @property
    def median(self) -> str:
        """Remark on percentages, if more than one oscillator is likely."""
        return ", median over the likely oscillators" if self.likely.uncertain else ""

    def simulate(
        self, rows: Sequence[Row], heading: str, tests: Sequence[Simulation], text: Callable[[np.ndarray], str]
    ) -> None:
        """Add a column with results of simulated tests, if simulations are requested."""
        from bench.engine.progress import counter
        from bench.entrants.registry import make_method

        if self.simulations:
            method = make_method(self.method, {})
            with counter("test", self.simulations * len(tests)) as advance:
                for row, test in zip(rows, tests, strict=True):
                    row[heading] = text(test(method, self.simulations, advance))

    def simulate_decays(
        self, rows: Sequence[Row], decays: Sequence[Decay], times: Sequence[np.ndarray | None] = ()
    ) -> None:
        """Add the share of simulated decays, sampled at ``times`` if given, that reach the requested error."""
        tests: list[Simulation] = [
            partial(simulate_decays, self.likely, decay, self.quantity, times=sampled)
            for decay, sampled in zip(decays, times or [None] * len(decays), strict=True)
        ]
        self.simulate(rows, "simulated, %", tests, lambda errors: f"{100 * share_within(errors, self.error):.1f}")


def percent(value: float) -> str:
    """Format an error in percent; a dash if it is not finite."""
    shown = 100 * value
    return "-" if not math.isfinite(value) else f"{shown:.0f}" if shown >= 10 else f"{shown:.2g}"


def _errors(errors: Mapping[str, float], names: Iterable[str] = QUANTITIES) -> Row:
    """Return errors (%) by heading."""
    return {f"{TITLES.get(name, name)}, %": percent(errors[name]) for name in names}


def _page(rows: Sequence[Row], *notes: str, words: Collection[int] = (0,)) -> str:
    """Return a table with notes below it."""
    shown = table([list(row.values()) for row in rows], list(rows[0]), words)
    return "\n".join([shown, "", *(wrapped(note, "") for note in notes)])


# ---- free decays


def proposals(request: PlanRequest, amplitude: float | None, rate: float) -> list[ProposedTest]:
    """Return the free decay with the fewest samples for each initial displacement (in units of the noise)."""
    amplitudes = AMPLITUDES if amplitude is None else (amplitude,)
    tests = [cheapest(request.likely, request.quantity, request.error, start, rate) for start in amplitudes]
    return [test for test in tests if test is not None]


def errors_of(request: PlanRequest, amplitude: float | None, samples: int, duration: float) -> list[ProposedTest]:
    """Return the expected errors of a given test for each initial displacement."""
    amplitudes = AMPLITUDES if amplitude is None else (amplitude,)
    return [proposal(request.likely, Decay(samples, duration, start)) for start in amplitudes]


def decay_page(request: PlanRequest, tests: Sequence[ProposedTest]) -> str:
    """Return a table of tests with their errors, and its meaning."""
    rows = []
    for test in tests:
        decay, rest = test.decay, {}
        for name, share in test.share.items():
            same = math.isclose(test.median[name], share, rel_tol=1e-3)
            rest[f"{TITLES[name]}, %"] = percent(test.median[name]) + ("" if same else f" ({percent(share)})")
        rows.append(
            {
                "initial displacement, mm": f"{1e3 * request.noise * decay.amplitude:.3g}",
                "samples": f"{decay.samples}", "duration, s": f"{decay.duration:.3g}",
                "sampling rate, 1/s": f"{(decay.samples - 1) / decay.duration:.3g}",
                **rest, "P(wrong frequency), %": f"{100 * test.wrong_basin:.1g}",
            }
        )  # fmt: skip
    request.simulate_decays(rows, [test.decay for test in tests])
    doubt = f" (median over the likely oscillators; in brackets not exceeded in {100 * SHARE:g} % of them)"
    text = (
        "Each row is the test with the fewest samples for its initial displacement, released from rest. Percentages "
        f"are standard deviations by the Cramér-Rao bound{doubt if request.likely.uncertain else ''}. "
        f"P: probability. Methods that reach the bound: {', '.join(efficient_methods())}."
    )
    if request.simulations:
        text += (
            f" Simulated: share of {request.simulations} tests, fitted by {request.method}, with an error of "
            f"{request.title} within {WITHIN:g} times the requested one; 95 % if it is just reached."
        )
    return _page(rows, text, words=())


def times_page(request: PlanRequest, decay: Decay) -> tuple[str, np.ndarray]:
    """Return a table of uniform and optimal sampling times, and the optimal ones for the requested quantity (s)."""
    best = f"best for {request.title}"
    compared = {
        "even": evaluate_times(request.likely, decay.times, decay.amplitude),
        best: best_times(request.likely, decay, request.quantity),
        "best for k/m and c/m": best_times(request.likely, decay, VOLUME),
    }
    rows = [{"times": title, **_errors(sampled.median)} for title, sampled in compared.items()]
    request.simulate_decays(rows, [decay] * len(compared), [sampled.times for sampled in compared.values()])
    times = compared[best].times
    meaning = f"Percentages are standard deviations by the Cramér-Rao bound{request.median}."
    return _page(rows, f"Best for {request.title} (s): {_bursts(times, decay)}.", meaning), times


def _bursts(times: np.ndarray, decay: Decay) -> str:
    """Format sampling times, consecutive ones as bursts."""
    gap = 0.5 * decay.duration / (decay.samples - 1)
    bursts = np.split(times, 1 + np.flatnonzero(np.diff(times) > gap))
    return ", ".join(f"{b[0]:.3g}" if b.size == 1 else f"{b.size} from {b[0]:.3g} to {b[-1]:.3g}" for b in bursts)


def longer_page(record: MeasuredDecay, quantity: str | None, error: float) -> str:
    """Return a table of longer and repeated records, and the record needed for a requested error, if there is one."""
    lines = [("this record", record.duration, record.supported)]
    lines += [(f"{factor:g} times as long", factor * record.duration, record.expected(factor)) for factor in FACTORS]
    lines += [(f"{n} repeated records", n * record.duration, record.repeated(n)) for n in REPEATS]
    rows = [{"record": title, "seconds": f"{seconds:.3g}", **_errors(errors)} for title, seconds, errors in lines]
    meaning = (
        "Percentages are standard errors: those of this record from its intervals of a repeat, the others by ratios of "
        "Cramér-Rao bounds. A longer record continues at the same sampling rate."
    )
    return _page(rows, meaning, *([_until(record, quantity, error)] if quantity else []))


def _until(record: MeasuredDecay, quantity: str, error: float) -> str:
    """Describe the record needed for a requested error."""
    title, factor = TITLES[quantity], record.factor_for(quantity, error)
    now = percent(record.supported[quantity])
    if factor == 1.0:
        return f"The record determines {title} to {now} %, which is enough."
    repeats = f"{record.number_for(quantity, error)} repeated records do"
    if factor is None:
        return f"No longer record determines {title} to {100 * error:g} %: the motion has decayed; {repeats}."
    more = f"{(factor - 1.0) * record.duration:.2g} s more reduce the error of {title} from {now} to {100 * error:g} %"
    return f"{more}; {repeats} as well."


# ---- tests under a measured force


def forced_test(
    request: PlanRequest, samples: int, duration: float, energy: float, mass: float
) -> tuple[ForcedTest, float]:
    """Return a test and its unit of force (N); raises InputError for a test that is too short."""
    size = mass * request.noise
    test = ForcedTest(samples, duration, energy / size**2)
    least = math.ceil(LEAST_RATE * request.likely.fastest * duration) + 1
    if samples < least:
        fastest = f"{LEAST_RATE:g} per cycle of {request.likely.fastest:.3g} Hz"
        raise InputError("samples", samples, f"at least {least}: {fastest}")
    if line_frequencies(request.likely, test).size < LEAST_LINES:
        raise InputError("duration", f"{duration:g}", f"longer: at least {LEAST_LINES} lines below the band's end")
    return test, size


def forces_page(request: PlanRequest, test: ForcedTest, size: float, energy: float) -> tuple[str, np.ndarray]:
    """Return a table of forces with their errors, and the best force (N) for the requested quantity."""
    forces, quantity, title = Forces(request.likely, test), request.quantity, request.title
    compared = {
        "hammer blow": forces.hammer_blow(),
        "band-limited noise": forces.noise(quantity),
        "even multisine": forces.even_multisine(quantity),
        f"best pulse for {title}": forces.best_pulse(quantity),
        f"best multisine for {title}": forces.best_multisine(quantity),
        f"best for {title}": forces.best(quantity),
        "best for m, c and k": forces.best(ALL),
    }
    errors_by_force = {name: evaluate_force(request.likely, test, force) for name, force in compared.items()}
    best = errors_by_force[f"best for {title}"]
    rows = [
        {
            "force": name, "peak, N": f"{size * float(np.abs(force.force).max()):.3g}",
            **_errors(force.median, FORCED_QUANTITIES),
            "over the best": f"{force.median[quantity] / best.median[quantity]:.2f}",
        }
        for name, force in errors_by_force.items()
    ]  # fmt: skip
    tests: list[Simulation] = [
        partial(simulate_forced_tests, request.likely, test, force.force, quantity)
        for force in errors_by_force.values()
    ]
    request.simulate(rows, "counted, %", tests, lambda errors: percent(robust_deviation(errors)))
    notes = [
        f"Each force has the energy {energy:g} N² s and is measured with the motion, which starts from rest (not given "
        "to the method). Percentages are standard deviations by the Cramér-Rao bound of the finite record, with its "
        f"transient{request.median}. Over the best: ratio of the errors of {title}."
    ]
    if request.simulations:
        notes.append(
            f"Counted: standard deviation of {title} in {request.simulations} simulated tests, fitted by "
            f"{request.method}, from the median absolute error."
        )
    return _page(rows, *notes), size * best.force


# ---- expected errors of methods, from the atlas and its model


def read_atlas(path: Path, quantity: str) -> pd.DataFrame:
    """Read the atlas; raises InputError for another file, or an atlas without this quantity."""
    try:
        atlas = pd.read_csv(path)
    except (OSError, ValueError, EOFError, zlib.error):
        raise InputError("atlas", path, WRITTEN) from None
    if not {"method", f"{quantity}_core", f"{quantity}_gross"} <= set(atlas):
        raise InputError("atlas", path, WRITTEN)
    return atlas


def expected_page(point: FreeDecay, atlas: pd.DataFrame, quantity: str) -> str:
    """Return a table of methods with their expected errors; raises InputError for an atlas with too few points."""
    frame = point_frame(point)
    if why := unknown(frame, quantity):
        return wrapped(f"The atlas does not cover this test: {why}.")
    rows = []
    for name, fits in atlas.groupby("method", sort=False):
        try:
            answer = AtlasModel(fits, quantity).expected(frame)[0]
        except ValueError:  # too few points of this method
            continue
        low, middle, high = answer.excess
        spread = "-" if math.isnan(middle) else f"{middle:.2f} ({low:.2f} to {high:.2f})"
        order = (answer.gross > RARE, middle if math.isfinite(middle) else math.inf)
        row = {"method": load_method(str(name)).card.title, "error over the bound (range)": spread}
        rows.append((order, {**row, "outlier fits, %": f"{100 * answer.gross:.1f}"}))
    if not rows:
        raise InputError("atlas", "", "an atlas with more points of some method")
    bound, wrong = float(frame[f"bound_{quantity}"].iloc[0]), float(frame.wrong_basin.iloc[0])
    meaning = (
        f"The bound on the standard deviation of {TITLES[quantity]} is {100 * bound:.2g} %; in {100 * wrong:.2g} % of "
        "such records the likelihood is largest at a wrong frequency. Errors without outlier fits (beyond five times "
        "the bound), with the 80 % range of tests like this."
    )
    return _page([row for _, row in sorted(rows, key=lambda pair: pair[0])], meaning)
