"""The inverse PINN of jinns, on JAX in double precision: Adam of optax, then its self-scaled Broyden method.

H. Gangloff, N. Jouvin, arXiv:2412.14132, 2024. Its ``PINN_MLP``, ``LossODE`` and ``solve`` with the initial weights of
equinox. Since it has no condition for an initial velocity, this is a second dynamic loss, evaluated at time 0 for all
times. The second optimiser is its ``scale_by_SSBroyden_family`` (after arXiv:2405.04230).

``solve`` is compiled for each fit and optimiser, which takes several seconds; these count on the path, but not in a
stage's time. The time limit and the path use the package's interface for validation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench import Card, Estimate
from methods.rivals.rival import ADAM_RATE, COLLOCATION, HIDDEN, DecayRecord, FitPath, Rival, rival_card

MOST_A_SECOND = 20_000
"""Steps per second for which memory is allocated."""
ADAM_EVERY = 20
"""Steps of Adam between two checks of the time limit."""


@dataclass(frozen=True)
class Jinns(Rival):
    """jinns: Adam, then its self-scaled Broyden method; see :class:`methods.rivals.rival.Rival`.

    The number of threads is that of JAX for the whole process.
    """

    second_steps: int = 300

    card: ClassVar[Card] = rival_card("jinns", "Adam, then its self-scaled Broyden method", "jinns 1.10.2", 1002)
    requires: ClassVar[tuple[str, ...]] = ("jinns", "jax")

    def train(self, decay: DecayRecord, path: FitPath, seed: int) -> Estimate:
        import jax

        jax.config.update("jax_enable_x64", True)
        import optax
        from jinns.optimizers import scale_by_SSBroyden_family
        from jinns.solver import GetJinnsVariableName

        keys = jax.random.split(jax.random.PRNGKey(seed), 4)
        net, params = _network(decay, keys[0])
        loss, data = _loss(decay, net, params), _data(decay, keys[1], keys[2])
        extra = {
            "value": GetJinnsVariableName("train_loss_value"),
            "grad_pt": GetJinnsVariableName("grads"),
            "value_fn": get_value_fn,
            "grad_fn": get_grad_fn,
        }
        last = float("nan")
        stages = [
            (optax.adam(ADAM_RATE), None, ADAM_EVERY, self.adam_steps),
            (scale_by_SSBroyden_family(), extra, 1, self.second_steps),
        ]
        for seconds, (optimiser, needs, every, most) in zip(self.stages, stages, strict=True):
            stage = SolveStage(path, seconds, every, most or int(MOST_A_SECOND * seconds) + 1)
            params, last = stage.solve(loss, params, data, optimiser, needs)
        leaves = [np.array(leaf) for leaf in jax.tree.leaves(params.nn_params)]
        logs = float(params.eq_params.log_k), float(params.eq_params.log_c)
        return path.end((*logs, last), list(zip(leaves[::2], leaves[1::2], strict=True)), decay.duration)


def get_value_fn(loss: Any, batch: Any) -> Callable[..., Any]:
    """Return the loss as a function of the parameters; jinns finds the arguments by their names."""

    def value(params: Any, **_: Any) -> Any:
        return loss(params, batch)[0]

    return value


def get_grad_fn(loss: Any, batch: Any) -> Callable[..., Any]:
    """Return the gradient of the loss as a function of the parameters; jinns finds the arguments by their names."""
    import jax

    return jax.grad(lambda params, **_: loss(params, batch)[0])


def _network(decay: DecayRecord, key: Any) -> tuple[Any, Any]:
    """Return the package's network, and its weights with the initial guess of the unknowns."""
    import equinox
    import jax
    import jax.numpy as jnp
    from jinns.nn import PINN_MLP
    from jinns.parameters import Params

    first, second = HIDDEN
    tanh, linear = (jax.nn.tanh,), equinox.nn.Linear
    shape = ((linear, 1, first), tanh, (linear, first, second), tanh, (linear, second, 1))
    net, weights = PINN_MLP.create(key=key, eqx_list=shape, eq_type="ODE")
    unknowns = {name: jnp.asarray(log) for name, log in zip(("log_k", "log_c"), decay.logs, strict=True)}
    return net, Params(nn_params=weights, eq_params=unknowns)


def _loss(decay: DecayRecord, net: Any, params: Any) -> Any:
    """Return the loss: equation, known initial state and data, each with weight 1."""
    import jax
    import jax.numpy as jnp
    from jinns.loss import ODE, LossODE, LossWeightsODE
    from jinns.parameters import DerivativeKeysODE

    start = decay.known_start

    def rate(u: Any, params: Any) -> Callable[[Any], Any]:
        """Return the derivative of the network by its time, a number."""
        return lambda s: jax.grad(lambda t: u(t, params)[0])(s)[0]

    class Motion(ODE):  # type: ignore[misc]
        def equation(self, t: Any, u: Any, params: Any) -> Any:
            stiffness = jnp.exp(params.eq_params.log_k - decay.units[0])
            damping = jnp.exp(params.eq_params.log_c - decay.units[1])
            first = rate(u, params)
            second = jax.grad(first)(t)[0]
            return jnp.array([decay.speed**2 * second + damping * decay.speed * first(t) + stiffness * u(t, params)[0]])

    class Velocity(ODE):  # type: ignore[misc]
        def equation(self, t: Any, u: Any, params: Any) -> Any:
            assert start is not None
            return jnp.array([decay.speed * rate(u, params)(jnp.array([-1.0])) - start[1]])

    keys = DerivativeKeysODE.from_str(
        params=params, dyn_loss="both", observations="nn_params", initial_condition="nn_params"
    )
    return LossODE(
        u=net,
        dynamic_loss=(Motion(), Velocity()) if start else Motion(),
        initial_condition=(jnp.array([-1.0]), jnp.array([start[0]])) if start else None,
        loss_weights=LossWeightsODE(
            dyn_loss=(1.0, 1.0) if start else 1.0, initial_condition=1.0 if start else None, observations=1.0
        ),
        derivative_keys=keys,
        params=params,
    )


def _data(decay: DecayRecord, key: Any, other: Any) -> dict[str, Any]:
    """Return collocation points and observations."""
    import jax.numpy as jnp
    from jinns.data import DataGeneratorObservations, DataGeneratorODE

    return {
        "data": DataGeneratorODE(key=key, nt=COLLOCATION, tmin=-1.0, tmax=1.0, method="grid"),
        "obs_data": DataGeneratorObservations(
            key=other,
            observed_pinn_in=jnp.asarray(decay.times[:, None]),
            observed_values=jnp.asarray(decay.values[:, None]),
        ),
    }


class SolveStage:
    """One call of ``solve``: at most ``most`` steps and ``seconds`` from the first, checked every ``every`` steps."""

    def __init__(self, path: FitPath, seconds: float, every: int, most: int) -> None:
        self.path, self.seconds, self.every, self.most = path, seconds, every, most
        self.begun = path.steps
        self.noted: list[tuple[int, int]] = []  # indices of path entries with the step of this stage

    def solve(self, loss: Any, params: Any, data: dict[str, Any], optimiser: Any, needs: Any) -> tuple[Any, float]:
        """Train by one optimiser until the stage ends; return the parameters and the last loss."""
        import jax
        import jinns

        done = jinns.solve(
            n_iter=self.most,
            init_params=params,
            loss=loss,
            optimizer=optimiser,
            print_loss_every=self.most + 1,
            extra_optax_args_and_kwargs=needs,
            validation=_clock(self.ask, self.every),
            verbose=False,
            **data,
        )
        jax.effects_barrier()
        losses = np.asarray(done[1])
        for moment, step in self.noted:
            self.path.losses[moment] = float(losses[step])
        taken = int(np.max(np.flatnonzero(losses), initial=0)) + 1  # the losses of steps not taken are zero
        self.path.steps = self.begun + taken
        return done[0], float(losses[taken - 1])

    def ask(self, log_k: Any, log_c: Any) -> np.ndarray:
        """Return whether to stop, as an array for the compiled loop."""
        path = self.path
        if path.steps == self.begun:
            path.stage(self.seconds, 0)
        step, moments = path.steps - self.begun, len(path.losses)
        stop = path.step(lambda: (float(log_k), float(log_c), float("nan")), self.every)
        if len(path.losses) > moments:
            self.noted.append((moments, step))
        return np.array(stop)


def _clock(ask: Callable[[Any, Any], np.ndarray], every: int) -> Any:
    """Return a validation module of the package that checks every ``every`` steps whether to stop."""
    import equinox
    import jax
    import jax.numpy as jnp
    from jax.experimental import io_callback
    from jinns.validation import AbstractValidationModule

    class Clock(AbstractValidationModule):  # type: ignore[misc]
        call_every: int = equinox.field(kw_only=True, static=True)
        ask: Callable[[Any, Any], np.ndarray] = equinox.field(kw_only=True, static=True)

        def __call__(self, params: Any) -> tuple[Any, Any, Any, Any]:
            answer = jax.ShapeDtypeStruct((), bool)
            stop = io_callback(self.ask, answer, params.eq_params.log_k, params.eq_params.log_c)
            return self, stop, jnp.zeros(()), jnp.array(False)

    return Clock(call_every=every, ask=ask)
