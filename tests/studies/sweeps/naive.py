"""The same empty cells as a plain Hydra application: a job a cell, in this process, with Hydra's basic launcher."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import hydra
import numpy as np

from bench.config.schema import scenario_from
from bench.config.sources import register_plugins
from bench.entrants.registry import make_method
from bench.scoring.combination import combine_with_prior
from bench.scoring.score import score


@hydra.main(config_path="../../../conf", config_name="config", version_base="1.3")
def main(config: Any) -> None:
    """Make the data, identify, score, and write one file."""
    from omegaconf import OmegaConf

    content: Any = OmegaConf.to_container(config, resolve=True)
    seed, folder = content["seed"], Path(content["store"])
    problem, truth = scenario_from(content).replicates(seed, 1)[0]
    estimate = make_method("empty", {}).identify(problem, np.random.default_rng(seed))
    scores = score(combine_with_prior(estimate, problem.prior), problem, truth)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{seed}.json").write_text(json.dumps(scores))


if __name__ == "__main__":
    register_plugins()
    main()
