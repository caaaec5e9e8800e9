"""What README says of tests with a measured force: the second atlas."""

from __future__ import annotations

import pandas as pd

from bench.atlas.forced import Forced
from bench.atlas.model import TOLD, told
from bench.reporting.atlas import NEAR, near
from bench.reporting.claims.claim import Claim, Said, claim, number, said
from bench.reporting.claims.evidence import Evidence

LIKELIHOOD, INSTRUMENTS, REGRESSION = "output_error", "srivc", "ls"
CLEAN_DB, AS_NOISY_DB = 20.0, 0.0
"""How far the SNR of the force is above that of the displacement."""


def _of(e: Evidence, method: str, quantity: str = "k_over_m") -> pd.DataFrame:
    """The points of a method that tell a quantity."""
    return told(e.atlas_forced[e.atlas_forced.method == method], quantity)


def _near(frame: pd.DataFrame, quantity: str = "k_over_m") -> float:
    """Percent of points near the bound."""
    return 100.0 * float(near(frame, quantity).mean())


@claim
def forced_size(e: Evidence) -> Said:
    """- **What a force adds**: {fits} fits at {points} tests from rest under a measured force. The bound on the
    standard deviation of k/m is below {told} % in {k} % of the box, that of c/m in {c} %, and that of the mass, which
    no free decay tells, in {m} %.
    """
    frame = e.atlas_forced.drop_duplicates([axis.name for axis in Forced.AXES])
    k, c, m = (100.0 * float((frame[f"bound_{name}"] <= TOLD).mean()) for name in ("k_over_m", "c_over_m", "m"))
    return said(
        {"damping is hardest": c < min(k, m)},
        fits=f"{int(e.atlas_forced.fits.sum()):,}", points=f"{len(frame):,}", told=f"{100 * TOLD:.0f}", k=f"{k:.0f}",
        c=f"{c:.0f}", m=f"{m:.0f}",
    )  # fmt: skip


@claim
def forced_noise(e: Evidence) -> Said:
    """- **A force is data too**: every method takes the measured force as exact. Where its SNR is at least {clean} dB
    above that of the displacement, output error is within {near} times the bound of k/m at {good} % of the points, and
    its 95 % intervals hold the truth in {held} % of the fits; where it is below that of the displacement, at {bad} %,
    and in {missed} %.
    """
    frame = _of(e, LIKELIHOOD)
    above = frame.force_snr_db - frame.snr_db
    clean, noisy = frame[above >= CLEAN_DB], frame[above < AS_NOISY_DB]
    held, missed = (100.0 * float(part.k_over_m_held.mean()) for part in (clean, noisy))
    return said(
        {"noise of the force is not allowed for": missed < held - 10.0, "near it": _near(clean) > _near(noisy) + 20.0},
        clean=f"{CLEAN_DB:g}", near=f"{NEAR:g}", good=f"{_near(clean):.0f}", held=f"{held:.0f}",
        bad=f"{_near(noisy):.0f}", missed=f"{missed:.0f}",
    )  # fmt: skip


@claim
def forced_band(e: Evidence) -> Said:
    """- **The force must reach the resonance**: of tests whose force ends below the natural frequency the median bound
    of k/m is {below} %, above it {above} %; the mass, which a slow force tells as well, is at {mass_below} and
    {mass_above} %.
    """
    frame = e.atlas_forced.drop_duplicates([axis.name for axis in Forced.AXES])
    low, high = frame[frame.bandwidth < 1.0], frame[frame.bandwidth >= 1.0]
    below, above = (100.0 * float(part.bound_k_over_m.median()) for part in (low, high))
    mass_below, mass_above = (100.0 * float(part.bound_m.median()) for part in (low, high))
    return said(
        {"it is worth reaching": below > 1.5 * above, "the mass does as well": mass_below < 1.5 * mass_above},
        below=number(below, 2), above=number(above, 2), mass_below=number(mass_below, 2),
        mass_above=number(mass_above, 2),
    )  # fmt: skip


@claim
def forced_methods(e: Evidence) -> Said:
    """- **Instruments do as well as maximum likelihood, differences do not**: with a force that is cleaner than the
    displacement by {clean} dB or more, SRIVC is near the bound of the mass at {srivc} % of the points and output error
    at {output} %; LS on finite differences at {ls} %.
    """
    found = {}
    for key, name in (("srivc", INSTRUMENTS), ("output", LIKELIHOOD), ("ls", REGRESSION)):
        frame = _of(e, name, "m")
        found[key] = _near(frame[frame.force_snr_db - frame.snr_db >= CLEAN_DB], "m")
    return said(
        {"instruments nearly do": found["srivc"] > found["output"] - 35.0, "differences do not": found["ls"] < 10.0},
        clean=f"{CLEAN_DB:g}", **{key: f"{share:.0f}" for key, share in found.items()},
    )  # fmt: skip


CLAIMS: tuple[Claim, ...] = (forced_size, forced_noise, forced_band, forced_methods)
