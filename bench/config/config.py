"""The names that other rooms import of the configuration until they use its objects: experiment, overrides, schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.config.choices import choices
from bench.config.experiment import Experiment, _product, expand
from bench.config.schema import Job
from bench.store.cell import Cell

__all__ = ["choices", "expand", "jobs_to_cells"]


def jobs_to_cells(jobs: Sequence[Job]) -> list[Cell]:
    """The cells of all jobs; raises InputError for the first that does not make sense, before any runs."""
    return [job.cell() for job in jobs]


def _experiment(name: str | None) -> Mapping[str, Any]:
    return {} if name is None else Experiment(name).content


def _expand_sweep(
    sweep: Mapping[str, list[Any]], experiment: Mapping[str, Any], explicit: frozenset[str], multirun: bool
) -> list[Job]:
    return _product(sweep, experiment, explicit)
