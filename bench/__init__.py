"""The harness: problems, bounds, scores, tables.

These names are the contract that methods import, and it loads none of them. ``run``, ``identify`` and ``experiment``
are the benchmark from Python; they are loaded when they are asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bench.contract.estimate import Belief, Cost, Draws, Estimate, Marginal, Normal, Reconstruction, Status
from bench.contract.method import Card, Identifier, Serves
from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record, Units
from bench.contract.progress import report_progress
from bench.dynamics.mechanics import acceleration, mass_matrix, numpy_ops, regression_columns, rk4_step, state_rate
from bench.dynamics.simulate import SimulatedResponse, fitted_start, measurements, simulate, state_matrix
from bench.errors import InputError
from bench.systems import Components, Dimension, Ops, Parameter, Quantity, System

if TYPE_CHECKING:
    from bench.face.identification import Identification, identify
    from bench.face.results import Results, experiment, run

__all__ = [
    "Belief",
    "Card",
    "Channel",
    "Components",
    "Cost",
    "Dimension",
    "Draws",
    "Estimate",
    "Force",
    "Identification",
    "Identifier",
    "InitialState",
    "InputError",
    "Marginal",
    "Normal",
    "Ops",
    "Parameter",
    "Prior",
    "Problem",
    "Quantity",
    "Reconstruction",
    "Record",
    "Results",
    "Serves",
    "SimulatedResponse",
    "Status",
    "System",
    "Units",
    "acceleration",
    "experiment",
    "fitted_start",
    "identify",
    "mass_matrix",
    "measurements",
    "numpy_ops",
    "regression_columns",
    "report_progress",
    "rk4_step",
    "run",
    "simulate",
    "state_matrix",
    "state_rate",
]
__version__ = "0.1.0"
__path__ = [
    *__path__,
    *(f"{folder}/commands" for folder in __path__),
]  # python -m bench.tables is bench/commands/tables.py

FACE = {
    "Identification": "identification",
    "identify": "identification",
    "Results": "results",
    "experiment": "results",
    "run": "results",
}
"""What is loaded when it is asked for, by its module in ``bench.face``."""


def __getattr__(name: str) -> Any:
    if name in FACE:
        return getattr(import_module(f"bench.face.{FACE[name]}"), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")
