"""How long a method takes, as its stored cells tell."""

from __future__ import annotations

from bench.store.store import Store


def fit_seconds(store: Store) -> dict[str, float]:
    """Median wall-clock time of a fit (s) over the stored cells of each method, by label."""
    from bench.store import index as view

    found = view.cells(store, ("problem", "label", "replicates", "wall_s"))
    good = found[(found["problem"] == "") & (found["wall_s"] > 0)]
    each = good["wall_s"].astype(float) / good["replicates"].astype(float)
    return {str(label): float(value) for label, value in each.groupby(good["label"]).median().items()}
