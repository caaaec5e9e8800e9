"""Groups of repeats: of measured records (../shared/data), and simulated ones whose repeats differ as real ones do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.signal import lfilter

HELD_OUT = {"furuta", "drag", "wheel, axial", "tail"}
"""Measured groups that nothing was chosen by; of the simulated ones those of odd numbers."""
KINDS = ("linear", "coloured", "friction", "quadratic", "pendulum", "second mode", "wobble", "temperature")


@dataclass(frozen=True, eq=False)
class Group:
    """Repeats of one rig: times (s) and values of each, and what they measure."""

    name: str
    repeats: tuple[tuple[np.ndarray, np.ndarray], ...]
    measures: Literal["displacement", "velocity"] = "displacement"
    held_out: bool = False


def measured(data: Path) -> Iterator[Group]:
    """Read the measured groups; parts of one record where a rig has no more."""

    def text(name: str, columns: tuple[int, int], skip: int = 0, delimiter: str | None = ",") -> np.ndarray:
        return np.genfromtxt(data / name, delimiter=delimiter, skip_header=skip, usecols=columns, encoding="utf-8-sig")

    def parts(rows: np.ndarray, count: int, step: int = 1) -> list[np.ndarray]:
        return [part[::step] for part in np.array_split(rows[np.all(np.isfinite(rows), axis=1)], count)]

    track = text("schmidt_lipson_airtrack/real_linear_h_1.txt", (1, 2), 1, None)
    arm = text("multiarm_single_pendulum/free_decay_theta_100hz.csv", (0, 1), 1)
    tail = text("multiarm_single_pendulum/tail_theta_100hz.csv", (0, 1), 1)
    swing = text("schmidt_lipson_pendulum/real_pend_h_1.txt", (1, 2), 1, None) / [5.0, 1.0]
    masses = [text(f"pendulum_masses/q4b_data{i}.csv", (0, 1), 1) for i in range(2, 6)]
    drag = [text(f"pendulum_drag/{name}", (0, 1), 0, None) for name in ("trial1_rawdata.txt", "lab1_data.txt")]
    wheel = {name: text(f"bicycle_wheel/{name}.csv", (0, 1), 1) for name in ("radial", "axial")}
    furuta = []
    for i in (3, 1, 2):
        angles = np.loadtxt(data / f"furuta_free_swing/pendulum_free_swing_data_0{i}.txt", skiprows=2)[1000::4]
        furuta.append(np.column_stack([np.arange(angles.size) / 250.0, np.deg2rad(angles)]))
    groups = {
        "air track": parts(track, 3), "multiarm": parts(arm, 5, 2), "tail": parts(tail, 3), "masses": masses,
        "furuta": furuta, "drag": drag, "pendulum": parts(swing, 4), "wheel, radial": parts(wheel["radial"], 2, 2),
        "wheel, axial": parts(wheel["axial"], 2, 4),
    }  # fmt: skip
    for name, rows in groups.items():
        repeats = tuple((part[:, 0] - part[0, 0], part[:, 1]) for part in rows)
        yield Group(name, repeats, "velocity" if "wheel" in name else "displacement", name in HELD_OUT)


def simulated(count: int, seed: int = 0) -> Iterator[Group]:
    """Draw groups of every kind; the i-th of a kind depends on the seed and on i alone."""
    for number, kind in enumerate(KINDS):
        for i in range(count):
            yield _simulated(kind, i, np.random.default_rng([seed, number, i]))


def _simulated(kind: str, i: int, rng: np.random.Generator) -> Group:
    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    n = int(rng.integers(3, 7))
    damping_ratio, cycles = between(0.001, 0.05), between(6.0, 80.0)
    cycles = max(min(cycles, 0.8 / damping_ratio), 6.0)
    t = np.linspace(0.0, cycles, int(min(max(cycles * between(8.0, 60.0), 100), 3000)))
    k = (2 * np.pi) ** 2 * np.exp(between(0.0005, 0.008) * rng.standard_normal(n))
    c = 4 * np.pi * damping_ratio * np.exp(between(0.02, 0.15) * rng.standard_normal(n))
    size = np.exp(between(0.03, 0.3) * rng.standard_normal(n))
    if kind == "pendulum":
        size *= between(0.2, 1.2)
    friction = between(0.002, 0.02) * (2 * np.pi) ** 2 * (kind == "friction") * np.exp(0.1 * rng.standard_normal(n))
    quadratic = between(0.2, 3.0) * damping_ratio * (kind == "quadratic") * np.ones(n)
    warming = (between(0.001, 0.01) * (kind == "temperature")) * rng.choice([-1.0, 1.0])
    x = _motion(t, k, c, size, friction, quadratic, warming, kind == "pendulum")
    noise = rng.standard_normal((n, t.size))
    sigma = 10 ** (-rng.uniform(20.0, 45.0) / 20.0)
    if kind == "coloured":
        noise = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], noise, axis=1)
    if kind == "wobble":
        slow = lfilter([1.0], [1.0, -0.995], rng.standard_normal((n, t.size + 2000)), axis=1)[:, 2000:]
        noise = noise + 3.0 * slow / np.std(slow)
    if kind == "second mode":
        rate, share = between(1.3, 6.0), between(0.03, 0.25)
        phase = rng.uniform(0, 2 * np.pi, (n, 1))
        x = x + share * size[:, None] * np.exp(-2 * np.pi * rate * 0.01 * t) * np.cos(2 * np.pi * rate * t + phase)
    y = x + sigma * np.std(x, axis=1, keepdims=True) * noise
    step = between(1e-4, 1e-2) * np.max(np.abs(y))
    return Group(f"{kind} {i}", tuple((t, row) for row in np.round(y / step) * step), held_out=bool(i % 2))


def _motion(
    t: np.ndarray, k: np.ndarray, c: np.ndarray, size: np.ndarray, friction: np.ndarray, quadratic: np.ndarray,
    warming: float, turns: bool,
) -> np.ndarray:  # fmt: skip
    """Integrate ``x'' + c x' + quadratic |x'| x' + friction sign(x') + k(t) x = 0`` from ``size`` and rest."""
    steps = max(int(np.ceil((t[1] - t[0]) * 60.0)), 1)
    h = (t[1] - t[0]) / steps

    def rate(at: float, y: np.ndarray) -> np.ndarray:
        x, v = y
        spring = k * (1.0 + warming * at / t[-1]) * (np.sin(x) if turns else x)
        return np.array([v, -spring - c * v - quadratic * np.abs(v) * v - friction * np.tanh(v / 2e-2)])

    y, rows = np.array([size, np.zeros_like(size)]), [size]
    for i in range((t.size - 1) * steps):
        at = i * h
        a = rate(at, y)
        b = rate(at + h / 2, y + h / 2 * a)
        d = rate(at + h / 2, y + h / 2 * b)
        e = rate(at + h, y + h * d)
        y = y + h / 6 * (a + 2 * b + 2 * d + e)
        if (i + 1) % steps == 0:
            rows.append(y[0])
    return np.array(rows).T
