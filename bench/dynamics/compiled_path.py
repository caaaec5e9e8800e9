"""Runge-Kutta steps that jax compiles, for motions that are asked for again and again.

What is compiled depends on the system, the number of sets and the number of steps. Both numbers are rounded up, so few
programmes serve many calls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from bench.dynamics.fixed_step import Steps, rk4_path, rk4_scan
from bench.systems import System

MOST_STATES = 10_000_000
"""Numbers in the states after all steps, which are all kept; numpy keeps those that are wanted."""


def compiled_path(
    system: System,
    p: Mapping[str, Any],
    state: Sequence[np.ndarray],
    steps: Steps,
    wanted: np.ndarray,
    coarse: bool = False,
) -> np.ndarray:
    """Carry a state along the steps; arguments and result are those of :func:`bench.rk4_path`.

    ``coarse``: round numbers up to powers of four, not of two (sets) and to a fourth of an octave (steps): for short
    work, where compiling takes longer than steps and sets that are in vain.
    """
    sets = state[0].shape
    many = int(np.prod(sets))
    if not many or not steps.lengths.size or len(state) * many * steps.lengths.size > MOST_STATES:
        return rk4_path(system, p, state, steps, wanted)
    whole = _power_of_four(many) if coarse else 1 << (many - 1).bit_length()
    repeated = np.minimum(np.arange(whole), many - 1)
    values = np.stack([np.broadcast_to(np.asarray(p[name], float), sets).ravel()[repeated] for name in system.names])
    lengths, forces = padded(steps, coarse)
    path = np.asarray(_carried(system)(values, np.stack([s.ravel() for s in state])[:, repeated], lengths, forces))
    picked = path[steps.reached[wanted], :, :many]
    return np.moveaxis(picked, 0, -1).reshape(len(state), *sets, wanted.size)


def padded(steps: Steps, coarse: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (n,) and forces (n, 3, n_dof) with steps of no length at the end, which move nothing."""
    used = steps.lengths.size
    part = 2 ** max(used.bit_length() - 3, 0)
    more = (_power_of_four(used) if coarse else -(-used // part) * part) - used
    return np.pad(steps.lengths, (0, more)), np.pad(steps.forces, ((0, more), (0, 0), (0, 0)))


def _power_of_four(number: int) -> int:
    """The least one that is not below a number."""
    return int(4 ** (((number - 1).bit_length() + 1) // 2))


@lru_cache(maxsize=64)
def _carried(system: System) -> Any:
    """(parameters, states, lengths, forces) -> the states before the first step and after each."""
    import jax

    jax.config.update("jax_enable_x64", True)

    def path(values: Any, start: Any, lengths: Any, pushes: Any) -> Any:
        return rk4_scan(system, dict(zip(system.names, values, strict=True)), start, lengths, pushes)

    return jax.jit(path)
