"""emcee ensembles that step together: one call of the target serves the walkers of all.

Every step, all ensembles take the same kind of move, by a fixed turn: that keeps the posterior as a random choice does.
Independent proposals do not depend on where the walkers are, so those of a whole run of steps are drawn, and their
log-densities found, at its beginning. Each ensemble draws from its own random numbers alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from methods.sampling.posterior import Target
from methods.sampling.proposal import Proposal

SNOOKER = 5
"""Of the moves that are not independent, every so-manieth is a snooker move, the others differential evolution."""
REACH = 1.7
"""Of a snooker move, as recommended there."""


@dataclass(eq=False)
class Ensemble:
    """The posterior of one ensemble by its number in the target, its proposal and its random numbers."""

    problem: int
    proposal: Proposal
    random: Any


class Snooker:
    """The snooker move, split and asked as emcee's moves are (C. ter Braak, J. Vrugt, Stat. Comput. 18:435, 2008).

    A walker moves on the line through it and another one, z, by ``REACH`` times what the difference of two more is
    along that line; equation 4 there is the factor ``(|new - z| / |old - z|)^(d - 1)`` of its acceptance. emcee's own
    takes the root of the distance to z for the distance, which does not leave the density as it is.
    """

    nsplits = 4

    def get_proposal(self, s: np.ndarray, c: Sequence[np.ndarray], random: Any) -> tuple[np.ndarray, np.ndarray]:
        """New places of walkers s (n, size) from three other parts of the ensemble, and logarithms of the factors."""
        n, size = s.shape
        drawn = np.stack([part[random.randint(len(part), size=n)] for part in c])
        order = np.argsort(random.random_sample((n, 3)), axis=1)
        z, one, two = (drawn[order[:, i], np.arange(n)] for i in range(3))
        length = np.linalg.norm(s - z, axis=1)
        along = (s - z) / length[:, None]
        new = s + REACH * np.sum(along * (one - two), axis=1)[:, None] * along
        return new, (size - 1.0) * np.log(np.linalg.norm(new - z, axis=1) / length)


class Lockstep:
    """Ensembles of equally many walkers, from overdispersed starts; :meth:`run` takes more steps.

    To emcee they are one sampler, of all walkers, with one move: :meth:`propose`. ``coords`` (ensembles, walkers,
    size), ``log_prob`` and ``log_q``, by the proposal, (ensembles, walkers): of where the walkers are.
    """

    def __init__(self, target: Target, ensembles: Sequence[Ensemble], walkers: int, independent: float) -> None:
        self.target, self.ensembles, self.walkers, self.independent = target, list(ensembles), walkers, independent
        self.coords = np.stack([own.proposal.draw(walkers, own.random, spread=2.0) for own in ensembles])
        self.log_prob = self._log_density(self.coords)
        self.log_q = self._by_proposal(self.coords)
        self.turn = 0

    def keep(self, some: Sequence[int]) -> None:
        """Go on with some of the ensembles only."""
        self.ensembles = [self.ensembles[i] for i in some]
        self.coords, self.log_prob, self.log_q = self.coords[some], self.log_prob[some], self.log_q[some]

    def run(self, steps: int) -> np.ndarray:
        """Take steps; the path is of shape (ensembles, steps, walkers, size)."""
        import emcee

        n, size = len(self.ensembles) * self.walkers, self.coords.shape[-1]
        self._prepare(steps)
        sampler = emcee.EnsembleSampler(n, size, _never, moves=[self])
        state = emcee.State(self.coords.reshape(n, size), log_prob=self.log_prob.reshape(n))
        sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        path = sampler.get_chain().reshape(steps, len(self.ensembles), self.walkers, size)
        return np.asarray(np.moveaxis(path, 0, 1))

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """Move all walkers once, as emcee asks a move to."""
        if self._independent(self.turn):
            accepted = self._jump()
        else:
            others = self.turn - self._so_far(self.turn)
            accepted = self._evolve(self.snooker if others % SNOOKER == SNOOKER // 2 else self.evolution)
        self.turn += 1
        state.coords, state.log_prob = self.coords.reshape(state.coords.shape), self.log_prob.ravel()
        return state, accepted.ravel()

    # ------------------------------------------------------------------------------------------------- the two kinds

    def _so_far(self, turn: int) -> int:
        """Independent moves before a turn."""
        return int(self.independent * turn + 1e-9)

    def _independent(self, turn: int) -> bool:
        return self._so_far(turn + 1) > self._so_far(turn)

    def _prepare(self, steps: int) -> None:
        """Draw and judge the independent proposals of some steps: arrays (moves, ensembles, walkers, ...)."""
        from emcee.moves import DEMove

        self.evolution, self.snooker = DEMove(), Snooker()
        self.evolution.setup(self.coords[0])
        moves, walkers = self._so_far(self.turn + steps) - self._so_far(self.turn), self.walkers
        drawn = [own.proposal.draw(moves * walkers, own.random) for own in self.ensembles]
        log_u = [np.log(own.random.random_sample((moves, walkers))) for own in self.ensembles]
        shape = (len(drawn), moves, walkers)
        new = np.stack(drawn)
        self._log_u = np.stack(log_u, axis=1)
        self._new = np.moveaxis(new.reshape(*shape, self.coords.shape[-1]), 1, 0)
        self._new_q = np.moveaxis(self._by_proposal(new).reshape(shape), 1, 0)
        self._new_prob = np.moveaxis(self._log_density(new).reshape(shape), 1, 0)
        self._next = 0

    def _jump(self) -> np.ndarray:
        """An independent Metropolis-Hastings move; returns who moved."""
        new, new_q, new_prob = (part[self._next] for part in (self._new, self._new_q, self._new_prob))
        with np.errstate(invalid="ignore"):
            accepted = new_prob - self.log_prob + self.log_q - new_q > self._log_u[self._next]
        self.coords = np.where(accepted[..., None], new, self.coords)
        self.log_q, self.log_prob = np.where(accepted, new_q, self.log_q), np.where(accepted, new_prob, self.log_prob)
        self._next += 1
        return accepted

    def _evolve(self, move: Any) -> np.ndarray:
        """A move of emcee's that splits an ensemble, and proposes to one part from the others; returns who moved."""
        splits, walkers = move.nsplits, self.walkers
        part_of = np.stack([own.random.permutation(np.arange(walkers) % splits) for own in self.ensembles])
        members = [np.stack([np.flatnonzero(own == j) for own in part_of]) for j in range(splits)]
        rows = np.arange(len(self.ensembles))[:, None]
        coords, log_prob, accepted = self.coords.copy(), self.log_prob.copy(), np.zeros_like(part_of, bool)
        for j, mine in enumerate(members):
            others = [coords[rows, theirs] for i, theirs in enumerate(members) if i != j]
            asked = [
                move.get_proposal(coords[i, mine[i]], [part[i] for part in others], own.random)
                for i, own in enumerate(self.ensembles)
            ]
            log_u = np.log(np.stack([own.random.random_sample(mine.shape[1]) for own in self.ensembles]))
            new, factors = np.stack([q for q, _ in asked]), np.stack([factor for _, factor in asked])
            new_prob = self._log_density(new)
            with np.errstate(invalid="ignore"):
                taken = factors + new_prob - log_prob[rows, mine] > log_u
            coords[rows, mine] = np.where(taken[..., None], new, coords[rows, mine])
            log_prob[rows, mine] = np.where(taken, new_prob, log_prob[rows, mine])
            accepted[rows, mine] = taken
        self.coords, self.log_prob, self.log_q = coords, log_prob, self._by_proposal(coords)
        return accepted

    # ------------------------------------------------------------------------------------------------- log-densities

    def _log_density(self, phi: np.ndarray) -> np.ndarray:
        """By the target, shape (ensembles, n), of phi (ensembles, n, size)."""
        which = np.repeat([own.problem for own in self.ensembles], phi.shape[1])
        return self.target(which, phi.reshape(-1, phi.shape[-1])).reshape(phi.shape[:2])

    def _by_proposal(self, phi: np.ndarray) -> np.ndarray:
        """By each ensemble's proposal, likewise."""
        return np.stack([own.proposal.log_density(x) for own, x in zip(self.ensembles, phi, strict=True)])


def _never(phi: np.ndarray) -> float:
    raise AssertionError("the moves find the log-densities themselves")
