"""Kinds of records that real ones resemble, each drawn with a random truth."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81
Kind = Callable[[np.random.Generator, Path], "Case"]


@dataclass(frozen=True)
class Case:
    """A record (files, or arrays as :func:`bench.identify` takes them), its truth, and what an answer has to say.

    ``truth``: true values by quantity; a quantity with None need only have an interval that can be printed.
    ``says``: a pattern that the notes and reasons, or the refusal, have to match. ``refusal``: whether an answer
    may be refused or withdrawn. ``never``: whether the verdict must not be *trust*. ``frequencies`` (Hz) have to be
    named in the notes and reasons where the values are not of them.
    """

    data: Any
    truth: Mapping[str, float | None]
    fields: Mapping[str, Any] = field(default_factory=dict)
    says: str = ""
    refusal: bool = False
    never: bool = False
    frequencies: tuple[float, ...] = ()


@dataclass(frozen=True)
class Decay:
    """A free decay at even times, with its displacement (m), velocity and acceleration; ``w``: 2 pi f (rad/s)."""

    t: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    w: float
    s: float
    rate: float

    @property
    def truth(self) -> dict[str, float | None]:
        return {"k_over_m": self.w**2, "c_over_m": 2 * self.s}


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def decay(
    rng: np.random.Generator,
    frequency: tuple[float, float] = (0.5, 40.0),
    ratio: tuple[float, float] = (0.004, 0.03),
    cycles: tuple[float, float] = (12.0, 30.0),
    a_cycle: tuple[float, float] = (15.0, 50.0),
    after: float = 0.0,
) -> Decay:
    """Draw a viscous decay that loses at least half of its amplitude, from ``after`` (s) of rest at its initial value.

    Args:
        rng: The random stream.
        frequency: Range of the natural frequency (Hz).
        ratio: Range of the damping ratio.
        cycles: Range of the length.
        a_cycle: Range of the samples a cycle.
        after: Time of the release, in cycles; the mass is held still before.
    """
    w, z = 2 * np.pi * log_uniform(rng, *frequency), log_uniform(rng, *ratio)
    rate = w / (2 * np.pi) * rng.uniform(*a_cycle)
    number = max(rng.uniform(*cycles), 0.7 / (2 * np.pi * z))
    t = np.arange(int((number + after) * 2 * np.pi / w * rate)) / rate
    amplitude, phase, s = log_uniform(rng, 0.002, 0.05), 0.0 if after else rng.uniform(0, 2 * np.pi), z * w
    pole = complex(-s, np.sqrt(w * w - s * s))
    release = 2 * np.pi * after / w
    # held at 1 and released at rest: 1 - i s / w_d in place of the phase alone
    start = amplitude * (complex(1.0, -s / pole.imag) if after else np.exp(1j * phase))
    path = start * np.exp(pole * np.clip(t - release, 0, None))
    moving = t >= release
    x, v, a = (np.real(path * pole**order) * (moving | (order == 0)) for order in range(3))
    return Decay(t, x, v, a, w, s, rate)


def friction_decay(
    rng: np.random.Generator, swings: tuple[float, float], a_cycle: float = 30.0, amplitude: float | None = None,
    rig: tuple[float, float, float] | None = None, length: float = 1.5,
) -> tuple[Decay, float]:  # fmt: skip
    """Draw a decay that dry friction stops after so many ``swings``; returns it with friction over mass (m/s²)."""
    w, z = (2 * np.pi * log_uniform(rng, 0.7, 5.0), log_uniform(rng, 0.005, 0.03)) if rig is None else rig[:2]
    size = log_uniform(rng, 0.01, 0.05) if amplitude is None else amplitude
    mu = size * w * w / (4.0 * rng.uniform(*swings)) if rig is None else rig[2]
    stop = size * w * w / (4.0 * mu) * 2 * np.pi / w
    t, narrow = np.arange(0, length * stop, 2 * np.pi / w / a_cycle), 1e-4 * w * size

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -w * w * y[0] - 2 * z * w * y[1] - mu * float(np.tanh(y[1] / narrow))]

    x, v = solve_ivp(rates, (0, t[-1]), [size, 0], t_eval=t, rtol=1e-7, atol=1e-9 * size, method="LSODA").y
    a = np.array([rates(0, y)[1] for y in np.c_[x, v]])
    return Decay(t, x, v, a, w, z * w, w * a_cycle / 2 / np.pi), mu


def noisy(rng: np.random.Generator, values: np.ndarray, part: float = 0.01) -> np.ndarray:
    """Add white noise of this part of the largest value."""
    return np.asarray(values + part * float(np.max(np.abs(values))) * rng.standard_normal(values.size))


def rounded(values: np.ndarray, steps: float) -> np.ndarray:
    """Round to a resolution of so many steps from the mean to the largest value."""
    step = float(np.max(np.abs(values))) / steps
    return np.asarray(np.round(values / step) * step)


def csv(path: Path, header: str, *columns: np.ndarray, fmt: str = "%.8g", end: str = "") -> Path:
    rows = (",".join(fmt % value for value in row) + end for row in np.column_stack(columns))
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


# --- the sensors: an offset, a drift, gravity, limits -----------------------------------------------------------------


def acceleration_offset(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng)
    a = noisy(rng, d.a, 0.02) + rng.choice([-1, 1]) * rng.uniform(0.1, 1.0) * np.max(np.abs(d.a))
    return Case(csv(to / "a.csv", "t [s],a [m/s^2]", d.t, a), d.truth)


def gravity(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, frequency=(0.4, 3.0))
    a = noisy(rng, d.a / np.max(np.abs(d.a)) * rng.uniform(0.3, 2.0), 0.03)
    return Case(csv(to / "a.csv", "t [s],a [m/s^2]", d.t, a - GRAVITY), d.truth)


def velocity_offset(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng)
    v = noisy(rng, d.v, 0.02) + rng.choice([-1, 1]) * rng.uniform(0.1, 1.0) * np.max(np.abs(d.v))
    return Case(csv(to / "v.csv", "t [s],v [m/s]", d.t, v), d.truth)


def gyroscope_offset(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, frequency=(0.4, 3.0))
    v = d.v / np.max(np.abs(d.v)) * rng.uniform(0.1, 0.6)
    v = noisy(rng, v, 0.02) + rng.choice([-1, 1]) * rng.uniform(0.02, 0.2)
    return Case(csv(to / "g.csv", "t [s],angular velocity [rad/s]", d.t, v), d.truth)


def drifting(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng)
    name, header = (("x", "x [m]"), ("v", "v [m/s]"), ("a", "a [m/s^2]"))[rng.integers(3)]
    y = getattr(d, name)
    slope = rng.choice([-1, 1]) * rng.uniform(0.2, 1.0) * np.max(np.abs(y)) * d.t / d.t[-1]
    return Case(csv(to / "y.csv", f"t [s],{header}", d.t, noisy(rng, y, 0.02) + slope), d.truth)


def flat_turning_points(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, a_cycle=(100.0, 200.0))
    x = rounded(noisy(rng, d.x), rng.uniform(15, 40))
    return Case(csv(to / "x.csv", "t [s],x [m]", d.t, x), d.truth)


def clipped(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng)
    limit = rng.uniform(0.4, 0.7) * np.max(np.abs(d.x))
    x = np.clip(noisy(rng, d.x, 0.003), -limit, limit)
    x = x + 1e-4 * limit * rng.standard_normal(x.size) * rng.integers(2)  # half of them with noise behind the limit
    return Case(csv(to / "x.csv", "t [s],x [m]", d.t, x), d.truth, says="clip|limit|saturat", refusal=True)


# --- the start and the end --------------------------------------------------------------------------------------------


def dies_out(rng: np.random.Generator, to: Path) -> Case:
    d, _ = friction_decay(rng, (7.0, 15.0), length=rng.uniform(1.5, 3.0))
    x = rounded(noisy(rng, d.x, 0.01), rng.uniform(20, 60))
    return Case(csv(to / "x.csv", "t [s],x [m]", d.t, x), {"k_over_m": d.w**2, "c_over_m": None})


def silence(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, after=rng.uniform(0.6, 6.0))
    name = ("x", "v", "a")[rng.integers(3)]
    header = {"x": "x [m]", "v": "v [m/s]", "a": "a [m/s^2]"}[name]
    y = noisy(rng, getattr(d, name), 0.015)
    says = "release|start|silen|rest|still"
    return Case(csv(to / "y.csv", f"t [s],{header}", d.t, y), d.truth, says=says)


def hand(rng: np.random.Generator, to: Path) -> Case:
    """A hand pulls the mass out slowly and unevenly, holds it, and lets go."""
    d = decay(rng, after=(after := rng.uniform(1.5, 5.0)))
    release = 2 * np.pi * after / d.w
    before = d.t < release
    ramp = np.clip(d.t[before] / (release * rng.uniform(0.4, 0.8)), 0, 1)
    x = d.x.copy()
    x[before] *= ramp**2 * (3 - 2 * ramp) + 0.02 * np.sin(7.3 * ramp)
    x = noisy(rng, x, 0.01)
    return Case(csv(to / "x.csv", "t [s],x [m]", d.t, x), d.truth, says="release|start|silen|rest|hand|before")


def stands_still(rng: np.random.Generator, to: Path) -> Case:
    """A viscous decay with a long standstill after it, of coarse resolution."""
    d = decay(rng, ratio=(0.03, 0.08), cycles=(40.0, 80.0))
    x = rounded(noisy(rng, d.x, 0.003), rng.uniform(30, 100))
    return Case(csv(to / "x.csv", "t [s],x [m]", d.t, x), d.truth)


# --- the clock --------------------------------------------------------------------------------------------------------


def three_digits(rng: np.random.Generator, to: Path) -> Case:
    rate = float(rng.choice([29.97, 24.0, 50.0, 59.94, 100.0]))
    d = decay(rng, frequency=(rate / 40, rate / 15), cycles=(25.0, 40.0))
    t = np.arange(d.t.size) / rate
    scale = d.rate / rate  # the same samples on the clock of the camera
    x, truth = noisy(rng, d.x), {"k_over_m": d.w**2 / scale**2, "c_over_m": 2 * d.s / scale}
    return Case(csv(to / "x.csv", "t [s],x [m]", t, x, fmt="%.3g"), truth)


def whole_seconds(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, frequency=(0.8, 4.0), cycles=(30.0, 60.0))
    stamps = np.floor(d.t + rng.uniform(0, 1))
    path = to / "x.csv"
    rows = [f"{stamp:.0f},{x:.8g}" for stamp, x in zip(stamps, noisy(rng, d.x), strict=True)]
    path.write_text("\n".join(["t [s],x [m]", *rows]) + "\n", encoding="utf-8")
    return Case(path, d.truth, refusal=True)


def two_stamps(rng: np.random.Generator, to: Path) -> Case:
    """A short record whose stamps of whole seconds have two distinct values."""
    d = decay(rng, frequency=(8.0, 30.0), cycles=(12.0, 14.0), ratio=(0.02, 0.04))
    stamps = np.floor(d.t / d.t[-1] * 1.2 + 0.4)
    return Case(csv(to / "x.csv", "t [s],x [m]", stamps, noisy(rng, d.x)), d.truth, refusal=True)


def time_since_last(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, frequency=(0.5, 2.0), a_cycle=(30.0, 50.0))
    gaps = np.maximum(1000 / d.rate + rng.choice([-1, 0, 0, 0, 1], d.t.size), 1).round()
    gaps[0] = 0
    t = np.cumsum(gaps) / 1000
    pole = complex(-d.s, np.sqrt(d.w**2 - d.s**2))
    a = noisy(rng, rng.uniform(0.5, 3) * np.real(np.exp(pole * t)), 0.02)
    path = csv(to / "a.txt", "ax [m/s^2],dt [ms]", a, gaps, fmt="%.5g")
    return Case(path, d.truth, says="since|increment|cumul", refusal=True)


def beyond_nyquist(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, cycles=(20.0, 40.0), ratio=(0.004, 0.012), a_cycle=(1.15, 1.85))
    path = csv(to / "x.csv", "t [s],x [m]", d.t, noisy(rng, d.x, 0.02))
    return Case(path, d.truth, refusal=True, never=True, frequencies=(d.w / 2 / np.pi,))


# --- files and arrays -------------------------------------------------------------------------------------------------


def matrix_text(rng: np.random.Generator, to: Path) -> Case:
    """A step response as a matrix in text; a constant force and an unknown offset leave the mass open."""
    d, m = decay(rng, frequency=(1.0, 5.0)), rng.uniform(0.5, 5)
    wd = np.sqrt(d.w**2 - d.s**2)
    x = (1 - np.exp(-d.s * d.t) * (np.cos(wd * d.t) + d.s / wd * np.sin(wd * d.t))) / (m * d.w**2)
    rows = np.c_[d.t, noisy(rng, x, 0.01), np.ones_like(x)]
    text = "".join(f"  {i}   {t:.4f}   {y:.8f}   {f:.4f};\n" for i, (t, y, f) in enumerate(rows))
    (to / "x.txt").write_text("[ Sample   Time   Position   Force ;\n" + text + "]\n", encoding="utf-8")
    return Case(to / "x.txt", d.truth, {"units": {"t": "s", "x": "m", "f": "N"}})


def comment_lines(rng: np.random.Generator, to: Path) -> Case:
    d, mark = decay(rng), str(rng.choice(["#", "%", "//", ";", "!"]))
    head = f"{mark} logger 7, run 3\n{mark} rate as stamped\n"
    path = csv(to / "x.csv", head + "t [s],x [mm]", d.t, 1000 * noisy(rng, d.x))
    return Case(path, d.truth)


def sound_file(rng: np.random.Generator, to: Path) -> Case:
    from scipy.io import wavfile

    rate = int(rng.choice([8000, 22050, 44100, 48000]))
    d = decay(rng, frequency=(rate / 300, rate / 100), cycles=(15.0, 25.0), ratio=(0.01, 0.03))
    scale = d.rate / rate
    sound = noisy(rng, d.v / np.max(np.abs(d.v)), 0.01) * 20000
    wavfile.write(to / "x.wav", rate, sound.astype(np.int16))
    truth = {"k_over_m": (d.w / scale) ** 2, "c_over_m": 2 * d.s / scale}
    return Case(to / "x.wav", truth, {"columns": {"v": 0}, "units": {"v": "m/s"}})


def dates(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, frequency=(0.5, 4.0))
    begin = datetime.datetime(2026, 11, 26, 9)
    seconds = [datetime.timedelta(seconds=float(t)) for t in d.t]
    times: Any = (
        [begin + t for t in seconds],
        np.array([begin + t for t in seconds], dtype="datetime64[us]"),
        np.array(seconds, dtype="timedelta64[us]"),
        seconds,
    )[rng.integers(4)]
    return Case((times, noisy(rng, d.x)), d.truth)


def no_reals(rng: np.random.Generator, to: Path) -> Case:
    """Complex numbers, or an array in which samples that are wrong are masked."""
    d = decay(rng)
    x = noisy(rng, d.x)
    if rng.integers(2):
        return Case((d.t, x + 1j * d.v / d.w), d.truth, says="complex|real", refusal=True)
    mask = rng.random(x.size) < 0.05
    return Case((d.t, np.ma.array(np.where(mask, 1e3, x), mask=mask)), d.truth, says="mask", refusal=True)


# --- what the model leaves out ----------------------------------------------------------------------------------------


def two_masses(rng: np.random.Generator, to: Path) -> Case:
    """A chain of two, the spring between them without damping."""
    k1, k2, m2 = rng.uniform(40, 90), rng.uniform(40, 90), rng.uniform(0.7, 1.8)
    c1 = rng.uniform(0.03, 0.1)
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-k1 - k2, k2, -c1, 0], [k2 / m2, -k2 / m2, 0, 0]])
    values, vectors = np.linalg.eig(A)
    t = np.arange(0, 12, 1 / 30)
    start = np.linalg.solve(vectors, np.array([rng.uniform(0.01, 0.04), rng.uniform(-0.04, 0.04), 0, 0], complex))
    x = np.real(vectors @ (np.exp(np.outer(values, t)) * start[:, None]))[:2]
    path = csv(to / "x.csv", "t [s],x1 [m],x2 [m]", t, noisy(rng, x[0]), noisy(rng, x[1]))
    return Case(path, {"k1_over_m1": k1, "k2_over_m1": k2, "m2_over_m1": m2}, {"system": "chain2"})


def two_modes(rng: np.random.Generator, to: Path) -> Case:
    low, high = decay(rng, frequency=(5.0, 30.0), cycles=(30.0, 50.0)), rng.uniform(2.5, 9.0)
    w2, z2 = high * low.w, rng.uniform(0.004, 0.015)
    t = np.arange(0, low.t[-1], 2 * np.pi / w2 / rng.uniform(6, 12))
    pole = np.array([complex(-low.s, low.w), complex(-z2 * w2, w2)])
    sizes = np.array([1.0, log_uniform(rng, 0.3, 4.0)]) * np.exp(1j * rng.uniform(0, 6.28, 2))
    a = np.real(sizes @ np.exp(np.outer(pole, t)))
    path = csv(to / "a.csv", "t [s],a [m/s^2]", t, noisy(rng, a) + 0.1)
    return Case(path, {}, refusal=True, never=True, frequencies=(low.w / 2 / np.pi, w2 / 2 / np.pi))


def wobbling(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, frequency=(0.5, 3.0), a_cycle=(150.0, 700.0), cycles=(5.0, 12.0))
    wobble = np.zeros(d.t.size)
    for i in range(1, d.t.size):
        wobble[i] = 0.995 * wobble[i - 1] + rng.standard_normal()
    v = d.v + 0.04 * np.max(np.abs(d.v)) * wobble / np.std(wobble)
    return Case(csv(to / "v.csv", "t [s],angular velocity [rad/s]", d.t, v), d.truth)


def friction_class(rng: np.random.Generator, to: Path) -> Case:
    """Viscous damping with dry friction, as displacement, velocity or acceleration; the class is not named."""
    d, mu = friction_decay(rng, (12.0, 25.0), length=0.8)
    name, header = (("x", "x [m]"), ("v", "v [m/s]"), ("a", "a [m/s^2]"))[rng.integers(3)]
    path = csv(to / "y.csv", f"t [s],{header}", d.t, noisy(rng, getattr(d, name), 0.005))
    return Case(path, {**d.truth, "mu_over_m": mu}, {"system": "auto"})


def repeats(rng: np.random.Generator, to: Path) -> Case:
    """Five repeats of one rig with friction, other amplitudes, and a stiffness that differs by 0.3 % between them."""
    w, z, size = 2 * np.pi * log_uniform(rng, 2.0, 5.0), rng.uniform(0.01, 0.03), log_uniform(rng, 0.01, 0.03)
    mu = size * w * w / 4 / rng.uniform(12, 20)
    files = []
    for i, factor in enumerate(rng.permutation([0.9, 1.0, 1.1, 1.25, 1.5])):
        one, _ = friction_decay(rng, (1, 1), 30.0, factor * size, (w * np.exp(0.0015 * rng.standard_normal()), z, mu))
        x = rounded(noisy(rng, one.x, 0.003), 800)
        files.append(csv(to / f"run{i + 1}.csv", "t [s],x [m]", one.t[: int(0.6 * one.t.size)],
                         x[: int(0.6 * one.t.size)]))  # fmt: skip
    return Case(files, {"k_over_m": w * w, "c_over_m": 2 * z * w, "mu_over_m": mu}, {"system": "auto"})


def mislabelled(rng: np.random.Generator, to: Path) -> Case:
    """Six repeats, of which one is of another rig."""
    d, odd = decay(rng), int(rng.integers(6))
    files = []
    for i in range(6):
        w = d.w * np.exp(0.002 * rng.standard_normal()) * (1.15 if i == odd else 1.0)
        x = np.real(0.01 * rng.uniform(0.7, 1.4) * np.exp(complex(-d.s, w) * d.t))
        files.append(csv(to / f"run{i + 1}.csv", "t [s],x [m]", d.t, noisy(rng, x)))
    return Case(files, d.truth, says=rf"run{odd + 1}\b", never=True)


# --- more than one motion in a file -----------------------------------------------------------------------------------


def several_runs(rng: np.random.Generator, to: Path) -> Case:
    """Three releases in one record, without a gap."""
    d = decay(rng, ratio=(0.015, 0.03), cycles=(15.0, 25.0))
    x = np.concatenate([d.x * factor for factor in rng.uniform(0.7, 1.3, 3)])
    path = csv(to / "x.csv", "t [s],x [m]", np.arange(x.size) / d.rate, noisy(rng, x))
    return Case(path, d.truth, says="runs|release|jump|split|break", refusal=True)


def broken(rng: np.random.Generator, to: Path) -> Case:
    """A gap in the time, over which the logger did not record, or a jump of the sensor's zero."""
    d = decay(rng, cycles=(20.0, 35.0))
    middle, x, t = int(rng.uniform(0.35, 0.65) * d.t.size), noisy(rng, d.x), d.t
    if rng.integers(2):
        kept = np.r_[0:middle, middle + int(rng.uniform(20, 80)) : d.t.size]
        t, x = t[kept], x[kept]
        return Case(csv(to / "x.csv", "t [s],x [m]", t, x), d.truth)  # one motion: the gap does no harm
    x[middle:] += rng.choice([-1, 1]) * rng.uniform(0.3, 1.0) * np.max(np.abs(x))
    return Case(csv(to / "x.csv", "t [s],x [m]", t, x), d.truth, says="jump|break|runs|step|offset")


def pasted_twice(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng, ratio=(0.01, 0.03))
    x = np.tile(noisy(rng, d.x), 2)
    path = csv(to / "x.csv", "t [s],x [m]", np.arange(x.size) / d.rate, x)
    return Case(path, d.truth, says="twice|times, value for value|pasted|copies", refusal=True)


def derived_velocity(rng: np.random.Generator, to: Path) -> Case:
    d = decay(rng)
    x = rounded(noisy(rng, d.x, 0.01), 200)
    v = np.gradient(x, d.t)
    path = csv(to / "xv.csv", "t [s],x [m],v [m/s]", d.t, x, v)
    return Case(path, d.truth, says="deriv|differen|no second|comput")


# --- forced -----------------------------------------------------------------------------------------------------------


def forced(d: Decay, m: float, force: np.ndarray) -> np.ndarray:
    """Displacement from rest under a force held between samples, by the exact discrete motion."""
    from scipy.linalg import expm

    A = np.zeros((3, 3))
    A[:2] = np.array([[0, 1, 0], [-(d.w**2), -2 * d.s, 1 / m]])
    step, state, x = expm(A / d.rate), np.zeros(3), np.zeros(force.size)
    for i in range(1, force.size):
        state[2] = force[i - 1]
        state = step @ state
        x[i] = state[0]
    return x


def steady_sine(rng: np.random.Generator, to: Path) -> Case:
    w, z, m = 2 * np.pi * log_uniform(rng, 1.0, 8.0), rng.uniform(0.01, 0.05), rng.uniform(0.5, 5)
    wf = w * rng.choice([rng.uniform(0.5, 0.95), rng.uniform(1.05, 1.8)])
    t = np.arange(0, rng.uniform(30, 60) * 2 * np.pi / wf, 2 * np.pi / wf / rng.uniform(12, 25))
    x = np.real(10 / m / (w * w - wf * wf + 2j * z * w * wf) * np.exp(1j * wf * t))
    path = csv(to / "xf.csv", "t [s],x [m],f [N]", t, noisy(rng, x, 0.005), 10 * np.cos(wf * t))
    return Case(path, {"k_over_m": w * w, "m": m, "c_over_m": 2 * z * w}, says="sine|one frequency|single frequency",
                refusal=True)  # fmt: skip


def saturated_force(rng: np.random.Generator, to: Path) -> Case:
    """The force sensor ends at a limit that the true force exceeds."""
    d, m = decay(rng, frequency=(1.0, 6.0), cycles=(20.0, 30.0), a_cycle=(25.0, 40.0)), rng.uniform(0.5, 5)
    force = 10 * np.sin(np.cumsum(np.linspace(0.3, 1.8, d.t.size)) * d.w / d.rate + 1)
    x, limit = forced(d, m, force), rng.uniform(4, 7)
    path = csv(to / "xf.csv", "t [s],x [m],f [N]", d.t, noisy(rng, x), np.clip(force, -limit, limit))
    says = "force.*(satur|clip|limit)|(satur|clip|limit).*force"
    return Case(path, {**d.truth, "m": m}, {"settings": {"hold": "zero_order"}}, says, refusal=True)


FOURTEEN: dict[str, Kind] = {
    "01_acceleration_offset": acceleration_offset,
    "02_dies_out": dies_out,
    "03_repeats": repeats,
    "04_three_digits": three_digits,
    "05_matrix_text": matrix_text,
    "06_two_masses": two_masses,
    "07_flat_turning_points": flat_turning_points,
    "08_two_modes": two_modes,
    "09_silence_first": silence,
    "10_time_since_last": time_since_last,
    "11_wobbling_pivot": wobbling,
    "12_gravity": gravity,
    "13_beyond_Nyquist": beyond_nyquist,
    "14_steady_sine": steady_sine,
}
OTHERS: dict[str, Kind] = {
    "velocity_offset": velocity_offset,
    "gyroscope_offset": gyroscope_offset,
    "drift": drifting,
    "hand_at_the_start": hand,
    "stands_still": stands_still,
    "clipped": clipped,
    "whole_seconds": whole_seconds,
    "two_stamps": two_stamps,
    "comment_lines": comment_lines,
    "sound_file": sound_file,
    "dates": dates,
    "complex_or_masked": no_reals,
    "derived_velocity": derived_velocity,
    "saturated_force": saturated_force,
    "pasted_twice": pasted_twice,
    "broken": broken,
    "several_runs": several_runs,
    "mislabelled": mislabelled,
    "friction_class": friction_class,
}
KINDS = FOURTEEN | OTHERS
