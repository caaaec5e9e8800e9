"""The PINN family: the loss of the inverse PINN, and the ways that the literature has of training it.

Every setting but one is that of a base, so that a row of its table differs from it by one thing: the optimiser, the
weighting of the loss, the function of time, or where the equation of motion is asked for. All act on the residual
vector of :mod:`methods.pinn.residuals`, begin at the same start scan, and have the same budget of work, counted in
gradients (:mod:`methods.pinn_family.loss`). Each fit notes its path, and how far its end is from the minimum of what it
minimised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from bench import Card, Choice, Estimate, InputError
from methods.network.response import Function
from methods.pinn.collocation import Collocation
from methods.pinn.method import PINN
from methods.pinn.physics import PhysicsInformed
from methods.pinn.settings import Settings, Trainable
from methods.pinn.task import Task

if TYPE_CHECKING:
    from methods.network.ansatz import Ansatz
    from methods.pinn.block import Block
    from methods.pinn.engine import Fit
    from methods.pinn_family.architectures import Features
    from methods.pinn_family.path import Clock

OPTIMIZERS: Mapping[str, Choice] = {
    "adam": Choice("Adam", "D. P. Kingma and J. Ba, ICLR 2015", "torch"),
    "adam_lbfgs": Choice("Adam, then L-BFGS", "the paper's; D. C. Liu and J. Nocedal, Math. Program. 45:503, 1989", "scipy"),
    "lbfgs": Choice("L-BFGS", "D. C. Liu and J. Nocedal, Math. Program. 45:503, 1989", "scipy"),
    "soap": Choice("SOAP", "N. Vyas et al., ICLR 2025", "pytorch_optimizer"),
    "muon": Choice("Muon", "K. Jordan et al., 2024", "torch"),
    "self_scaled_bfgs": Choice("self-scaled BFGS", "J. F. Urbán et al., J. Comput. Phys. 523:113656, 2025"),
    "self_scaled_broyden": Choice("self-scaled Broyden", "J. F. Urbán et al., J. Comput. Phys. 523:113656, 2025"),
    "nystrom_newton_cg": Choice("Adam, then Nyström-Newton-CG", "P. Rathore et al., ICML 2024"),
    "natural_gradient": Choice(
        "energy natural gradient", "J. Müller and M. Zeinhofer, ICML 2023; a Gauss-Newton step with a line search"
    ),
    "variable_projection": Choice(
        "random features, variable projection", "V. Dwivedi and B. Srinivasan, Neurocomputing 391:96, 2020", "scipy"
    ),
    "lm": Choice("Levenberg-Marquardt", "H. B. Nielsen, IMM-REP-1999-05; in residual space as the PINN here"),
}
WEIGHTINGS: Mapping[str, Choice] = {
    "noise": Choice("by the estimated noise", "minus the log posterior, as the PINN here"),
    "paper": Choice("fixed, all one", "the paper's: selected empirically"),
    "relobralo": Choice("ReLoBRaLo", "R. Bischof and M. Kraus, arXiv:2110.09813, 2021"),
    "tangent_kernel": Choice("neural tangent kernel", "S. Wang et al., J. Comput. Phys. 449:110768, 2022"),
    "gradient_norms": Choice("gradient norms", "S. Wang et al., SIAM J. Sci. Comput. 43:A3055, 2021; arXiv:2308.08468"),
    "self_adaptive": Choice("self-adaptive", "L. McClenny and U. Braga-Neto, J. Comput. Phys. 474:111722, 2023", "torch"),
    "attention": Choice("residual-based attention", "S. Anagnostopoulos et al., CMAME 421:116805, 2024"),
    "augmented_lagrangian": Choice("augmented Lagrangian", "D. P. Bertsekas, 1982; PINNverse, arXiv:2504.05248, 2025"),
    "causal": Choice("causal", "S. Wang et al., CMAME 421:116813, 2024"),
}
ARCHITECTURES: Mapping[str, Choice] = {
    "tanh": Choice("tanh network", "the paper's: two hidden layers of 64", "torch"),
    "sine": Choice("sine activations", "V. Sitzmann et al., NeurIPS 2020", "torch"),
    "fourier": Choice("Fourier features", "S. Wang, H. Wang and P. Perdikaris, CMAME 384:113938, 2021", "torch"),
    "kolmogorov_arnold": Choice("Kolmogorov-Arnold", "Z. Liu et al., ICLR 2025; bumps of arXiv:2405.06721", "torch"),
    "pirate": Choice("PirateNet", "S. Wang et al., J. Mach. Learn. Res. 25:402, 2024", "torch"),
    "spline": Choice("B-spline", "J. M. Varah, SIAM J. Sci. Stat. Comput. 3:28, 1982", "scipy"),
}
SAMPLINGS: Mapping[str, Choice] = {
    "uniform": Choice("evenly spaced", "the paper's: 200 points"),
    "random": Choice("drawn anew each step", "M. Raissi et al., J. Comput. Phys. 378:686, 2019, as commonly trained"),
    "adaptive": Choice("where the residual is large", "C. Wu et al., CMAME 403:115671, 2023"),
}


@dataclass(frozen=True)
class PINNFamily(PhysicsInformed):
    """The settings; those of :class:`methods.pinn.settings.Settings`, and what a row of the table changes.

    ``budget``: work of a fit, all its starts together, in gradients. ``rate``: first learning rate of Adam, SOAP and Muon. ``width``, ``depth``:
    of the network.
    """

    optimizer: Literal[
        "adam",
        "adam_lbfgs",
        "lbfgs",
        "soap",
        "muon",
        "self_scaled_bfgs",
        "self_scaled_broyden",
        "nystrom_newton_cg",
        "natural_gradient",
        "variable_projection",
        "lm",
    ] = "lm"
    weighting: Literal[
        "noise",
        "paper",
        "relobralo",
        "tangent_kernel",
        "gradient_norms",
        "self_adaptive",
        "attention",
        "augmented_lagrangian",
        "causal",
    ] = "noise"
    architecture: Literal["tanh", "sine", "fourier", "kolmogorov_arnold", "pirate", "spline"] = "tanh"
    sampling: Literal["uniform", "random", "adaptive"] = "uniform"
    budget: float = 10_000.0
    rate: float = 1e-3
    width: int = 64
    depth: int = 2

    extra: ClassVar[str] = "training"
    requires: ClassVar[tuple[str, ...]] = ("torch", "pytorch_optimizer")
    card: ClassVar[Card] = Card(
        summary="the PINN's loss, trained in the ways of the literature, one setting apart from a base each",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="Gauss-Newton covariance at the end of the training, network weights profiled out, Student's t",
        settings_source="the sources of each choice; what they leave open is stated in the code of each",
        tuning="learning rate: 3 trials for each of Adam, SOAP and Muon on one development scenario",
        title="PINN family",
        order=68,
        colour="#882255",
        marker=(8, 1, 0.0),
        remarks=True,
        choices={
            "optimizer": OPTIMIZERS,
            "weighting": WEIGHTINGS,
            "architecture": ARCHITECTURES,
            "sampling": SAMPLINGS,
        },
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least({"width": 4, "depth": 1})
        for name in ("budget", "rate"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"method.{name}", getattr(self, name), "a positive number")
        if self.batch != 1:
            raise InputError("method.batch", self.batch, "1: each fit of the family goes its own way")
        if self.optimizer == "variable_projection" and self.weighting not in ("noise", "paper"):
            raise InputError("method.weighting", self.weighting, "noise or paper: variable_projection holds weights fixed")

    def _usual(self) -> Settings | None:
        """The settings of the tanh network or the spline, which are the engine's own."""
        if self.architecture == "tanh":
            return PINN(width=self.width, depth=self.depth, collocation=self.collocation)
        return Collocation(collocation=self.collocation) if self.architecture == "spline" else None

    def _features(self, resolution: int) -> tuple[Features, tuple[tuple[int, ...], ...]]:
        """The features of any other architecture, and the shapes of their coefficients."""
        from methods.pinn_family.architectures import FEATURES

        features = FEATURES[self.architecture](self.width, self.depth)
        return features, tuple(part.shape for part in features.start(resolution, np.random.default_rng(0)))

    def ansatz(self, block: Block, resolution: int) -> Ansatz:
        usual = self._usual()
        if usual is not None:
            return usual.ansatz(block, resolution)
        import torch

        from methods.pinn_family.architectures import FeatureAnsatz

        features, shapes = self._features(resolution)
        device = block.values.device
        tau = torch.as_tensor(2.0 * block.times / block.duration[:, None] - 1.0, device=device)
        rate = torch.as_tensor(2.0 / block.duration, device=device)
        return FeatureAnsatz(features, shapes, tau, rate, block.n_paths)

    def first_coefficients(
        self, n_paths: int, resolution: int, cycles: np.ndarray, rngs: Sequence[np.random.Generator]
    ) -> np.ndarray:
        usual = self._usual()
        if usual is not None:
            return usual.first_coefficients(n_paths, resolution, cycles, rngs)
        features, _ = self._features(resolution)
        found = []
        for rng in rngs:
            parts = features.start(resolution, rng)
            head = np.zeros(n_paths * (features.n_features() + 1))
            found.append(np.concatenate([*[part.ravel() for part in parts], head]))
        return np.stack(found)

    def response(self, coefficients: np.ndarray, n_paths: int, resolution: int, duration: float) -> Function:
        usual = self._usual()
        if usual is not None:
            return usual.response(coefficients, n_paths, resolution, duration)
        from methods.pinn_family.architectures import FeatureResponse

        features, shapes = self._features(resolution)
        return FeatureResponse(features, shapes, coefficients, n_paths, duration)

    def train(self, attempt: Trainable) -> None:
        """Not called: a fit of the family trains itself."""
        raise NotImplementedError

    def attempt(self, tasks: Sequence[Task]) -> None:
        """Fit each, and start those in a bad basin again elsewhere."""
        from methods.pinn_family.path import Clock

        for task in tasks:
            clock, used = Clock(), 0.0
            for n in range(1 + self.restarts):
                if task.wants(n) and used < self.budget:
                    found, work = self._fitted(task, n, clock, self.budget - used)
                    task.fits.append(found)
                    used += work

    def _fitted(self, task: Task, n: int, clock: Clock, budget: float) -> tuple[Fit, float]:
        from methods.pinn_family.attempt import fit
        from methods.pinn_family.path import Path

        own = replace(self, budget=budget)
        return fit(task.scaled, task.guesses[n], own, task.rng, Path(clock), partial(self._report, [task]))

    def _estimate(self, task: Task) -> Estimate:
        found = super()._estimate(task)
        own = [parameter.dimension for parameter in task.scaled.system.parameters]
        kept = {name: own for name in ("path_parameters", "minimum_parameters") if name in found.traces}
        return replace(found, dimensions=kept)
