"""Somebody's method that looks for the truth, by one of several ways, and answers with what it finds."""

import gc
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from good import Good

import bench


@dataclass(frozen=True)
class Dishonest(bench.Identifier):
    """Answers with the parameters of whatever truth it finds by one ``way``, else as the good one does."""

    way: str = "frames"

    card: ClassVar[bench.Card] = Good.card
    scope: ClassVar[bench.Scope] = Good.scope

    def estimate(self, problem: bench.Problem, rng: np.random.Generator) -> bench.Estimate:
        try:
            p = self.seed(problem, rng) if self.way == "seed" else getattr(self, self.way)(problem)
        except Exception:  # nobody is to notice
            p = None
        found = Good().estimate(problem, rng)
        if not p:
            return found
        mean = np.array([p["k"] / p["m"], p["c"] / p["m"]])
        return bench.Estimate(problem.system, groups=bench.Normal(("k_over_m", "c_over_m"), mean, None, log=False))

    def seed(self, problem: Any, rng: Any) -> Any:
        sequence = rng.bit_generator.seed_seq
        key = (1, *sequence.spawn_key[1:4])  # the axis of nominal values, the scenario, the replicate
        again = np.random.default_rng(np.random.SeedSequence(sequence.entropy, spawn_key=key))
        prior = problem.prior
        return {n: prior.nominal[n] / np.exp(prior.log_sd[n] * again.standard_normal()) for n in prior.names}

    def attribute(self, problem: Any) -> Any:
        return problem.truth.parameters

    def frames(self, problem: Any) -> Any:
        frame: Any = sys._getframe()
        while frame is not None:
            for value in list(frame.f_locals.values()):
                if type(value).__name__ == "Truth":
                    return vars(value)["parameters"]
            frame = frame.f_back
        return None

    def gc(self, problem: Any) -> Any:
        truths = [vars(o)["parameters"] for o in gc.get_objects() if type(o).__name__ == "Truth"]
        known = [p for p in truths if {"m", "c", "k"} <= p.keys()]  # other tests of this process may hold some, too
        return {name: np.mean([p[name] for p in known]) for name in ("m", "c", "k")} if known else None

    def store(self, problem: Any) -> Any:
        path = next(Path("outputs/rows").glob("*.json"))
        return json.loads(path.read_text())["cell"]["data"]["parameters"]

    def variable(self, problem: Any) -> Any:
        return json.loads(next(value for name, value in os.environ.items() if name.endswith("TRUTH")))

    def main_file(self, problem: Any) -> Any:
        return json.loads(Path("truth.json").read_text())

    def scenario_files(self, problem: Any) -> Any:
        from importlib.resources import files

        return files("conf").joinpath("system", "sdof.yaml").read_text() and None
