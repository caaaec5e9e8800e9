"""Moving ground: its acceleration drives the motion relative to it, as a force per unit mass.

``m x'' + c x' + k x = -m a_g`` with the relative displacement x and the acceleration a_g of the ground (A. K. Chopra,
Dynamics of Structures, 4th ed., 2012, section 1.7). An accelerometer on the mass measures ``x'' + a_g``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.errors import InputError
from bench.records.reading import Recording

BASE = "b"
"""Role of the column of the ground's acceleration."""
RELATIVE, ABSOLUTE = "relative", "absolute"


def with_base_excitation(recording: Recording, motion: str | None) -> Recording:
    """Return a recording with ``-a_g`` as the force (N on a mass of 1 kg), and with relative motion.

    Args:
        recording: its signal of role ``b`` is the ground's acceleration; without one it is returned as it is.
        motion: ``relative``, or ``absolute`` of an accelerometer on the mass.

    Raises:
        InputError: it is not said which, an absolute displacement or velocity, several masses, or another force.
    """
    ground = next((signal for signal in recording.signals if signal.role == BASE), None)
    if ground is None:
        return recording
    others = [signal for signal in recording.signals if signal is not ground]
    if motion is None:
        remedy = "relative to the ground, or absolute as of an accelerometer on the mass: say which with base="
        raise InputError("motion", "none", remedy)
    if any(signal.measures == "force" or signal.dof for signal in others):
        raise InputError("base", ground.role, "it is for one mass without another force; leave the others out")
    if motion == ABSOLUTE and (wrong := [signal for signal in others if signal.measures != "acceleration"]):
        remedy = f"an absolute {wrong[0].measures} would need the ground's; give accelerations, or relative motion"
        raise InputError("motion", motion, remedy)
    if motion == ABSOLUTE:
        shaken = (np.interp(signal.times, ground.times, ground.values) for signal in others)
        others = [replace(s, values=s.values - a_g) for s, a_g in zip(others, shaken, strict=True)]
    force = replace(ground, role="f", measures="force", values=-ground.values, unit="N", written="", size=1.0)
    note = (
        f"the ground's acceleration drives the {motion} motion as a force on 1 kg: c and k are those over the mass, "
        "and m is the ratio of the two sensors' scales, 1 where both are calibrated"
    )
    return replace(recording, signals=(*others, force), notes=(*recording.notes, note))
