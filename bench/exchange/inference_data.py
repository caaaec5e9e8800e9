"""The posterior draws of a stored cell as ArviZ has them, with the record that they are of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.errors import InputError
from bench.store.stored import StoredCell
from bench.systems import make_system

DRAWS = "draws"


def inference_data(stored: StoredCell, arrays: Mapping[str, np.ndarray]) -> Any:
    """The draws of the replicate whose arrays are kept, as ``arviz.InferenceData``.

    ``posterior``: a variable a parameter, of one chain (draws are thinned, and those of several walkers lie together:
    diagnostics of chains are no use on them). ``observed_data``: the displacements (m) by sample, with ``time`` (s) and
    ``dof`` as coordinates. Raises InputError where the cell keeps no draws.
    """
    if DRAWS not in arrays:
        raise InputError("cell", stored.identity, f"{stored.cell['label']} states no draws; take a method that samples")
    try:
        import arviz
    except ImportError:
        raise InputError("export", "arviz", "needs arviz: pip install 'vibration-bench[exchange]'") from None
    what = stored.cell
    names = make_system(what["data"]["system"], what["data"].get("options", {})).names
    draws = np.asarray(arrays[DRAWS], float)
    found = arviz.from_dict(
        posterior={name: draws[None, :, i] for i, name in enumerate(names)},
        observed_data={"displacement": np.asarray(arrays["sample_values"], float)},
        coords={
            "time": ("sample", np.asarray(arrays["sample_times"], float)),
            "dof": ("sample", np.asarray(arrays["sample_dof"], int)),
        },
        dims={"displacement": ["sample"]},
        attrs={
            "method": str(what["label"]), "system": str(what["system"]), "snr_db": float(what["snr_db"]),
            "seed": int(what["seed"]), "replicate": 0, "cell": stored.identity,
            "version": str(stored.version.get("method")),
        },
    )  # fmt: skip
    return found
