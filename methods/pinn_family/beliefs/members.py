"""Fits whose spread is the uncertainty: of other first weights (ensemble), or of simulated records (bootstrap)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from methods.pinn.task import Task, simulated
from methods.pinn_family.attempt import fit
from methods.pinn_family.path import Clock, Path

if TYPE_CHECKING:
    from methods.pinn.engine import Fit
    from methods.pinn_family.settings import FamilySettings


def members(task: Task, best: Fit, settings: FamilySettings) -> list[Fit]:
    """``settings.members`` fits from the guess of the best, each with its own first weights and the whole budget."""
    guess = task.guesses[task.fits.index(best)]
    bootstrap = settings.uncertainty == "bootstrap"
    problems = [simulated(task.scaled, best, task.rng) if bootstrap else task.scaled for _ in range(settings.members)]
    found: list[Fit] = []
    for problem, rng in zip(problems, task.rng.spawn(settings.members), strict=True):
        own, _ = fit(problem, guess, settings, rng, Path(Clock()), lambda results: None)
        own.attempt = None
        if np.all(np.isfinite(own.logs)):
            found.append(own)
    return found
