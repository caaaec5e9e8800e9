"""The profile likelihoods of one replicate, a panel a quantity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.contract.prior import Prior
from bench.information.profile import THRESHOLD, Profile
from bench.reporting.figures.style import legend_below, panels

CAPTION = (
    "A curve that rises on both sides of its lowest point is a quantity that the data tell. Profile likelihoods on one "
    "replicate: each quantity is held and the rest fitted again, the noise level too. No "
    "prior enters the blue line; it is flat where the data do not tell the quantity. Orange: half the squared distance "
    "from the prior's nominal value, in its standard deviations. Dashed: where a 95 % "
    "interval ends. Dotted: the true value."
)


def draw_profiles(found: Sequence[Profile], truth: dict[str, float], prior: Prior | None) -> Any:
    """One panel a quantity: profile, threshold, the true value, and what the prior says of it."""
    columns = min(4, max(3, math.ceil(math.sqrt(len(found)))))
    figure, axes = panels(len(found), columns, 42.0, "")
    for axis, profile in zip(axes, found, strict=True):
        q, x = profile.quantity, profile.values
        axis.plot(x, profile.drop, color="#0072B2", marker="o", ms=2.5, lw=1.2, label="data: profile likelihood")
        if prior is not None:
            w = np.array(q.vector(prior.names))
            fine = np.linspace(np.log(x[0]), np.log(x[-1]), 200)
            distance = (fine - math.log(q.coefficient) - w @ prior.log_mean) / np.linalg.norm(w * prior.log_sds)
            axis.plot(np.exp(fine), distance**2 / 2, color="#E69F00", lw=1.2, label="prior")
        axis.axhline(THRESHOLD, color="0.4", ls="--", lw=0.8, label="ends of the 95 % interval")
        axis.axvline(q.value(truth), color="0.4", ls=":", lw=1.0, label="true value")
        axis.set(ylim=(-0.2, 3 * THRESHOLD), xlim=(x[0], x[-1]))
        axis.set_title(q.name.replace("_over_", "/") + (f" ({q.unit})" if q.unit != "-" else ""), loc="left")
        axis.locator_params(axis="x", nbins=4)
        axis.grid()
    for axis in axes[::columns]:
        axis.set_ylabel("fall of log-likelihood (−)")
    handles = {label: h for axis in axes for h, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    legend_below(figure, list(handles.values()))
    return figure
