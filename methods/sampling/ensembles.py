"""Several ensembles of walkers in lockstep, with one call of the posterior for the walkers of all.

All ensembles take the same kind of move in each step, in a fixed order, which leaves the posterior invariant like a
random choice. Independent proposals do not depend on the walkers' positions, so those of a whole run are drawn and
evaluated at its beginning. Each ensemble has its own random generator.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from methods.sampling.mixture import Mixture

SNOOKER_EVERY = 5
"""One in SNOOKER_EVERY dependent moves is a snooker move; the others are differential evolution."""
REACH = 1.7
"""Scale of a snooker move, as recommended by ter Braak and Vrugt."""


@dataclass(eq=False)
class Ensemble:
    """An ensemble: index of its problem in the posterior, proposal and random generator."""

    problem: int
    proposal: Mixture
    random: Any


class Snooker:
    """The snooker move (C. ter Braak, J. Vrugt, Stat. Comput. 18:435, 2008), with the interface of emcee's moves.

    A walker moves along the line through itself and another walker z by ``REACH`` times the projection of the
    difference of two more; the acceptance has the factor ``(|new - z| / |old - z|)^(d - 1)`` (equation 4). emcee's
    implementation uses the square root of the distance to z, which does not leave the density invariant.
    """

    nsplits = 4

    def get_proposal(self, s: np.ndarray, c: Sequence[np.ndarray], random: Any) -> tuple[np.ndarray, np.ndarray]:
        """Propose moves of walkers s (n, size) from three other parts of the ensemble; return them and log factors."""
        n, size = s.shape
        drawn = np.stack([part[random.randint(len(part), size=n)] for part in c])
        order = np.argsort(random.random_sample((n, 3)), axis=1)
        z, first, second = (drawn[order[:, i], np.arange(n)] for i in range(3))
        length = np.linalg.norm(s - z, axis=1)
        direction = (s - z) / length[:, None]
        new = s + REACH * np.sum(direction * (first - second), axis=1)[:, None] * direction
        return new, (size - 1.0) * np.log(np.linalg.norm(new - z, axis=1) / length)


class Lockstep:
    """Ensembles with equal numbers of walkers, from overdispersed initial positions; :meth:`run` makes steps.

    ``coords`` (ensembles, walkers, size): positions. ``log_prob`` and ``log_q`` (ensembles, walkers): their
    log-densities under the target and the proposal. ``independent``: share of independent moves.
    """

    def __init__(
        self,
        target: Callable[[np.ndarray, np.ndarray], np.ndarray],
        ensembles: Sequence[Ensemble],
        walkers: int,
        independent: float,
    ) -> None:
        from emcee.moves import DEMove

        self.target, self.ensembles, self.walkers, self.independent = target, list(ensembles), walkers, independent
        self.coords = np.stack([e.proposal.draw(walkers, e.random, spread=2.0) for e in ensembles])
        self.log_prob, self.log_q = self._log_density(self.coords), self._by_proposal(self.coords)
        self.turn, self.evolution, self.snooker = 0, DEMove(), Snooker()
        self.evolution.setup(self.coords[0])

    def keep(self, some: Sequence[int]) -> None:
        """Keep the ensembles with indices ``some``."""
        self.ensembles = [self.ensembles[i] for i in some]
        self.coords, self.log_prob, self.log_q = self.coords[some], self.log_prob[some], self.log_q[some]

    def run(self, steps: int) -> np.ndarray:
        """Make steps; return the path, (ensembles, steps, walkers, size)."""
        jumps = self._jumps(self._so_far(self.turn + steps) - self._so_far(self.turn))
        path = np.empty((len(self.ensembles), steps, *self.coords.shape[1:]))
        for i in range(steps):
            independent = self._so_far(self.turn)
            if self._so_far(self.turn + 1) > independent:
                self._jump(*next(jumps))
            else:
                snooker = (self.turn - independent) % SNOOKER_EVERY == SNOOKER_EVERY // 2
                self._evolve(self.snooker if snooker else self.evolution)
            self.turn += 1
            path[:, i] = self.coords
        return path

    def _so_far(self, turn: int) -> int:
        """Return the number of independent moves before a turn."""
        return int(self.independent * turn + 1e-9)

    def _jumps(self, moves: int) -> Any:
        """Draw and evaluate independent proposals; iterate over arrays (ensembles, walkers, ...) of each move."""
        shape = (len(self.ensembles), moves, self.walkers)
        new = np.stack([e.proposal.draw(moves * self.walkers, e.random) for e in self.ensembles])
        log_u = np.stack([np.log(e.random.random_sample(shape[1:])) for e in self.ensembles])
        numbers = [part.reshape(shape) for part in (self._by_proposal(new), self._log_density(new), log_u)]
        parts: list[np.ndarray] = [new.reshape(*shape, new.shape[-1]), *numbers]
        return zip(*(np.moveaxis(part, 1, 0) for part in parts), strict=True)

    def _jump(self, new: np.ndarray, new_q: np.ndarray, new_prob: np.ndarray, log_u: np.ndarray) -> None:
        """Make an independent Metropolis-Hastings move."""
        with np.errstate(invalid="ignore"):
            accepted = new_prob - self.log_prob + self.log_q - new_q > log_u
        self.coords = np.where(accepted[..., None], new, self.coords)
        self.log_q, self.log_prob = np.where(accepted, new_q, self.log_q), np.where(accepted, new_prob, self.log_prob)

    def _evolve(self, move: Any) -> None:
        """Make a move with emcee's interface, which proposes moves of one part of an ensemble from the others."""
        splits, walkers = move.nsplits, self.walkers
        part_of = np.stack([e.random.permutation(np.arange(walkers) % splits) for e in self.ensembles])
        members = [np.stack([np.flatnonzero(parts == j) for parts in part_of]) for j in range(splits)]
        rows = np.arange(len(self.ensembles))[:, None]
        coords, log_prob = self.coords.copy(), self.log_prob.copy()
        for j, moving in enumerate(members):
            others = [coords[rows, part] for i, part in enumerate(members) if i != j]
            proposals = [
                move.get_proposal(coords[i, moving[i]], [part[i] for part in others], e.random)
                for i, e in enumerate(self.ensembles)
            ]
            log_u = np.log(np.stack([e.random.random_sample(moving.shape[1]) for e in self.ensembles]))
            new, factors = (np.stack(parts) for parts in zip(*proposals, strict=True))
            new_prob = self._log_density(new)
            with np.errstate(invalid="ignore"):
                taken = factors + new_prob - log_prob[rows, moving] > log_u
            coords[rows, moving] = np.where(taken[..., None], new, coords[rows, moving])
            log_prob[rows, moving] = np.where(taken, new_prob, log_prob[rows, moving])
        self.coords, self.log_prob, self.log_q = coords, log_prob, self._by_proposal(coords)

    def _log_density(self, phi: np.ndarray) -> np.ndarray:
        """Evaluate the target's log-density, (ensembles, n), at phi (ensembles, n, size)."""
        which = np.repeat([e.problem for e in self.ensembles], phi.shape[1])
        return self.target(phi.reshape(-1, phi.shape[-1]), which).reshape(phi.shape[:2])

    def _by_proposal(self, phi: np.ndarray) -> np.ndarray:
        """Evaluate the log-density of each ensemble's proposal, (ensembles, n)."""
        return np.stack([e.proposal.log_density(x) for e, x in zip(self.ensembles, phi, strict=True)])
