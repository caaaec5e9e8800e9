"""What README says of free decays at large: the atlas, its threshold, and what waiting brings."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.atlas.model import TOLD, told
from bench.atlas.point import FreeDecay
from bench.planning.free_decay import Decay, Oscillator, errors, information
from bench.reporting.atlas import NEAR, near
from bench.reporting.claims.claim import Claim, Said, claim, number, said
from bench.reporting.claims.evidence import Evidence

LIKELIHOOD, SHOOTING = "output_error", "shooting"
WITHOUT_START = ("frequency", "iqml", "matrix_pencil")
"""Good methods that are not told the start."""
THRESHOLD_POINTS = 200
LIGHT = 0.02
"""A damping ratio of which the passage on waiting speaks."""


def _of(e: Evidence, method: str, quantity: str = "k_over_m") -> pd.DataFrame:
    """The points of a method that tell a quantity."""
    frame = e.atlas
    return told(frame[frame.method == method], quantity)


def _near(frame: pd.DataFrame, quantity: str = "k_over_m") -> float:
    """Percent of points near the bound."""
    return 100.0 * float(near(frame, quantity).mean())


def _gross(frame: pd.DataFrame) -> float:
    return 100.0 * float(frame.k_over_m_gross.mean())


@claim
def atlas_size(e: Evidence) -> Said:
    """- **What a test tells**: {fits} fits at {points} points. The Cramér-Rao bound on the standard deviation of k/m is
    below {told} % in {k} % of the box of all tests, that of c/m in {c} % of it; {aliased} % of the box has the natural
    frequency above the Nyquist frequency.
    """
    frame = e.atlas.drop_duplicates([axis.name for axis in FreeDecay.AXES])
    k, c = (100.0 * float((frame[f"bound_{name}"] <= TOLD).mean()) for name in ("k_over_m", "c_over_m"))
    return said(
        {"damping is harder to tell than stiffness": c < k},
        fits=f"{int(e.atlas.fits.sum()):,}", points=f"{len(frame):,}", told=f"{100 * TOLD:.0f}", k=f"{k:.0f}",
        c=f"{c:.0f}", aliased=f"{100 * float(frame.aliased.mean()):.0f}",
    )  # fmt: skip


@claim
def atlas_likelihood(e: Evidence) -> Said:
    """- **Output error is on the bound nearly everywhere**: within {near} times it at {k} % (k/m) and {c} % (c/m)
    of the points that tell the quantity, with {gross} % of gross errors (beyond five times the bound, or no answer).
    Few samples or much noise are no reason for another method.
    """
    k, c = _of(e, LIKELIHOOD), _of(e, LIKELIHOOD, "c_over_m")
    few, noisy = _near(k[k.samples < 30]), _near(k[k.snr_db < 10])
    return said(
        {"also with few samples": few > 85, "also in noise": noisy > 80, "nearly everywhere": _near(k) > 90},
        near=f"{NEAR:g}", k=f"{_near(k):.0f}", c=f"{_near(c, 'c_over_m'):.0f}", gross=number(_gross(k), 2),
    )  # fmt: skip


@claim
def atlas_threshold(e: Evidence) -> Said:
    """- **The threshold is where theory has it**: at {points} points below the Nyquist frequency the share of gross
    errors of output error is inside the binomial 95 % interval about the predicted probability of a wrong basin at
    {inside} %. A wrong basin is rare where the test tells k/m at all: its probability is above {level} % at {risky} of
    these points, and there the counted share is {counted} %, predicted {predicted} %.
    """
    from scipy.stats import binom

    frame = e.atlas
    frame = frame[(frame.method == LIKELIHOOD) & ~frame.aliased].head(THRESHOLD_POINTS)
    low, high = binom.interval(0.95, frame.fits, frame.wrong_basin.clip(0.0, 1.0))
    counted = (frame.k_over_m_gross * frame.fits).round()
    risky = frame[frame.wrong_basin > LEVEL]
    inside = float(((low <= counted) & (counted <= high)).mean())
    return said(
        {"at the nominal rate": inside >= 0.92, "there are as many points": len(frame) == THRESHOLD_POINTS},
        points=f"{len(frame)}", inside=f"{100 * inside:.1f}", level=f"{100 * LEVEL:g}", risky=f"{len(risky)}",
        counted=number(_gross(risky), 2), predicted=number(100.0 * float(risky.wrong_basin.mean()), 2),
    )  # fmt: skip


LEVEL = 0.01


@claim
def atlas_start(e: Evidence) -> Said:
    """- **What the start is worth**: the frequency domain, IQML and the matrix pencil do not use a start that is known.
    Where it is unknown they are near the bound of k/m at {frequency}, {iqml} and {pencil} % of the points; where it is
    known the bound is lower, and they are near it at {frequency_known}, {iqml_known} and {pencil_known} %.
    """
    shares = {}
    for name in WITHOUT_START:
        frame = _of(e, name)
        shares[name] = (_near(frame[~frame.start_known]), _near(frame[frame.start_known]))
    found = dict(zip(("frequency", "iqml", "pencil"), (shares[name] for name in WITHOUT_START), strict=True))
    return said(
        {"a start that is not used costs the bound": max(known for _, known in shares.values()) < 20},
        **{name: f"{unknown:.0f}" for name, (unknown, _) in found.items()},
        **{f"{name}_known": f"{known:.0f}" for name, (_, known) in found.items()},
    )


@claim
def atlas_shooting(e: Evidence) -> Said:
    """- **An open damping does not hide the stiffness**: at points that tell k/m but not damping, output error is near
    the bound of k/m at {output} % and multiple shooting at {shooting} %; where damping is told, at {output_told} and
    {shooting_told} %.
    """
    frames = {"output": _of(e, LIKELIHOOD), "shooting": _of(e, SHOOTING)}
    open_ = {name: _near(frame[frame.bound_c_over_m > TOLD]) for name, frame in frames.items()}
    told_ = {f"{name}_told": _near(frame[frame.bound_c_over_m <= TOLD]) for name, frame in frames.items()}
    return said(
        {"both are near it": min(open_.values()) > 80},
        **{name: f"{share:.0f}" for name, share in (open_ | told_).items()},
    )


@claim
def atlas_cheap(e: Evidence) -> Said:
    """- **Nearly as good for a fraction of the time**: with an unknown start IQML is near the bound of c/m at {iqml} %
    of the points, and takes {ratio} times less than output error, which is near at {best} %; the matrix pencil takes as
    little and is near at {pencil} %.
    """
    iqml, pencil, best = (_of(e, name, "c_over_m") for name in ("iqml", "matrix_pencil", LIKELIHOOD))
    iqml, pencil, best = (frame[~frame.start_known] for frame in (iqml, pencil, best))
    times = {name: float(frame.seconds.median()) for name, frame in (("i", iqml), ("p", pencil), ("b", best))}
    return said(
        {"the pencil takes as little": times["p"] < 2.0 * times["i"], "it takes less": times["b"] > 2.0 * times["i"]},
        iqml=f"{_near(iqml, 'c_over_m'):.0f}", pencil=f"{_near(pencil, 'c_over_m'):.0f}",
        best=f"{_near(best, 'c_over_m'):.0f}", ratio=number(times["b"] / times["i"], 2),
    )  # fmt: skip


@claim
def atlas_regression(e: Evidence) -> Said:
    """- **Least squares on differences is hardly ever right**: LS and RLS are near the bound of k/m at {ls} and {rls} %
    of the points, and {ls_gross} and {rls_gross} % of their fits are gross errors; they are no better at a high SNR
    ({high} % near above {snr} dB), where their bias exceeds the noise.
    """
    ls, rls = _of(e, "ls"), _of(e, "rls")
    high = _near(ls[ls.snr_db > HIGH_DB])
    return said(
        {"hardly ever": max(_near(ls), _near(rls)) < 5, "no better": high < 5},
        ls=number(_near(ls), 1), rls=number(_near(rls), 1),
        ls_gross=f"{_gross(ls):.0f}", rls_gross=f"{_gross(rls):.0f}",
        high=number(high, 1), snr=f"{HIGH_DB:g}",
    )  # fmt: skip


HIGH_DB = 40.0


@claim
def atlas_bias(e: Evidence) -> Said:
    """- **One equation, two answers**: a difference equation fitted by least squares (AR) is grossly wrong in {ar} % of
    the fits; the same equation with the noise weighted as it enters (IQML) in {iqml} %.
    """
    ar, iqml = _gross(_of(e, "ar")), _gross(_of(e, "iqml"))
    return said({"weights are what it takes": iqml < 0.2 * ar}, ar=f"{ar:.0f}", iqml=number(iqml, 2))


@claim
def atlas_decrement(e: Evidence) -> Said:
    """- **The logarithmic decrement needs peaks, and noise makes them**: it is near the bound of c/m at {near} % of the
    points, errs grossly or is silent in {gross} % of the fits, and where it answers its 95 % intervals hold the truth
    in {held} %.
    """
    frame = _of(e, "log_decrement", "c_over_m")
    gross = 100.0 * float(frame.c_over_m_gross.mean())
    return said(
        {"it is seldom good": _near(frame, "c_over_m") < 10},
        near=number(_near(frame, "c_over_m"), 1), gross=f"{gross:.0f}", held=f"{100 * frame.c_over_m_held.mean():.0f}",
    )  # fmt: skip


@claim
def atlas_coverage(e: Evidence) -> Said:
    """- **Which intervals to believe**: 95 % intervals of k/m by output error, shooting, the frequency domain, IQML and
    the matrix pencil hold the truth in {low} to {high} % of the fits, mean over points; those of LS in {ls} %.
    """
    good = [100.0 * float(_of(e, name).k_over_m_held.mean()) for name in (LIKELIHOOD, SHOOTING, *WITHOUT_START)]
    ls = 100.0 * float(_of(e, "ls").k_over_m_held.mean())
    return said(
        {"they are honest": min(good) > 92 and max(good) < 98, "those are not": ls < 80},
        low=f"{min(good):.1f}",
        high=f"{max(good):.1f}",
        ls=f"{ls:.0f}",
    )


@claim
def atlas_waiting(e: Evidence) -> Said:
    """- **How long to wait**: with a given number of samples a decay released from rest tells its damping best over
    {best} time constants of the amplitude, which at a damping ratio of {ratio} % are {cycles} cycles; {short} of that
    time costs {short_cost} times the error, {long} times as long {long_cost} times. More cycles than that do not help:
    samples there show noise alone.
    """
    oscillator, constants = Oscillator(1.0, LIGHT), np.linspace(0.3, 8.0, 155)
    cycles = constants / (2.0 * np.pi * LIGHT)
    found = np.array([_damping_error(oscillator, float(own)) for own in cycles])
    best = int(np.argmin(found))
    short, long_ = (_damping_error(oscillator, float(factor * cycles[best])) / found[best] for factor in (1 / 4, 4.0))
    return said(
        {"there is a best": 0 < best < constants.size - 1, "too long costs less than too short": long_ < short},
        best=f"{constants[best]:.1f}", ratio=f"{100 * LIGHT:g}", cycles=f"{cycles[best]:.0f}", short="a quarter",
        short_cost=f"{short:.1f}", long="four", long_cost=f"{long_:.1f}",
    )  # fmt: skip


def _damping_error(oscillator: Oscillator, cycles: float) -> float:
    """The bound of c/m with two thousand samples, start unknown."""
    return errors(information(oscillator, Decay(2000, cycles / oscillator.frequency, 10.0)))["c_over_m"]


@claim
def atlas_snr(e: Evidence) -> Said:
    """- **The SNR alone says little**: of tests between {low} and {high} dB the bound of k/m is between {least} and
    {most} % (without the lowest and the highest tenth); samples, cycles and damping make the difference.
    """
    frame = e.atlas.drop_duplicates([axis.name for axis in FreeDecay.AXES])
    own = frame[frame.snr_db.between(*BAND) & ~frame.aliased].bound_k_over_m
    low, high = (100.0 * float(own.quantile(q)) for q in (0.1, 0.9))
    return said(
        {"more than tenfold": high > 10 * low},
        low=f"{BAND[0]:g}", high=f"{BAND[1]:g}", least=number(low, 2), most=number(high, 2),
    )  # fmt: skip


BAND = (15.0, 25.0)


@claim
def plans_kept(e: Evidence) -> Said:
    """- **Plans keep what they promise**: of {requests} random requests, each with its test simulated and fitted, the
    share that reaches the wanted error is inside the binomial 95 % interval about the expected one in {inside}. A test
    whose length is doubled until it is enough takes {more} times the samples (median), and in {never} requests it is
    never enough: the motion has died away.
    """
    table = e.study("plans.md")
    inside, over = int((table.inside == "yes").sum()), table["over the plan's"]
    more = float(over[over != "-"].astype(float).median())
    return said(
        {"at the nominal rate": inside >= 0.9 * len(table), "a plan is cheaper": more > 1.2},
        requests=f"{len(table)}", inside=f"{inside}", more=f"{more:.1f}", never=f"{int((over == '-').sum())}",
    )  # fmt: skip


CLAIMS: tuple[Claim, ...] = (
    atlas_size, atlas_likelihood, atlas_threshold, atlas_start, atlas_shooting, atlas_cheap, atlas_regression,
    atlas_bias, atlas_decrement, atlas_coverage, atlas_waiting, atlas_snr, plans_kept,
)  # fmt: skip
