"""The response of a linear system by superposition of its modes: exact in time, vectorised over parameter sets."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.contract.problem import Force
from bench.dynamics.intervals import interval_polynomials, merged_grid
from bench.dynamics.mechanics import state_matrix
from bench.systems import System

DEFECTIVE = 1e7
"""Condition number of the modes beyond which a repeated root is moved apart."""


def linear_response(
    system: System, p: Mapping[str, Any], s0: np.ndarray, times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """Compute displacement and velocity from the state ``s0`` (*sets, 2 n_dof) at time 0, (2 n_dof, *sets, n_times).

    NaN where the state matrix of any set is not finite. Raises ValueError where the system is not linear.
    """
    a, b = state_matrix(system, p)
    if not np.all(np.isfinite(a)):
        return np.full((2 * system.n_dof, *s0.shape[:-1], times.size), np.nan)
    if a.shape[-1] == 2 and not forces:
        return _free_two_states(a, s0, times)
    rates, modes = np.linalg.eig(a)
    if np.max(np.linalg.cond(modes), initial=0.0) > DEFECTIVE:
        # a repeated root (critical damping): move it apart by less than any data could show
        a = a.copy()
        diagonal = np.arange(a.shape[-1])
        a[..., diagonal, diagonal] += 1e-7 * np.linalg.norm(a, axis=(-2, -1))[..., None] * (diagonal - diagonal.mean())
        if not np.all(np.isfinite(a)):  # the norm of what is nearly infinite
            return np.full((2 * system.n_dof, *s0.shape[:-1], times.size), np.nan)
        rates, modes = np.linalg.eig(a)
    inverse = np.linalg.inv(modes.astype(complex))
    q0 = (inverse @ s0[..., None])[..., 0]
    if forces:
        q = _forced_modes(rates, inverse @ b, q0, times, forces)
    else:
        q = q0[..., None] * np.exp(rates[..., None] * times)
    return np.moveaxis((modes @ q).real, -2, 0)


def _free_two_states(a: np.ndarray, s0: np.ndarray, times: np.ndarray) -> np.ndarray:
    """``exp(A t) s0`` for matrices A of two by two and any damping, shape (2, ..., n_times).

    By Cayley and Hamilton ``exp(A t) = e^(mu t) (C I + S (A - mu I))`` with ``mu`` half the trace and
    ``d = mu² - det A``: ``C, S = cos(w t), sin(w t)/w`` where ``d = -w² < 0``, and ``cosh(w t), sinh(w t)/w`` where
    ``d = w² > 0`` (Bernstein and So, IEEE Trans. Automatic Control 38:1228, 1993). No modes, so nothing is defective.
    """
    mu = 0.5 * (a[..., 0, 0] + a[..., 1, 1])[..., None]
    half = 0.5 * (a[..., 0, 0] - a[..., 1, 1])[..., None]
    d = half * half + (a[..., 0, 1] * a[..., 1, 0])[..., None]
    # the floor moves d by less than rounding does, and spares the division by zero at critical damping
    w = np.maximum(np.sqrt(np.abs(d)), 1e-8 / max(float(times[-1]), 1e-300)) if times.size else np.ones_like(d)
    angle = w * times
    cosine, sine = np.cos(angle), np.sin(angle) / w
    envelope = np.exp(mu * times)
    cosine *= envelope
    sine *= envelope
    if np.any(d > 0):
        # two decays: cosh by itself would overflow where the envelope makes up for it
        slow, fast = np.exp((mu + w) * times), np.exp((mu - w) * times)
        cosine = np.where(d > 0, 0.5 * (slow + fast), cosine)
        sine = np.where((d > 0) & (angle > 1e-5), 0.5 * (slow - fast) / w, sine)
    x, v = s0[..., :1], s0[..., 1:]
    path = np.empty((2, *sine.shape))
    np.multiply(half * x + a[..., :1, 1] * v, sine, out=path[0])
    np.multiply(a[..., 1:, 0] * x - half * v, sine, out=path[1])
    path[0] += x * cosine
    path[1] += v * cosine
    return path


def _forced_modes(
    rates: np.ndarray, gains: np.ndarray, q0: np.ndarray, times: np.ndarray, forces: Sequence[Force]
) -> np.ndarray:
    """Modal coordinates (..., n_modes, n_times) under forces that are polynomials between the times of a merged grid.

    Over one interval of length h: ``q <- e^z q + h sum_j j! phi_(j+1)(z) g_j`` with ``z = rate h`` and the modal force
    ``sum_j g_j s^j`` in the part s of the interval that has passed, exact (Hochbruck and Ostermann, Acta Numerica
    19:209, 2010, section 2.1).
    """
    grid = merged_grid(times, forces)
    wanted = np.searchsorted(grid, times)
    # lengths that differ by rounding alone share their coefficients
    tick = 1e-12 * max(grid[-1], 1e-300)
    _, first, which = np.unique(np.round(np.diff(grid) / tick), return_index=True, return_inverse=True)
    h = np.diff(grid)[first].reshape(-1, *(1,) * rates.ndim)
    z = rates * h
    growth = np.exp(z)
    pushes = np.zeros((which.size, *q0.shape), complex)
    for j, (phi, given) in enumerate(zip(_phis(z), interval_polynomials(forces, grid, gains.shape[-1]), strict=False)):
        pushes += math.factorial(j) * (h * phi)[which] * np.einsum("...ij,kj->k...i", gains, given)
    path = np.empty((grid.size, *q0.shape), complex)
    path[0] = q0
    for i, j in enumerate(which):
        np.multiply(growth[j], path[i], out=path[i + 1])
        path[i + 1] += pushes[i]
    return np.moveaxis(path[wanted], 0, -1)


def _phis(z: np.ndarray) -> Iterator[np.ndarray]:
    """``phi_1(z), phi_2(z), ...``: phi_0 = e^z and ``phi_(k+1) = (phi_k - 1/k!) / z``; near 0 the Taylor series."""
    small = np.abs(z) < 0.5
    safe, near = np.where(small, 1.0, z), np.where(small, z, 0.0)
    phi = np.expm1(safe) / safe
    for k in itertools.count(1):
        series = sum(near**i / math.factorial(i + k) for i in range(16))
        yield np.where(small, series, phi)
        phi = (phi - 1.0 / math.factorial(k)) / safe
