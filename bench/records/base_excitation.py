"""Base excitation: the acceleration of the ground drives the relative motion as a force per unit mass.

``m x'' + c x' + k x = -m a_g`` with the relative displacement x and the acceleration a_g of the ground (A. K. Chopra,
Dynamics of Structures, 4th ed., 2012, section 1.7). An accelerometer on the mass measures ``x'' + a_g``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.errors import InputError
from bench.records.reading import Recording

BASE = "b"
"""Role of the column with the acceleration of the ground."""
ABSOLUTE = "absolute"


def with_base_excitation(recording: Recording, motion: str | None) -> Recording:
    """Return a recording with the force ``-a_g`` (N on a mass of 1 kg) and with relative motion.

    Args:
        recording: Its signal of role ``b`` is the acceleration of the ground; without one it is returned unchanged.
        motion: ``relative``, or ``absolute`` for an accelerometer on the mass.

    Raises:
        InputError: The motion is not specified, is an absolute displacement or velocity, has several degrees of
            freedom, or there is another force.
    """
    ground = next((signal for signal in recording.signals if signal.role == BASE), None)
    if ground is None:
        return recording
    others = [signal for signal in recording.signals if signal is not ground]
    if motion is None:
        remedy = "base= needs motion=relative (to the ground) or motion=absolute (accelerometer on the mass)"
        raise InputError("motion", "none", remedy)
    if any(signal.measures == "force" or signal.dof for signal in others):
        raise InputError("base", ground.role, "base excitation is for one mass without other forces; remove the others")
    if motion == ABSOLUTE and (wrong := [signal for signal in others if signal.measures != "acceleration"]):
        remedy = f"absolute {wrong[0].measures} is not supported; use accelerations, or relative motion"
        raise InputError("motion", motion, remedy)
    if motion == ABSOLUTE:
        a_g = (np.interp(signal.times, ground.times, ground.values) for signal in others)
        others = [replace(s, values=s.values - a) for s, a in zip(others, a_g, strict=True)]
    force = replace(ground, role="f", measures="force", values=-ground.values, unit="N", written="", size=1.0)
    note = (
        f"the acceleration of the ground drives the {motion} motion as a force on 1 kg: c and k stand for c/m and k/m, "
        "and m is the ratio of the scales of the two sensors, 1 if both are calibrated"
    )
    return replace(recording, signals=(*others, force), notes=(*recording.notes, note))
