"""A fit on its way: when it must end, where its parameters have been, and what it answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from bench import Cost, Estimate, NoEstimate, Normal, Problem, report_progress
from methods.network.response import NetworkResponse

Layers = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weights (n_out, n_in) and biases (n_out,), layer by layer."""
Now = tuple[float, float, float]
"""log(k/m), log(c/m) and the loss."""
SPACING = 1.035
"""Processor time at one moment of the path over that at the one before, at least."""
NOT_FINITE = "its training ran to numbers that are not finite; try another seed, or a record with less noise"


class Path:
    """Moments of a fit of ``problem``, from when this is made.

    ``losses`` holds one a moment, NaN where the package does not tell; ``steps`` counts the calls of :meth:`step`.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.began = problem, time.process_time()
        self.seconds: list[float] = []
        self.logs: list[tuple[float, float]] = []
        self.losses: list[float] = []
        self.steps = 0
        self._until, self._most = np.inf, 0

    def stage(self, seconds: float, most: int) -> None:
        """Begin a stage of at most so many seconds of processor time, and ``most`` steps (0: any number)."""
        self._until = time.process_time() + seconds
        self._most = self.steps + most if most else 0

    def step(self, now: Callable[[], Now], steps: int = 1) -> bool:
        """Count steps of the optimiser, note where it is if it is time to; whether the stage must end."""
        self.steps += steps
        clock = time.process_time()
        if not self.seconds or clock - self.began >= SPACING * self.seconds[-1]:
            self.note(*now())
        return clock >= self._until or bool(self._most and self.steps >= self._most)

    def note(self, log_stiffness: float, log_damping: float, loss: float) -> None:
        """Keep this moment, and report it as the best answer so far."""
        self.seconds.append(time.process_time() - self.began)
        self.logs.append((log_stiffness, log_damping))
        self.losses.append(loss)
        report_progress(self.problem, self._answer)

    def end(self, now: Now, layers: Layers, duration: float, message: str) -> Estimate:
        """The answer where the fit stands.

        Raises NoEstimate where it is not finite.
        """
        if not np.all(np.isfinite(now[:2])) or not all(np.all(np.isfinite(part)) for own in layers for part in own):
            raise NoEstimate(NOT_FINITE, cost=Cost(self.steps, self.steps))
        self.note(*now)
        return self._answer(tuple(layers), duration, message)

    def _answer(
        self, layers: tuple[tuple[np.ndarray, np.ndarray], ...] = (), duration: float = 1.0, message: str = ""
    ) -> Estimate:
        """The last moment; the response simulated from it stands in where the network is not given."""
        system = self.problem.system
        stiffness, damping = np.exp(np.array(self.logs)).T
        by_kind = {"mass": np.ones(stiffness.size), "damping": damping, "stiffness": stiffness}
        parameters = np.stack([by_kind[parameter.kind] for parameter in system.parameters], axis=1)
        last = dict(zip(system.names, parameters[-1], strict=True))
        return Estimate(
            system,
            groups=Normal(
                tuple(group.name for group in system.groups),
                np.array([float(group.value(last)) for group in system.groups]),
                covariance=None,
                log=False,
            ),
            reconstructions=(NetworkResponse(layers, duration),) if layers else (),
            message=message,
            cost=Cost(self.steps, self.steps),
            traces={
                "path_cpu_s": np.array(self.seconds),
                "path_parameters": parameters,
                "path_loss": np.array(self.losses),
            },
            dimensions={"path_parameters": [parameter.dimension for parameter in system.parameters]},
        )
