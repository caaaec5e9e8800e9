"""Ways to state what is believed after a fit of the family, beside the engine's linearisation; one file a way."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch

from methods.pinn.engine import torch_threads
from methods.pinn_family.beliefs import dropout, last_layer, nuts, variational
from methods.pinn_family.beliefs.trained import Posterior, TrainedFit
from methods.pinn_family.settings import FamilySettings

Way = Callable[[Posterior, TrainedFit, np.random.Generator, int], TrainedFit]
"""States a fit's uncertainty from its posterior, at random, with so many members where it has any."""

WAYS: Mapping[str, Way] = {
    "nuts": nuts.stated,
    "variational": variational.stated,
    "last_layer": last_layer.stated,
    "dropout": dropout.stated,
}


def stated(fit: TrainedFit, settings: FamilySettings, rng: np.random.Generator) -> TrainedFit:
    """The fit with its uncertainty as the settings ask for it."""
    assert fit.attempt is not None
    with torch_threads(settings.threads), torch.no_grad():
        return WAYS[settings.uncertainty](Posterior(fit.attempt), fit, rng, settings.members)
