"""sdypy-EMA 0.31 (MIT, https://github.com/sdypy/sdypy-EMA) on frequency responses; averages by pyFRF 1.5.

Poles are those of its least-squares complex frequency method (LSCF), orders 1 to 60 as in its introduction; shapes are
those of its least-squares frequency domain method (LSFD), with residuals below and above. A person picks poles off its
chart; here whatever stays, within its own tolerances (frequency 0.1 %, damping 5 %), through half of the orders, and of
it the pole with the median damping. Its ``select_closest_poles`` is not used: it takes frequencies that are known
before, and averages within 25 Hz of these.

Blows are averaged to H1 by pyFRF (MIT, https://github.com/ladisk/pyFRF) as by a person with a hammer: a force window
up to the end of the pulse, and an exponential window down to 1 % where the response has not ended by itself, whose
damping is taken off. Both are put on here: its own windows scale the response by their mean, and shapes with it. No
uncertainty is stated.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bench import (
    Blows,
    FrequencyResponses,
    InputError,
    ModalCard,
    ModalEstimate,
    ModalIdentifier,
    ModalProblem,
    Mode,
    Status,
)  # fmt: skip
from methods.modal.stabilisation import linked
from methods.starts.search_range import unevenness

FREQUENCY_STAYS, DAMPING_STAYS = 0.001, 0.05
"""Tolerances of the package's chart."""
PULSE = 0.1
"""Of a force's peak: above it, well out of the noise, is the pulse; the window is open as long again after it."""
ENDED = 0.01
"""Of a response's peak, below which a record has ended; and what an exponential window leaves at the end."""
DERIVATIVES = {"receptance": "d", "mobility": "v", "accelerance": "a"}


@dataclass(frozen=True)
class EMA(ModalIdentifier):
    """Orders 1 to ``order``, of as many pairs of poles."""

    order: int = 60

    scope: ClassVar[tuple[type, ...]] = (Blows, FrequencyResponses)
    requires: ClassVar[tuple[str, ...]] = ("sdypy", "pyFRF")
    extra: ClassVar[str] = "rivals"
    card: ClassVar[ModalCard] = ModalCard(
        "LSCF and LSFD of the package sdypy-EMA, poles that stay on its chart; averages H1 of the package pyFRF",
        "sdypy-EMA 0.31 and pyFRF 1.5 as they ship, order 60 as in the introduction",
        "sdypy-EMA",
        200,
    )

    def __post_init__(self) -> None:
        if self.order < 2:
            raise InputError("method.order", self.order, "at least 2")

    def objection(self, problem: ModalProblem) -> str | None:
        """It needs frequency responses at even lines."""
        if isinstance(problem.data, FrequencyResponses) and unevenness(problem.data.frequencies):
            return "it needs frequency responses at even steps of frequency"
        return super().objection(problem)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Average, fit poles of all orders, pick those that stay, and fit their shapes."""
        from sdypy.EMA import Model

        data = averaged(problem.data) if isinstance(problem.data, Blows) else problem.data
        assert isinstance(data, FrequencyResponses)
        lines = data.frequencies
        low, high = problem.band or (lines[lines > 0][0], lines[-1])
        order = min(self.order, int(np.sum((lines >= low) & (lines <= high))) // 2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = Model(data.values, lines, lower=low, upper=high, pol_order_high=order, frf_form=data.response)
            model.get_poles(show_progress=False)
            rates = [np.asarray(poles) for poles in model.all_poles]
            chains = linked(
                rates, [np.ones((1, poles.size)) for poles in rates], np.inf, FREQUENCY_STAYS, DAMPING_STAYS
            )
            model.pole_ind = [_middle(chain, rates) for chain in chains if 2 * len(chain) >= order]
            model.pole_ind = [(at, i) for at, i in model.pole_ind if low <= abs(rates[at][i]) / (2 * np.pi) <= high]
            if not model.pole_ind:
                return ModalEstimate((), status=Status.DIVERGED, message="no pole stays on its chart")
            _, residues = model.get_constants()
        poles = np.array([rates[at][i] for at, i in model.pole_ind])
        s = 2j * np.pi * model.freq[:, None, None]
        parts = residues / (s - poles) + residues.conj() / (s - poles.conj())
        parts *= s ** list(DERIVATIVES).index(data.response)
        shares = np.linalg.norm(parts, axis=(0, 1)) / np.linalg.norm(model.frf)
        strongest = np.argsort(-shares)[: problem.count or len(poles)]
        nothing, unknown = np.full((2, 2), np.nan), np.full(len(residues), np.nan)
        modes = [Mode.of_pole(poles[i] + data.window, nothing, residues[:, i], unknown, shares[i]) for i in strongest]
        said = f"{len(poles)} poles stay through half of the orders 1 to {order}"
        return ModalEstimate(tuple(sorted(modes, key=lambda mode: mode.frequency)), message=said)


def _middle(chain: list[tuple[int, int]], rates: list[np.ndarray]) -> tuple[int, int]:
    """Return the pole with the median damping."""
    return sorted(chain, key=lambda at: rates[at[0]][at[1]].real)[len(chain) // 2]


def averaged(blows: Blows) -> FrequencyResponses:
    """Average H1 by pyFRF, with the windows of a hammer."""
    from pyFRF import FRF

    samples = blows.forces.shape[1]
    peaks = np.max(np.abs(blows.forces), axis=1, keepdims=True)
    above = np.flatnonzero(np.any(np.abs(blows.forces) > PULSE * peaks, axis=0))
    pulse = np.arange(samples) <= 2 * above[-1] - above[0] + 1
    last = np.sqrt(np.mean(blows.responses[..., -samples // 10 :] ** 2, axis=2))
    ended = np.all(last < ENDED * np.max(np.abs(blows.responses), axis=2))
    rate = 0.0 if ended else -np.log(ENDED) / (samples * blows.step)
    window, inside = (np.exp(-decay * blows.step * np.arange(samples)) for decay in (rate, blows.window))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # it takes whole numbers of Hz only: one a sample here
        forces, responses = blows.forces * pulse * window * inside, blows.responses * window
        average = FRF(1, forces[:, None], responses, "f", DERIVATIVES[blows.response])
        values = average.get_FRF(frf_form=blows.response)[:, 0]
    values[:, 0] = 0.0  # of motion without vibration: zero by zero
    return FrequencyResponses(average.get_f_axis() / blows.step, values, blows.response, window=blows.window + rate)
