"""Ways to state what is believed after a fit of the family, beside the engine's linearisation; one file a way."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch

from methods.pinn.engine import torch_threads
from methods.pinn_family.beliefs.dropout import dropout
from methods.pinn_family.beliefs.last_layer import last_layer
from methods.pinn_family.beliefs.nuts import nuts
from methods.pinn_family.beliefs.trained import Posterior, TrainedFit
from methods.pinn_family.beliefs.variational import variational
from methods.pinn_family.settings import FamilySettings

Way = Callable[[Posterior, TrainedFit, np.random.Generator, int], TrainedFit]
"""States a fit's uncertainty from its posterior, at random, with so many members where it has any."""

WAYS: Mapping[str, Way] = {
    "nuts": nuts,
    "variational": variational,
    "last_layer": last_layer,
    "dropout": dropout,
}


def stated(fit: TrainedFit, settings: FamilySettings, rng: np.random.Generator) -> TrainedFit:
    """The fit with its uncertainty as the settings ask for it."""
    assert fit.attempt is not None
    with torch_threads(settings.threads), torch.no_grad():
        return WAYS[settings.uncertainty](Posterior(fit.attempt), fit, rng, settings.members)
