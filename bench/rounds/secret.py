"""Random streams of a secret seed, whose numbers do not tell any other number of the seed.

A round publishes samples, times and forces that were drawn. numpy's streams would not keep the rest secret: their state
can be computed from enough of their output (C. Bouillaguet et al., Practical seed-recovery for the PCG pseudo-random
number generator, IACR Trans. Symmetric Cryptol. 2020(3):175), and a seed sequence can be inverted from a state. Here
each stream has a key of its own, HMAC-SHA256 of the seed and of what the stream is for, and its numbers are the bits
of SHAKE-256 of that key (FIPS 202). From the noise of a problem, known exactly, nothing follows for the parameters, the
nominal values or another problem, short of inverting these functions or trying 2^256 seeds.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from bench.scenario.scenario import Scenario

BITS = 256
"""Bits of a secret seed."""


def new_seed() -> int:
    """Return a secret seed from the operating system's source of randomness."""
    return secrets.randbits(BITS)


def derived_key(seed: int, *purpose: object) -> int:
    """Return the key of a purpose: HMAC-SHA256 of the seed and the purpose as JSON."""
    text = json.dumps(purpose).encode()
    return int.from_bytes(hmac.digest(seed.to_bytes(BITS // 8, "big"), text, "sha256"), "big")


class SecretStream:
    """A stream of random numbers by a key, with those functions of ``numpy.random.Generator`` that scenarios use."""

    def __init__(self, key: int) -> None:
        self._key, self._calls = key, 0

    def random(self, size: int | Sequence[int] | None = None) -> Any:
        """Draw numbers that are uniform in (0, 1), with 53 bits."""
        shape = () if size is None else tuple(np.atleast_1d(size))
        call = self._key.to_bytes(BITS // 8, "big") + self._calls.to_bytes(8, "big")
        self._calls += 1
        words = np.frombuffer(hashlib.shake_256(call).digest(8 * int(np.prod(shape))), "<u8")
        return (((words >> np.uint64(11)) + 0.5) * 2.0**-53).reshape(shape)[()]

    def uniform(self, low: float, high: float, size: int | Sequence[int] | None = None) -> Any:
        """Draw numbers that are uniform between two ends."""
        return low + (high - low) * self.random(size)

    def standard_normal(self, size: int | Sequence[int] | None = None) -> Any:
        """Draw standard normal numbers, by the inverse of their distribution function."""
        from scipy.special import ndtri

        return ndtri(self.random(size))

    def choice(self, options: Sequence[Any]) -> Any:
        """Draw one of some options, each equally likely."""
        return options[int(self.random() * len(options))]


class SecretScenario(Scenario):
    """A scenario whose random streams are those of a secret key, given in place of the seed."""

    @classmethod
    def of(cls, scenario: Scenario) -> SecretScenario:
        """Return the same scenario with secret streams."""
        return cls(**{field.name: getattr(scenario, field.name) for field in fields(scenario)})

    def stream(self, axis: int, seed: int, replicate: int, *key: int) -> Any:
        return SecretStream(derived_key(seed, "stream", axis, replicate, *key))
