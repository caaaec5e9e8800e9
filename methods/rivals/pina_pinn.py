"""The inverse PINN of PINA, on torch and Lightning: Adam, then torch's L-BFGS through its optimiser interface.

D. Coscia, A. Ivagnes, N. Demo, G. Rozza, Journal of Open Source Software 8:5352, 2023. An ``InverseProblem`` with the
data, the equation and a known initial state as conditions, its ``FeedForward`` network with torch's initial weights,
its physics-informed solver and trainer. L-BFGS has the default options of DeepXDE, with 20 iterations per step.

Version 0.3.2 does not support L-BFGS for equations with unknowns, in two respects. Its callback that switches
optimisers passes on the weights of the network only; here the second optimiser belongs to a second solver of the same
network and problem. Its solver adds the unknowns as a second parameter group, while torch's L-BFGS supports one; here
they are added to the first group.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench import Card, Estimate
from methods.rivals.rival import (
    ADAM_RATE,
    COLLOCATION,
    HIDDEN,
    DecayRecord,
    FitPath,
    Now,
    TorchRival,
    linear_layers,
    rival_card,
    torch_set_up,
)

ITERATIONS_A_STEP = 20
LBFGS = {"lr": 1.0, "history_size": 100, "tolerance_grad": 1e-8, "tolerance_change": 0.0}
WIDE = 5.0
"""Half-width of the bounds of the log-unknowns about the initial guess, which the package requires."""


@dataclass(frozen=True)
class PINA(TorchRival):
    """PINA: Adam, then L-BFGS; see :class:`methods.rivals.rival.Rival`."""

    card: ClassVar[Card] = rival_card(
        "PINA", "Adam, then torch's L-BFGS, in double precision", "PINA 0.3.2 (pina-mathlab)", 1003
    )
    requires: ClassVar[tuple[str, ...]] = ("pina", "torch")

    def train(self, decay: DecayRecord, path: FitPath, seed: int) -> Estimate:
        with torch_set_up(self.threads, seed):
            import torch
            from pina.model import FeedForward
            from pina.optim import TorchOptimizer
            from pina.trainer import Trainer  # noqa: F401 - its import enables all warnings

            warnings.simplefilter("ignore")
            problem = _problem(decay)
            net = FeedForward(input_dimensions=1, output_dimensions=1, layers=list(HIDDEN), func=torch.nn.Tanh)
            adam, quasi_newton = self.stages
            path.stage(adam, self.adam_steps)
            _fit(problem, net, TorchOptimizer(torch.optim.Adam, lr=ADAM_RATE), path, 1)
            path.stage(quasi_newton, self.second_steps)
            iterations = min(ITERATIONS_A_STEP, self.second_steps or ITERATIONS_A_STEP)
            options = {**LBFGS, "max_iter": iterations, "max_eval": 50 * iterations, "line_search_fn": "strong_wolfe"}
            loss = _fit(problem, net, TorchOptimizer(_lbfgs(), **options), path, iterations)
            layers = [layer for layer in net.model if isinstance(layer, torch.nn.Linear)]
            return path.end((*_logs(problem), loss), linear_layers(layers), decay.duration)


def _lbfgs() -> type[Any]:
    """Return torch's L-BFGS, extended to add parameters to its single group."""
    import torch

    class OneGroup(torch.optim.LBFGS):
        def add_param_group(self, param_group: dict[str, Any]) -> None:
            if self.param_groups:
                self.param_groups[0]["params"].extend(param_group["params"])
            else:
                super().add_param_group(param_group)

    return OneGroup


def _logs(problem: Any) -> tuple[float, float]:
    return problem.unknown_parameters["log_k"].item(), problem.unknown_parameters["log_c"].item()


def _problem(decay: DecayRecord) -> Any:
    """Return the package's formulation of the decay, with the initial guess of the unknowns."""
    import torch
    from pina import Condition, LabelTensor
    from pina.domain import CartesianDomain
    from pina.equation import Equation, FixedValue
    from pina.operator import grad
    from pina.problem import InverseProblem, TimeDependentProblem

    speed = decay.speed

    def motion(s: Any, u: Any, unknowns: dict[str, Any]) -> Any:
        stiffness = torch.exp(unknowns["log_k"] - decay.units[0])
        damping = torch.exp(unknowns["log_c"] - decay.units[1])
        first = grad(u, s, components=["u"], d=["s"])
        second = grad(first, s, components=["duds"], d=["s"])
        return speed**2 * second + damping * speed * first + stiffness * u

    def labelled(values: np.ndarray, label: str) -> Any:
        return LabelTensor(torch.tensor(values[:, None]), [label])

    stated = {
        "data": Condition(input=labelled(decay.times, "s"), target=labelled(decay.values, "u")),
        "motion": Condition(domain="record", equation=Equation(motion)),
    }
    if decay.known_start is not None:
        x0, v0 = decay.known_start
        stated["place"] = Condition(domain="beginning", equation=FixedValue(x0))
        stated["velocity"] = Condition(
            domain="beginning", equation=Equation(lambda s, u: speed * grad(u, s, components=["u"], d=["s"]) - v0)
        )
    bounds = {name: [log - WIDE, log + WIDE] for name, log in zip(("log_k", "log_c"), decay.logs, strict=True)}

    class StatedDecay(TimeDependentProblem, InverseProblem):  # type: ignore[misc]
        output_variables: ClassVar[list[str]] = ["u"]
        temporal_domain = CartesianDomain({"s": [-1.0, 1.0]})
        unknown_parameter_domain = CartesianDomain(bounds)
        domains: ClassVar[dict[str, Any]] = {
            "record": CartesianDomain({"s": [-1.0, 1.0]}),
            "beginning": CartesianDomain({"s": -1.0}),
        }
        conditions: ClassVar[dict[str, Any]] = stated

    problem = StatedDecay()
    problem.discretise_domain(COLLOCATION, "grid", domains=["record"])
    problem.discretise_domain(1, "grid", domains=["beginning"])
    for name, log in zip(("log_k", "log_c"), decay.logs, strict=True):
        problem.unknown_parameters[name] = torch.nn.Parameter(torch.tensor([log]))
    return problem


def _fit(problem: Any, net: Any, optimiser: Any, path: FitPath, iterations: int) -> float:
    """Train by one optimiser with ``iterations`` per step until the path ends it; return the last loss."""
    from lightning.pytorch.callbacks import Callback
    from pina.solver import PhysicsInformedSingleModelSolver
    from pina.trainer import Trainer

    class Watch(Callback):
        loss = float("nan")

        def on_train_batch_end(self, trainer: Any, pl_module: Any, outputs: Any, batch: Any, batch_idx: int) -> None:
            self.loss = float(outputs["loss"])

            def now() -> Now:
                return *_logs(problem), self.loss

            trainer.should_stop = path.step(now, iterations)

    watch = Watch()
    solver = PhysicsInformedSingleModelSolver(problem, net, optimizer=optimiser)
    silent = dict.fromkeys(("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary"), False)
    Trainer(solver, max_epochs=-1, accelerator="cpu", devices=1, callbacks=[watch], **silent).train()
    return watch.loss
