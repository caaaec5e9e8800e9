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
from functools import cached_property
from typing import Any

import numpy as np

from bench.contract.online import Layout
from bench.dynamics.mechanics import acceleration, state_rate
from bench.dynamics.ops import array_ops
from bench.dynamics.stepper import rk4_step

SUBSTEPS = 4
"""Runge-Kutta steps in an interval, a power of two."""


@dataclass(frozen=True)
class HeldModel:
    """The discrete model of a layout; its functions are of jax, and take and give jax arrays."""

    layout: Layout

    @cached_property
    def n_motion(self) -> int:
        """Displacements, velocities and hidden states."""
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
        """Of the joint state."""
        return self.n_motion + self.n_ambient + self.n_sensors + self.n_free

    @property
    def ambient(self) -> slice:
        """Where the unknown forces stand in the joint state."""
        return slice(self.n_motion, self.n_motion + self.n_ambient)

    @property
    def offsets(self) -> slice:
        """Where the sensors' offsets stand."""
        return slice(self.ambient.stop, self.ambient.stop + self.n_sensors)

    @property
    def logs(self) -> slice:
        """Where the log-parameters stand."""
        return slice(self.offsets.stop, self.offsets.stop + self.n_free)

    def parameters(self, logs: Any) -> dict[str, Any]:
        """All parameters, the gauge one unit where nothing tells the scale."""
        import jax.numpy as jnp

        found = dict.fromkeys(self.layout.system.names, 1.0)
        return found | dict(zip(self.layout.free, jnp.exp(logs), strict=True))

    def _force(self, known: Any, ambient: Any) -> list[Any]:
        force: list[Any] = [0.0] * self.layout.system.n_dof
        for i, dof in enumerate(self.layout.forced):
            force[dof] = force[dof] + known[i]
        for i, dof in enumerate(self.layout.ambient):
            force[dof] = force[dof] + ambient[i]
        return force

    def moved(self, p: Mapping[str, Any], motion: Any, known: Any, ambient: Any, interval: Any) -> Any:
        """The motion after an interval (s) under held forces (N)."""
        import jax
        import jax.numpy as jnp

        ops, force, h = array_ops(jnp), self._force(known, ambient), interval / SUBSTEPS
        if self.layout.system.linear:
            return self._moved_linearly(p, motion, force, h)

        def step(_: Any, now: Any) -> Any:
            return jnp.stack(rk4_step(self.layout.system, p, list(now), h, (force, force, force), ops))

        return jax.lax.fori_loop(0, SUBSTEPS, step, motion)

    def _moved_linearly(self, p: Mapping[str, Any], motion: Any, force: list[Any], h: Any) -> Any:
        """The same steps of a linear system: powers of one matrix over motion and force, which acts as a constant 1.

        A Runge-Kutta step of order four is there the Taylor polynomial of degree four; steps are joined by squaring.
        """
        import jax
        import jax.numpy as jnp

        n, ops = self.n_motion, array_ops(jnp)

        def rate(state: Any) -> Any:
            return jnp.stack(state_rate(self.layout.system, p, [state[i] for i in range(n)], force, ops))

        rows = jnp.concatenate([jax.jacfwd(rate)(jnp.zeros(n)), rate(jnp.zeros(n))[:, None]], axis=1)
        z = h * jnp.concatenate([rows, jnp.zeros((1, n + 1))])
        z2 = z @ z
        step = jnp.eye(n + 1) + z + z2 / 2.0 + z2 @ (z / 6.0 + z2 / 24.0)
        for _ in range(SUBSTEPS.bit_length() - 1):
            step = step @ step
        return step[:n, :n] @ motion + step[:n, n]

    def advance(self, joint: Any, known: Any, interval: Any, memory: Any) -> Any:
        """The joint state after an interval; ``memory`` is what the unknown force keeps of itself (0: white)."""
        import jax.numpy as jnp

        ambient = joint[self.ambient]
        motion = self.moved(self.parameters(joint[self.logs]), joint[: self.n_motion], known, ambient, interval)
        return jnp.concatenate([motion, memory * ambient, joint[self.offsets.start :]])

    def observe(self, joint: Any, known: Any) -> Any:
        """What the sensors show of a joint state without noise, shape (n_sensors,)."""
        import jax.numpy as jnp

        system, motion = self.layout.system, joint[: self.n_motion]
        n, ops = system.n_dof, array_ops(jnp)
        by_kind: dict[str, Any] = {"displacement": motion[:n], "velocity": motion[n : 2 * n]}
        if any(sensor.measures == "acceleration" for sensor in self.layout.sensors):
            force = self._force(known, joint[self.ambient])
            x, v, z = list(motion[:n]), list(motion[n : 2 * n]), list(motion[2 * n :])
            by_kind["acceleration"] = acceleration(system, self.parameters(joint[self.logs]), x, v, force, z, ops)
        seen = [by_kind[sensor.measures][sensor.dof] for sensor in self.layout.sensors]
        return jnp.stack(seen) + joint[self.offsets]

    def start(self, logs: np.ndarray, motion: np.ndarray | None = None) -> np.ndarray:
        """A joint state at given log-parameters, with a motion or at rest."""
        joint = np.zeros(self.size)
        joint[self.logs] = logs
        if motion is not None:
            joint[: self.n_motion] = motion
        return joint
