"""Random streams of a secret seed; the numbers of some streams do not reveal those of others.

A round publishes what was drawn: samples, times, forces. From enough output of numpy's generators their state can be
computed (C. Bouillaguet et al., Practical seed-recovery for the PCG pseudo-random number generator, IACR Trans.
Symmetric Cryptol. 2020(3):175), and from that state the seed sequence. Here every stream has its own key, the
HMAC-SHA256 of the seed and the purpose of the stream, and its numbers are bits of SHAKE-256 of that key (FIPS 202).
Even the exact noise of a problem reveals neither its parameters, nor its nominal values, nor another problem, except by
inverting these functions or trying 2^256 seeds.
"""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from bench.scenario.scenario import Scenario

SEED_BYTES = 32
Size = int | Sequence[int] | None


def derived_key(seed: int, *purpose: object) -> int:
    """Return the key for a purpose, as large as a seed."""
    digest = hmac.digest(seed.to_bytes(SEED_BYTES, "big"), json.dumps(purpose).encode(), "sha256")
    return int.from_bytes(digest, "big")


class SecretStream:
    """Random numbers by a key, with those functions of ``numpy.random.Generator`` that scenarios use."""

    def __init__(self, key: int) -> None:
        self._key, self._calls = key, 0

    def random(self, size: Size = None) -> Any:
        """Draw numbers that are uniform in (0, 1), with 53 bits."""
        shape = () if size is None else tuple(np.atleast_1d(size))
        call = derived_key(self._key, self._calls).to_bytes(SEED_BYTES, "big")
        self._calls += 1
        words = np.frombuffer(hashlib.shake_256(call).digest(8 * int(np.prod(shape))), "<u8")
        return (((words >> np.uint64(11)) + 0.5) * 2.0**-53).reshape(shape)[()]

    def uniform(self, low: float, high: float, size: Size = None) -> Any:
        """Draw numbers that are uniform between two ends."""
        return low + (high - low) * self.random(size)

    def standard_normal(self, size: Size = None) -> Any:
        """Draw standard normal numbers, by the inverse of their distribution function."""
        from scipy.special import ndtri

        return ndtri(self.random(size))

    def chisquare(self, df: float, size: Size = None) -> Any:
        """Draw chi-square numbers, by the inverse of their distribution function."""
        from scipy.special import gammaincinv

        return 2.0 * gammaincinv(df / 2.0, self.random(size))

    def choice(self, options: Sequence[Any]) -> Any:
        """Draw one of some options, each equally likely."""
        return options[int(self.random() * len(options))]


class SecretScenario(Scenario):
    """A scenario whose random streams are those of a secret key, which is given in place of the seed."""

    @classmethod
    def of(cls, scenario: Scenario) -> SecretScenario:
        """Return the same scenario with secret streams."""
        return cls(**{field.name: getattr(scenario, field.name) for field in fields(scenario)})

    def stream(self, axis: int, seed: int, replicate: int, *key: int) -> Any:
        return SecretStream(derived_key(seed, axis, replicate, *key))
