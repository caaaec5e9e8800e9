"""Signals over time, as reading leaves them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.records.reading.units import Measures


@dataclass(frozen=True, eq=False)
class Signal:
    """One measured quantity over time.

    ``dof`` counts from 0; ``unit`` is in SI ("rad", "N·m" and so on where it turns), or the label as written where it
    is no known unit. ``times`` (s) count from the first kept sample of the recording; a signal with missing values has
    fewer samples than others.
    """

    role: str
    measures: Measures
    dof: int
    values: np.ndarray
    unit: str
    times: np.ndarray


@dataclass(frozen=True, eq=False)
class Recording:
    """The signals of a file, what was done to it beyond reading it, where it is from, and the sha256 of its bytes.

    ``rate_error`` is the relative standard uncertainty of the sampling rate that coarse time stamps leave.
    """

    signals: tuple[Signal, ...]
    notes: tuple[str, ...]
    source: str
    sha256: str
    rate_error: float = 0.0
