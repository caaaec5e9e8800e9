"""How long a method takes, from its stored cells."""

from __future__ import annotations

from statistics import median

from bench.store.store import Store


def fit_seconds(store: Store) -> dict[str, float]:
    """Return the median wall-clock time of a fit (s) over the stored cells of each method, by label."""
    seconds: dict[str, list[float]] = {}
    for head in store.heads():
        if not head.problem and head.wall_s > 0:
            seconds.setdefault(head.label, []).append(head.wall_s / head.replicates)
    return {label: median(values) for label, values in sorted(seconds.items())}
