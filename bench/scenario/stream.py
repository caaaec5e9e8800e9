"""Random streams whose seed cannot be read from them: same numbers and same children, without entropy and key.

``Generator.bit_generator.seed_seq`` of numpy holds the seed and the spawn key, from which a method could draw the
nominal values of a scenario again and so compute its truth. These streams hold the hashed pool of the seed sequence
instead, which ``spawn`` continues as numpy does (M. E. O'Neill, "Developing a seed_seq alternative", 2015;
``numpy/random/bit_generator.pyx``). The hash is no cipher: see SECURITY.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISpawnableSeedSequence

WORD = 0xFFFFFFFF
POOL = 4
"""Words of 32 bits in the pool of a seed sequence; numpy's default."""
INIT, MULTIPLIER = 0x43B0D7E5, 0x931E8875
MIX_LEFT, MIX_RIGHT = 0xCA01F9DD, 0x4973F715
SHIFT = 16


class AnonymousSeedSequence(ISpawnableSeedSequence):
    """The hashed pool of a seed sequence of ``n_words`` words, without the words.

    Args:
        pool: The pool, four words.
        n_words: Words hashed so far, at least four.
    """

    def __init__(self, pool: Sequence[int], n_words: int) -> None:
        self.pool, self.n_words = tuple(pool), n_words
        self.n_children_spawned = 0

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> np.ndarray:
        """Return the words that seed a bit generator, as ``SeedSequence.generate_state`` does."""
        sequence = np.random.SeedSequence(0)
        sequence.pool[:] = self.pool
        return sequence.generate_state(n_words, dtype)

    def spawn(self, n_children: int) -> list[AnonymousSeedSequence]:
        """Return the children that the seed sequence itself would have spawned."""
        first, self.n_children_spawned = self.n_children_spawned, self.n_children_spawned + n_children
        return [self._child(i) for i in range(first, first + n_children)]

    def _child(self, number: int) -> AnonymousSeedSequence:
        """Hash the number of a child into the pool, which is what a longer spawn key does."""
        constant = INIT * pow(MULTIPLIER, POOL * self.n_words, WORD + 1) & WORD
        pool = []
        for word in self.pool:
            hashed, constant = number ^ constant, constant * MULTIPLIER & WORD
            hashed = hashed * constant & WORD
            mixed = (MIX_LEFT * word - MIX_RIGHT * (hashed ^ hashed >> SHIFT)) & WORD
            pool.append(mixed ^ mixed >> SHIFT)
        return AnonymousSeedSequence(pool, self.n_words + 1)


def anonymous_stream(entropy: int | Sequence[int], spawn_key: Sequence[int] = ()) -> np.random.Generator:
    """Return the generator of ``SeedSequence(entropy, spawn_key)`` without its entropy and key."""
    sequence = np.random.SeedSequence(entropy, spawn_key=tuple(spawn_key))
    words = sum(max(1, -(-int(part).bit_length() // 32)) for part in np.atleast_1d(np.array(entropy, dtype=object)))
    n_words = max(POOL, words) + len(spawn_key)
    pool: Sequence[int] = sequence.pool.tolist()
    seeds: Any = AnonymousSeedSequence(pool, n_words)
    return np.random.Generator(np.random.PCG64(seeds))
