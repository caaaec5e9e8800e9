"""Convert the posterior draws of a stored cell to ArviZ, with their record."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.errors import InputError
from bench.store.stored_cell import StoredCell
from bench.systems import make_system


def inference_data(stored: StoredCell) -> Any:
    """Return the draws of replicate 0 as ``arviz.InferenceData``.

    ``posterior`` has a variable per parameter, in one chain: the draws are thinned and those of several walkers merged,
    so diagnostics of chains do not apply. ``observed_data`` has the displacements (m) by sample, with the coordinates
    ``time`` (s) and ``dof``. Raises InputError for a cell without draws.
    """
    arrays = stored.arrays
    if "draws" not in arrays:
        raise InputError("cell", stored.identity, f"{stored.cell['label']} states no draws; take a method that samples")
    import arviz

    cell = stored.cell
    names = make_system(cell["data"]["system"], cell["data"].get("options", {})).names
    draws = np.asarray(arrays["draws"], float)
    return arviz.from_dict(
        posterior={name: draws[None, :, i] for i, name in enumerate(names)},
        observed_data={"displacement": np.asarray(arrays["sample_values"], float)},
        coords={
            "time": ("sample", np.asarray(arrays["sample_times"], float)),
            "dof": ("sample", np.asarray(arrays["sample_dof"], int)),
        },
        dims={"displacement": ["sample"]},
        attrs={
            "method": str(cell["label"]), "system": str(cell["system"]), "snr_db": float(cell["snr_db"]),
            "seed": int(cell["seed"]), "replicate": 0, "cell": stored.identity,
            "version": str(stored.version.get("method")),
        },
    )  # fmt: skip
