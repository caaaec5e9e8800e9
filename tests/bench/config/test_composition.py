"""What a cell is computed from is what Hydra composes in place, and shows by ``--cfg job``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from bench.config.choices import choices
from bench.config.experiment import expand
from bench.config.inspection import hydra_overrides, register_plugins
from bench.config.overrides import read_overrides

ALL = [f"{group}={name}" for group in ("system", "prior", "disturbance") for name in choices(group)]
VARIANTS = ["method=ls", "method=oracle", "method=ls_spline", "method=collocation_bootstrap"]
FIELDS = [
    "system.parameters={m:1,c:0.5,k:9}", "system.parameters.k=9 system.samples=50", "system=open_007 system.samples=33",
    "method=pinn_adam method.adam_steps=7", "prior.draws=truth", "disturbance=jitter ++disturbance.size=0.1", "~prior",
    "snr=7 seed=3 workers=2 store=elsewhere", "system=dev_small", "+experiment=sbc", "method=pinn_adam ~method.slack",
]  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _hydra() -> Iterator[None]:
    register_plugins()
    GlobalHydra.instance().clear()
    with initialize_config_module("conf", version_base="1.3", job_name="bench"):
        yield


@pytest.mark.parametrize("line", [*ALL, *VARIANTS, *FIELDS])
def test_a_cell_is_computed_from_what_hydra_composes(line: str) -> None:
    """In the same order, too: a scenario's parameters stand in it as they are written."""
    texts = line.split()
    if "method=" not in line:
        texts = ["method=ls", *texts]
    shown: Any = OmegaConf.to_container(compose("config", hydra_overrides(read_overrides(texts))), resolve=True)
    (config,) = {job.config.seed: job.config for job in expand(texts, multirun=True)[:1]}.values()
    for group in ("method", "system", "prior", "disturbance"):
        if "experiment" not in line or group in ("system", "disturbance"):
            assert json.dumps(getattr(config, group)) == json.dumps(shown[group])
    for name in ("snr", "seed", "workers", "replicates"):
        assert getattr(config, name) == shown[name]
