"""What one mass under a known force shows on the lines of the DFT, as a function of k/m, c/m and m.

The motion is the periodic response to the force, repeated after N steps h of time, plus a free vibration from whatever
start. The first has the harmonics ``G(s) F``, ``G(s) = 1 / (m s² + c s + k)``, which sampling folds. Samples of the
second obey ``y(n) + a1 y(n-1) + a2 y(n-2) = 0``, with ``A(z) = 1 + a1/z + a2/z²`` of the roots ``e^(lambda h)``, lambda
those of ``m s² + c s + k``; the DFT of N of them is exactly ``T(z_k) / A(z_k)`` with ``T = t0 + t1/z``, where
``z_k = e^(2 pi i k / N)``, since the terms of both ends of the record stand at the same powers of z_k (R. Pintelon, J.
Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, section 6.3: leakage as a transient over
the denominator of the system). So no window is needed, and nothing is approximate but the number of harmonics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from methods.spectral.lines import folded, real_lines


@dataclass(frozen=True, eq=False)
class HarmonicLayout:
    """Even samples: their number and step; the harmonics (K,) of the known force, of no length where there is none."""

    samples: int
    step: float
    harmonics: np.ndarray

    @property
    def forced(self) -> bool:
        """Whether a force acts."""
        return self.harmonics.size > 0


def transient(layout: HarmonicLayout, r: float, g: float) -> tuple[np.ndarray, np.ndarray]:
    """The two columns (N, 2) of a free vibration of k/m = ``r`` and c/m = ``g``; their derivatives by both (2, N, 2).

    The columns are those of T = 1 and of T = 1/z.
    """
    h, d = layout.step, 0.5 * g
    root = np.sqrt(complex(d**2 - r))
    one, two = np.exp((-d + root) * h), np.exp((-d - root) * h)
    product = np.exp(-g * h)
    # e^(-dh) sinh(root h) / root, the same for a real and an imaginary root, and finite where it is zero
    ratio = float(((one - two) / (2 * root)).real) if abs(root) * h > 1e-6 else h * np.exp(-d * h)
    total = float((one + two).real)
    delay = np.exp(-2j * np.pi * np.arange(layout.samples // 2 + 1) / layout.samples)
    a = 1.0 - total * delay + product * delay**2
    by_r = h * ratio * delay
    by_g = (0.5 * h * total - 0.5 * h * g * ratio) * delay - h * product * delay**2
    columns = np.stack([1.0 / a, delay / a])
    slopes = np.stack([-columns * by_r / a, -columns * by_g / a])
    return real_lines(columns, layout.samples).T, real_lines(slopes, layout.samples).swapaxes(1, 2)


def forced_lines(layout: HarmonicLayout, m: float, c: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """The periodic response to the force (N,), and its derivatives by m, c and k (3, N)."""
    force, samples = layout.harmonics, layout.samples
    s = 2j * np.pi * np.arange(force.size) / (samples * layout.step)
    g = 1.0 / (m * s**2 + c * s + k)
    response = g * force
    slopes = -g * response * np.stack([s**2, s, np.ones_like(s)])
    every = real_lines(folded(np.concatenate([response[None], slopes]), samples), samples)
    return every[0], every[1:]
