"""Somebody's method with a fault for each check; ``fault`` chooses one."""

import copy
import logging
import os
import pickle
import threading
import time
import warnings
from collections import namedtuple
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from good import Good

import bench
from bench import Estimate, Normal, Problem


@dataclass(frozen=True)
class Sloppy(bench.Identifier):
    """As the good one, but for one fault."""

    fault: str = ""

    card: ClassVar[bench.Card] = Good.card
    scope: ClassVar[bench.Scope] = Good.scope
    last: ClassVar[list[np.ndarray]] = []

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        return self.faulty(problem, self.found(problem, rng))

    def found(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """The good answer, where the fault lets it."""
        channel = problem.records[0].channels[0]
        if self.fault == "hangs":
            time.sleep(600.0)
        while self.fault == "floods":
            print("x" * 2**20)
        if self.fault == "raises_bytes":
            raise RuntimeError("\udcff" * 2**16)
        if self.fault == "changes_the_input":
            channel.values.setflags(write=True)
            channel.values[0] = 0.5 * channel.values[0]
        if self.fault == "dies" or (self.fault == "dies_on_few" and channel.n < 6):
            os._exit(3)
        if channel.n < 6:
            if self.fault == "raises_on_few":
                raise IndexError("index 5 is out of bounds")
            if self.fault == "says_nothing":
                raise bench.NoEstimate("failed")
        return Good().estimate(self.copied(problem) if self.fault == "only_copies" else problem, rng)

    @staticmethod
    def copied(problem: Problem) -> Problem:
        """The problem by way of a copy and a pickle, as who fits in other processes sends it."""
        return pickle.loads(pickle.dumps(copy.deepcopy(problem)))  # type: ignore[no-any-return]

    def faulty(self, problem: Problem, found: Estimate) -> Estimate:
        """An answer with the fault in it."""
        channel, fault = problem.records[0].channels[0], self.fault
        assert found.groups is not None
        mean = found.groups.mean
        if fault == "global_stream":
            return self.said(problem, mean * (1 + 0.01 * np.random.standard_normal()))  # noqa: NPY002
        if fault == "no_seed":
            return self.said(problem, mean * (1 + 0.01 * np.random.default_rng().standard_normal()))
        if fault == "starts_from_the_last":
            before = self.last[-1] if self.last else mean
            self.last.append(mean)
            return self.said(problem, 0.99 * mean + 0.01 * before)
        if fault == "order_of_a_set":
            return self.said(problem, mean * (1 + 1e-8 * (hash("another in each process") % 10**7)))
        if fault == "metres_only":
            return self.said(problem, mean * (1 + 0.01 * float(np.max(channel.values))))
        if fault == "seconds_only":
            return self.said(problem, mean + 1e-2)
        if fault == "nan_on_few" and channel.n < 6:
            return self.said(problem, np.full(2, np.nan))
        if fault == "lambda":
            return Estimate(problem.system, groups=found.groups, reconstructions=(lambda t: np.zeros((1, t.size)),))
        if fault == "states_a_mass":
            logs = np.log([1.4, 1.4 * mean[1], 1.4 * mean[0]])
            return Estimate(problem.system, parameters=Normal(("m", "c", "k"), logs, None, log=True))
        if fault == "misshapen":
            return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, np.eye(3), log=False))
        if fault == "foreign_names":
            return Estimate(problem.system, groups=Normal(("stiffness", "c_over_m"), mean, None, log=False))
        if fault == "only_talks":  # what libraries do looks at frames, too: no fault
            logging.getLogger("sloppy").warning("a line with the place that it was written at")
            warnings.warn("a warning with its place", stacklevel=2)
            namedtuple("Pair", "a b")(1, 2)
            dataclass(type("Made", (), {"__annotations__": {"a": int}}))
            return found
        if fault == "goes_on":
            threading.Thread(target=time.sleep, args=(20.0,), daemon=True, name="goes on").start()
        return found

    def said(self, problem: Problem, mean: np.ndarray) -> Estimate:
        """An estimate of these groups."""
        return Estimate(problem.system, groups=Normal(("k_over_m", "c_over_m"), mean, None, log=False))

    def estimate_many(self, problems: Any, rngs: Any) -> list[Estimate]:
        found = super().estimate_many(problems, rngs)
        if self.fault == "looks_at_its_neighbours" and len(found) > 1:
            means = np.mean([one.groups.mean for one in found if one.groups is not None], axis=0)
            return [self.said(problem, means) for problem in problems]
        return found
