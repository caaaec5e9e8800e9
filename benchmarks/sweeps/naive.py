"""The same empty cells as a plain Hydra application: a job a cell, in this process, with Hydra's basic launcher."""

from __future__ import annotations

import json
from typing import Any

import hydra
import numpy as np

from bench.config.config import Config, register_methods
from bench.entrants.registry import make_method
from bench.scenario.scenario import PriorSpec, Scenario
from bench.scoring.combination import combine_with_prior
from bench.scoring.score import score


@hydra.main(config_path="../../conf", config_name="config", version_base="1.3")
def main(config: Any) -> None:
    """Make the data, identify, score, and write one file."""
    from omegaconf import OmegaConf

    content = OmegaConf.to_container(config, resolve=True)
    assert isinstance(content, dict)
    cell = Config.model_validate(content)
    folder = cell.store
    system = cell.system
    prior = PriorSpec("nominal", {str(kind): sd for kind, sd in (cell.prior.sd_by_kind or {}).items()})
    start = (tuple(system.initial.displacement), tuple(system.initial.velocity))
    scenario = Scenario(system.kind, system.parameters, start, cell.snr, prior=prior, label=system.label)
    problem, truth = scenario.replicates(cell.seed, 1)[0]
    estimate = make_method("empty", {}).identify(problem, np.random.default_rng(cell.seed))
    scores = score(combine_with_prior(estimate, problem.prior), problem, truth)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{cell.seed}.json").write_text(json.dumps(scores))


if __name__ == "__main__":
    register_methods()
    main()
