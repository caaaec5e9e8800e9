"""A system between two samples, with parameters and forces held: one discrete model, which jax differentiates.

The joint state is ``[motion, ambient force, sensor offset, log-parameters]``: displacements, velocities and hidden
states; the force (N) that nobody measures, one a DOF; an offset a sensor; the logarithms of the layout's free
parameters. Over an interval the motion follows the residual by Runge-Kutta steps of order four; offsets and
log-parameters stay. With five samples a cycle the steps bend a frequency by a part in 10 000, with twenty by less than
one in a million.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench.contract.online import Layout
from bench.dynamics.mechanics import acceleration, state_rate
from bench.dynamics.ops import array_ops
from bench.dynamics.stepper import rk4_step

SUBSTEPS = 4
"""Runge-Kutta steps in an interval, a power of two."""


@dataclass(frozen=True)
class DiscreteModel:
    """The discrete model of a layout; its functions are of jax, and take and give jax arrays.

    ``ambient``, ``offsets`` and ``logs`` are the places of forces, offsets and log-parameters in the joint state.
    """

    layout: Layout

    @property
    def n_motion(self) -> int:
        """Number of displacements, velocities and hidden states."""
        return 2 * self.layout.system.n_dof + self.layout.system.n_hidden

    @property
    def n_ambient(self) -> int:
        return len(self.layout.ambient)

    @property
    def n_sensors(self) -> int:
        return len(self.layout.sensors)

    @property
    def n_free(self) -> int:
        return len(self.layout.free)

    @property
    def size(self) -> int:
        return self.n_motion + self.n_ambient + self.n_sensors + self.n_free

    @property
    def ambient(self) -> slice:
        return slice(self.n_motion, self.n_motion + self.n_ambient)

    @property
    def offsets(self) -> slice:
        return slice(self.ambient.stop, self.ambient.stop + self.n_sensors)

    @property
    def logs(self) -> slice:
        return slice(self.offsets.stop, self.size)

    def parameters(self, logs: Any) -> dict[str, Any]:
        """Return all parameters, the gauge one unit where the scale is not determined."""
        import jax.numpy as jnp

        return dict.fromkeys(self.layout.system.names, 1.0) | dict(zip(self.layout.free, jnp.exp(logs), strict=True))

    def _force(self, known: Any, ambient: Any) -> list[Any]:
        force: list[Any] = [0.0] * self.layout.system.n_dof
        for dofs, values in ((self.layout.forced, known), (self.layout.ambient, ambient)):
            for i, dof in enumerate(dofs):
                force[dof] = force[dof] + values[i]
        return force

    def _moved(self, p: Mapping[str, Any], motion: Any, force: list[Any], interval: Any) -> Any:
        """Return the motion after an interval (s) under held forces (N).

        The steps of a linear system are powers of one matrix over motion and force, which acts as a constant 1: a step
        of order four is there the Taylor polynomial of degree four, and steps are joined by squaring.
        """
        import jax
        import jax.numpy as jnp

        system, n, ops, h = self.layout.system, self.n_motion, array_ops(jnp), interval / SUBSTEPS
        if not system.linear:

            def step(_: Any, now: Any) -> Any:
                return jnp.stack(rk4_step(system, p, list(now), h, (force, force, force), ops))

            return jax.lax.fori_loop(0, SUBSTEPS, step, motion)

        def rate(state: Any) -> Any:
            return jnp.stack(state_rate(system, p, [state[i] for i in range(n)], force, ops))

        rows = jnp.concatenate([jax.jacfwd(rate)(jnp.zeros(n)), rate(jnp.zeros(n))[:, None]], axis=1)
        z = h * jnp.concatenate([rows, jnp.zeros((1, n + 1))])
        z2 = z @ z
        power = jnp.eye(n + 1) + z + z2 / 2.0 + z2 @ (z / 6.0 + z2 / 24.0)
        for _ in range(SUBSTEPS.bit_length() - 1):
            power = power @ power
        return power[:n, :n] @ motion + power[:n, n]

    def advance(self, joint: Any, known: Any, interval: Any, memory: Any) -> Any:
        """Return the joint state after an interval (s) under known forces (N).

        ``memory``: the part of an ambient force that is left after it, 0 for a white one.
        """
        import jax.numpy as jnp

        ambient = joint[self.ambient]
        p, force = self.parameters(joint[self.logs]), self._force(known, ambient)
        motion = self._moved(p, joint[: self.n_motion], force, interval)
        return jnp.concatenate([motion, memory * ambient, joint[self.offsets.start :]])

    def observe(self, joint: Any, known: Any) -> Any:
        """Return what the sensors show of a joint state without noise, shape (n_sensors,)."""
        import jax.numpy as jnp

        system, motion = self.layout.system, joint[: self.n_motion]
        n, ops = system.n_dof, array_ops(jnp)
        x, v, z = motion[:n], motion[n : 2 * n], motion[2 * n :]
        by_kind: dict[str, Any] = {"displacement": x, "velocity": v}
        if any(sensor.measures == "acceleration" for sensor in self.layout.sensors):
            p, force = self.parameters(joint[self.logs]), self._force(known, joint[self.ambient])
            by_kind["acceleration"] = acceleration(system, p, list(x), list(v), force, list(z), ops)
        return jnp.stack([by_kind[s.measures][s.dof] for s in self.layout.sensors]) + joint[self.offsets]
