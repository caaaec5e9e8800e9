"""sdypy-EMA 0.31 (MIT, https://github.com/sdypy/sdypy-EMA) on frequency responses; averages by pyFRF 1.5.

Poles come from its least-squares complex frequency method (LSCF) with orders 1 to 60 as in its introduction, shapes
from its least-squares frequency domain method (LSFD) with lower and upper residuals. Users select poles in its
stabilisation chart; here poles are selected that are stable within its tolerances (frequency 0.1 %, damping 5 %) over
half of the orders, with the median damping. Its ``select_closest_poles`` is not used, since it requires known
frequencies and averages within 25 Hz of these.

Hammer impacts are averaged to H1 by pyFRF (MIT, https://github.com/ladisk/pyFRF), with a force window up to the end of
the pulse, and an exponential window down to 1 % for responses that have not decayed, whose damping is subtracted. The
windows are applied here, since those of the package scale response and shapes by their mean. There is no uncertainty.
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
"""Tolerances of the package's stabilisation chart."""
PULSE = 0.1
"""Fraction of a force's peak above which samples belong to the pulse; the window is twice as long."""
ENDED = 0.01
"""Fraction of a response's peak below which it has decayed, and final value of the exponential window."""
DERIVATIVES = {"receptance": "d", "mobility": "v", "accelerance": "a"}


@dataclass(frozen=True)
class EMA(ModalIdentifier):
    """LSCF and LSFD of sdypy-EMA with orders 1 to ``order`` (pairs of poles)."""

    order: int = 60

    scope: ClassVar[tuple[type, ...]] = (Blows, FrequencyResponses)
    requires: ClassVar[tuple[str, ...]] = ("sdypy", "pyFRF")
    extra: ClassVar[str] = "rivals"
    card: ClassVar[ModalCard] = ModalCard(
        "LSCF and LSFD of the package sdypy-EMA, stable poles of its chart; H1 averages of the package pyFRF",
        "defaults of sdypy-EMA 0.31 and pyFRF 1.5, order 60 as in the introduction",
        "sdypy-EMA",
        200,
    )

    def __post_init__(self) -> None:
        if self.order < 2:
            raise InputError("method.order", self.order, "at least 2")

    def objection(self, problem: ModalProblem) -> str | None:
        """Require frequency responses at evenly spaced frequencies."""
        if isinstance(problem.data, FrequencyResponses) and unevenness(problem.data.frequencies):
            return "it requires frequency responses at even steps of frequency"
        return super().objection(problem)

    def identify_modes(self, problem: ModalProblem) -> ModalEstimate:
        """Average, fit poles of all orders, select the stable ones, and fit their shapes."""
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
            model.pole_ind = [(n, i) for n, i in model.pole_ind if low <= abs(rates[n][i]) / (2 * np.pi) <= high]
            if not model.pole_ind:
                return ModalEstimate((), status=Status.DIVERGED, message="no pole is stable over the orders")
            _, residues = model.get_constants()
        poles = np.array([rates[n][i] for n, i in model.pole_ind])
        s = 2j * np.pi * model.freq[:, None, None]
        parts = residues / (s - poles) + residues.conj() / (s - poles.conj())
        parts *= s ** list(DERIVATIVES).index(data.response)
        shares = np.linalg.norm(parts, axis=(0, 1)) / np.linalg.norm(model.frf)
        strongest = np.argsort(-shares)[: problem.count or len(poles)]
        nothing, unknown = np.full((2, 2), np.nan), np.full(len(residues), np.nan)
        modes = [Mode.of_pole(poles[i] + data.window, nothing, residues[:, i], unknown, shares[i]) for i in strongest]
        message = f"{len(poles)} poles are stable over half of the orders 1 to {order}"
        return ModalEstimate(tuple(sorted(modes, key=lambda mode: mode.frequency)), message=message)


def _middle(chain: list[tuple[int, int]], rates: list[np.ndarray]) -> tuple[int, int]:
    """Return the pole with the median damping."""
    return sorted(chain, key=lambda link: rates[link[0]][link[1]].real)[len(chain) // 2]


def averaged(blows: Blows) -> FrequencyResponses:
    """Average H1 by pyFRF, with force and exponential windows."""
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
        # the package supports integer sampling rates only: 1 Hz here
        forces, responses = blows.forces * pulse * window * inside, blows.responses * window
        average = FRF(1, forces[:, None], responses, "f", DERIVATIVES[blows.response])
        values = average.get_FRF(frf_form=blows.response)[:, 0]
    values[:, 0] = 0.0  # 0/0 at zero frequency for a response without a mean
    return FrequencyResponses(average.get_f_axis() / blows.step, values, blows.response, window=blows.window + rate)
