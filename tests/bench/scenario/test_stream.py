"""A stream that a method gets has the numbers of numpy's own, and says nothing of the seed that made it."""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Sequence

import numpy as np
import pytest

from bench.scenario.scenario import METHOD, Scenario
from bench.scenario.stream import anonymous_stream

SEEDS: tuple[tuple[int | list[int], tuple[int, ...]], ...] = (
    (0, ()),
    (987654321, (3, 169403677, 3821275436, 2, 77)),
    (2**40 + 5, (1,)),
    (2**200 + 3, (7, 8)),
    ([12345, 7, 1], ()),
    ([1, 2, 3, 4, 5, 2**33], (6,)),
)


def numbers(rng: np.random.Generator) -> list[float]:
    return [*rng.standard_normal(3), *rng.integers(2**60, size=3)]


@pytest.mark.parametrize(("entropy", "key"), SEEDS)
def test_numbers_and_children_are_those_of_numpy(entropy: int | list[int], key: Sequence[int]) -> None:
    ours = anonymous_stream(entropy, key)
    theirs = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=tuple(key)))
    children = [*ours.spawn(3), *ours.spawn(2)]
    expected = [*theirs.spawn(3), *theirs.spawn(2)]
    streams = [ours, *children, *children[4].spawn(2)]
    assert [numbers(rng) for rng in streams] == [numbers(rng) for rng in (theirs, *expected, *expected[4].spawn(2))]


def test_neither_attributes_nor_pickles_hold_seed_or_key(reference: Scenario) -> None:
    seed, replicate, name = 271828182, 141421, 577215664
    rng = reference.stream(METHOD, seed, replicate, name)
    secrets = {seed, replicate, name, *reference._key}
    for stream in (rng, *rng.spawn(2), pickle.loads(pickle.dumps(rng))):
        held = {value for _, value, _ in pickletools.genops(pickle.dumps(stream)) if isinstance(value, int)}
        assert not secrets & held
        sequence = stream.bit_generator.seed_seq
        assert not hasattr(sequence, "entropy")
        assert not hasattr(sequence, "spawn_key")
        assert not any(str(secret) in repr(stream) + repr(sequence) for secret in secrets)
