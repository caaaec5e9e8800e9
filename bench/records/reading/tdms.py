"""Records in TDMS files, as LabVIEW writes them."""

from __future__ import annotations

import io
import logging

import numpy as np

from bench.records.reading.packages import optional
from bench.records.reading.table import Column, Table, check_rows


def read_tdms(data: bytes, source: object) -> Table:
    """The channels of a TDMS file as columns, with their times where a channel is a waveform.

    Raises:
        InputError: a channel is too long, or npTDMS is missing.
    """
    nptdms = optional("nptdms", source)
    nptdms.log.log_manager.set_level(logging.CRITICAL)  # what is wrong is said once, by the error
    with nptdms.TdmsFile.open(io.BytesIO(data)) as file:
        columns = []
        for channel in (channel for group in file.groups() for channel in group.channels()):
            check_rows(len(channel), source)
            said = channel.properties
            unit = str(said.get("unit_string") or said.get("NI_UnitDescription") or "")
            if channel.dtype.kind not in "biuf":
                columns.append(Column(channel.name, np.full(1, np.nan), unit, flaw="not numbers"))
                continue
            values = np.asarray(channel[:], dtype=float)
            columns.append(Column(channel.name, values, unit, times=_times(said, values.size)))
    return Table(tuple(columns))


def _times(said: dict[str, object], n: int) -> np.ndarray | None:
    step = said.get("wf_increment")
    if not isinstance(step, int | float) or step <= 0:
        return None
    start = said.get("wf_start_offset", 0.0)
    return (float(start) if isinstance(start, int | float) else 0.0) + step * np.arange(n)
