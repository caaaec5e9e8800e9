"""What a twin says of a sample: one line of JSON."""

from __future__ import annotations

import json
import math
from typing import Any

from bench.contract.online import Layout, Sample, Standing
from bench.online.follow import moments

Z95 = 1.959963984540054


def content(number: int, sample: Sample, standing: Standing, layout: Layout, alarm_at: float | None) -> dict[str, Any]:
    """The answer as JSON holds it; null stands for what is not there."""
    means, sds = moments(standing, layout)
    quantities = {
        q.name: {
            "value": _number(math.exp(m)), "low": _number(math.exp(m - Z95 * s)),
            "high": _number(math.exp(m + Z95 * s)), "unit": q.unit,
        }
        for q, m, s in zip(layout.quantities, means.tolist(), sds.tolist(), strict=True)
        if math.isfinite(m) and s < 20.0
    }  # fmt: skip
    predicted = [] if standing.prediction is None else standing.prediction.tolist()
    widths = [] if standing.prediction_sd is None else standing.prediction_sd.tolist()
    return {
        "sample": number,
        "t": _number(sample.time),
        "status": standing.status.value,
        "message": standing.message,
        "quantities": quantities,
        "measured": [_number(value) for value in sample.values],
        "prediction": [_number(value) for value in predicted],
        "prediction_sd": [_number(value) for value in widths],
        "residual": [_number(y - h) for y, h in zip(sample.values, predicted, strict=False)],
        "alarm": _number(standing.alarm),
        "ringing": alarm_at is not None and standing.alarm > alarm_at,
    }


def line(found: dict[str, Any]) -> str:
    """As a line."""
    return json.dumps(found, allow_nan=False, separators=(",", ":"))


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
