"""Hydra's ``hydra/launcher=local``: the sweep's cells on this machine, a process a cell, with progress.

Every Hydra application of the environment imports this file, so it imports nothing but Hydra until it launches. (No
postponed annotations: Hydra reads the types of the configuration.)
"""

from dataclasses import dataclass
from typing import Any, Optional, Sequence  # noqa: UP035

from hydra.core.config_store import ConfigStore
from hydra.core.utils import JobReturn, configure_log, filter_overrides, run_job
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict


@dataclass
class LocalLauncherConfig:
    """``progress``: whether a bar over the fits is shown."""

    _target_: str = "hydra_plugins.vibration_bench.local_launcher.LocalLauncher"
    progress: bool = True


ConfigStore.instance().store(group="hydra/launcher", name="local", node=LocalLauncherConfig, provider="vibration-bench")


class LocalLauncher(Launcher):
    """Runs its jobs one after the other, since a job's cells share the machine's cores among themselves."""

    def __init__(self, progress: bool) -> None:
        self.progress = progress
        self.config: Optional[DictConfig] = None  # noqa: UP045

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self.hydra_context, self.task_function, self.config = hydra_context, task_function, config

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        assert self.config is not None
        configure_log(self.config.hydra.hydra_logging, self.config.hydra.verbose)
        done = []
        for index, overrides in enumerate(job_overrides, initial_job_idx):
            config = self.hydra_context.config_loader.load_sweep_config(self.config, list(overrides))
            with open_dict(config):
                config.hydra.job.id = config.hydra.job.num = index
                config.hydra.job.override_dirname = ",".join(filter_overrides(overrides))
            done.append(self._run(config))
        return done

    def _run(self, config: Any) -> JobReturn:
        return run_job(
            hydra_context=self.hydra_context,
            task_function=self.task_function,
            config=config,
            job_dir_key="hydra.sweep.dir",
            job_subdir_key="hydra.sweep.subdir",
        )
