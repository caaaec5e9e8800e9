"""The inverse PINN of DeepXDE, on torch in double precision: Adam, then its L-BFGS.

L. Lu, X. Meng, Z. Mao, G. E. Karniadakis, SIAM Review 63:208, 2021. As in its examples of inverse problems for ordinary
differential equations: a ``TimeDomain``, the data as a ``PointSetBC``, a known initial state as ``IC`` and
``OperatorBC``, the unknowns as external trainable variables, Glorot-normal weights. Its L-BFGS has the default options,
but returns after 20 iterations instead of 1,000, so that the time limit can be checked. The package interprets a return
after one iteration as convergence, so the number of evaluations must not end a call.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from bench import Card, Estimate, NoEstimate
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

ITERATIONS_A_RETURN = 20
MANY = 10**9
"""Number of steps where the time limit ends a stage."""


@dataclass(frozen=True)
class DeepXDE(TorchRival):
    """DeepXDE: Adam, then L-BFGS; see :class:`methods.rivals.rival.Rival`."""

    card: ClassVar[Card] = rival_card(
        "DeepXDE", "Adam, then its L-BFGS, in double precision", "DeepXDE 1.15.0 on torch", 1001
    )
    requires: ClassVar[tuple[str, ...]] = ("deepxde", "torch")

    def train(self, decay: DecayRecord, path: FitPath, seed: int) -> Estimate:
        with torch_set_up(self.threads, seed):
            dde = _package()
            before = dde.config.default_float()
            dde.config.set_default_float("float64")
            try:
                return self._train(dde, decay, path, seed)
            finally:
                dde.config.set_default_float(before)

    def _train(self, dde: ModuleType, decay: DecayRecord, path: FitPath, seed: int) -> Estimate:
        dde.config.set_random_seed(seed)
        logs = [dde.Variable(value) for value in decay.logs]
        model, terms = _model(dde, decay, logs)

        def now() -> Now:
            loss = model.train_state.loss_train
            return logs[0].item(), logs[1].item(), float(np.sum(loss)) if loss is not None else float("nan")

        watch = _watch(dde, path, now)
        adam, quasi_newton = self.stages
        common = {"loss_weights": [1.0] * terms, "external_trainable_variables": logs, "verbose": 0}
        path.stage(adam, self.adam_steps)
        model.compile("adam", lr=ADAM_RATE, **common)
        model.train(iterations=self.adam_steps or MANY, display_every=100, callbacks=[watch], verbose=0)
        path.stage(quasi_newton, self.second_steps)
        dde.optimizers.set_LBFGS_options(maxiter=MANY)
        options = dde.optimizers.LBFGS_options
        options["iter_per_step"] = min(ITERATIONS_A_RETURN, self.second_steps or MANY)
        options["fun_per_step"] = ITERATIONS_A_RETURN * options["maxls"]
        model.compile("L-BFGS", **common)
        model.train(callbacks=[watch], verbose=0)
        model._test(verbose=0)
        return path.end(now(), linear_layers(model.net.linears), decay.duration)


def _package() -> ModuleType:
    """Import DeepXDE with the torch backend, without writing its configuration file to the home folder.

    Raises NoEstimate where it was imported before with another backend.
    """
    import torch

    backend = os.environ.get("DDE_BACKEND")
    if "deepxde" not in sys.modules:
        os.environ["DDE_BACKEND"] = "pytorch"
    try:
        import deepxde
    finally:
        if backend is None:
            os.environ.pop("DDE_BACKEND", None)
        else:
            os.environ["DDE_BACKEND"] = backend
    torch.set_default_device(None)  # its import selects a GPU if there is one
    if deepxde.backend.backend_name != "pytorch":
        raise NoEstimate(f"DeepXDE runs on {deepxde.backend.backend_name} in this process; torch is required")
    return deepxde


def _model(dde: ModuleType, decay: DecayRecord, logs: list[Any]) -> tuple[Any, int]:
    """Return the model of equation, data, known initial state and network; and the number of terms of the loss."""
    import torch

    speed = decay.speed

    def motion(s: Any, u: Any) -> Any:
        stiffness, damping = (torch.exp(log - unit) for log, unit in zip(logs, decay.units, strict=True))
        velocity = speed * dde.grad.jacobian(u, s)
        return speed**2 * dde.grad.hessian(u, s) + damping * velocity + stiffness * u

    def at_the_start(s: Any, on_boundary: bool) -> bool:
        return bool(on_boundary and s[0] < 0.0)

    line = dde.geometry.TimeDomain(-1.0, 1.0)
    conditions = [dde.icbc.PointSetBC(decay.times[:, None], decay.values[:, None])]
    if decay.known_start is not None:
        x0, v0 = decay.known_start
        conditions += [
            dde.icbc.IC(line, lambda s: np.full((len(s), 1), x0), at_the_start),
            dde.icbc.OperatorBC(line, lambda s, u, _: speed * dde.grad.jacobian(u, s) - v0, at_the_start),
        ]
    data = dde.data.PDE(
        line, motion, conditions, num_domain=COLLOCATION - 2, num_boundary=2, train_distribution="uniform"
    )
    net = dde.nn.FNN([1, *HIDDEN, 1], "tanh", "Glorot normal")
    return dde.Model(data, net), 1 + len(conditions)


def _watch(dde: ModuleType, path: FitPath, now: Any) -> Any:
    """Return a callback that counts steps on the path and ends the training at its limits."""

    class Watch(dde.callbacks.Callback):  # type: ignore[misc,name-defined]
        before = -1

        def on_train_begin(self) -> None:
            self.before = self.model.train_state.step

        def on_epoch_end(self) -> None:
            taken = self.model.train_state.step - self.before
            self.before = self.model.train_state.step
            self.model.stop_training = path.step(now, taken) or taken == 0

    return Watch()
