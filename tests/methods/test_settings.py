"""Settings that make no sense: one line that names the setting, before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from bench import InputError
from bench.entrants.online import make_online
from bench.entrants.registry import load_method

FREE_DECAYS = ("ar", "ar_recursive", "iqml", "matrix_pencil", "era", "log_decrement", "ls", "rls")
METHODS: tuple[tuple[str, Mapping[str, Any]], ...] = (
    *((name, {"bootstrap": -1}) for name in FREE_DECAYS),
    *((name, {"forgetting": value}) for name in ("ar_recursive", "rls") for value in (0.0, 1.1)),
    *((name, {"diffuse": value}) for name in ("ar_recursive", "rls") for value in (0.0, math.inf)),
    ("iqml", {"rounds": 0}), ("srivc", {"rounds": 0}), ("matrix_pencil", {"pencil": 0.0}), ("era", {"rows": 1.0}),
    ("log_decrement", {"smallest": 1.5}), ("sindy", {"degree": 0}), ("sindy", {"most_terms": 0}),
    ("ekf", {"passes": 0}), ("ekf", {"drift": -1.0}), ("ukf", {"open_sd": 0.0}), ("ukf", {"tolerance": math.nan}),
    ("ukf", {"kappa": -1.0}), ("output_error", {"sigma_rounds": 0}),
    *(("nuts", {name: 0}) for name in ("chains", "warmup", "draws", "blocks")),
    ("pinn", {"batch": 0}), ("pinn", {"slack": -1.0}), ("pinn", {"width": 1}), ("pinn", {"adam_rate": math.nan}),
    ("collocation", {"members": 1}), ("collocation", {"degree": 2}),
    ("pinn_family", {"budget": 0.0}), ("pinn_family", {"rate": -1.0}), ("pinn_family", {"batch": 2}),
    ("pinn_family", {"weighting": "causal", "optimizer": "variable_projection"}),
    *((f"rival_{name}", {"seconds": math.nan}) for name in ("deepxde", "jinns", "pina")),
    *((f"rival_{name}", {"adam_steps": -1}) for name in ("deepxde", "jinns", "pina")),
)  # fmt: skip
TRACKERS: tuple[tuple[str, Mapping[str, Any]], ...] = (
    ("ar", {"factor": 0.2}), ("ar", {"warm_up": 3}), ("ssi", {"length": 20}), ("ssi", {"every": 0}),
    ("pinn", {"length": 5}), ("pinn", {"every": 0}), ("cusum", {"support": 0}), ("glr", {"threshold": -1.0}),
    ("change_points", {"hazard": 1.0}), ("change_points", {"members": 3}), ("rls", {"span": 7}),
    ("rls", {"forgetting": "all"}), ("imm", {"settles": 0.0}), ("ekf", {"warm_up": 19}),
)  # fmt: skip


@pytest.mark.parametrize(("name", "settings"), METHODS)
def test_a_setting_out_of_range_is_refused(name: str, settings: Mapping[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(settings))):
        load_method(name)(**settings)


@pytest.mark.parametrize(("name", "settings"), TRACKERS)
def test_a_setting_of_a_tracker_out_of_range_is_refused(name: str, settings: Mapping[str, Any]) -> None:
    with pytest.raises(InputError, match=f"method.{next(iter(settings))}"):
        make_online(name, settings)
