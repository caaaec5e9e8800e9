"""The harness: problems, bounds, scores, tables. This face is the contract that methods import; it loads none."""

from bench.contract.estimate import Belief, Cost, Draws, Estimate, Marginal, NoEstimate, Normal, Reconstruction, Status
from bench.contract.method import Card, Identifier, Serves
from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record, Units
from bench.contract.progress import report_progress
from bench.dynamics.mechanics import acceleration, mass_matrix, numpy_ops, regression_columns, rk4_step, state_rate
from bench.dynamics.simulate import SimulatedResponse, fitted_start, measurements, simulate, state_matrix
from bench.errors import InputError
from bench.likelihood.output_error import LOG_LIMIT, SIGMA_FLOOR, OutputError, Search, Standardised, Start, estimate_at
from bench.systems import Components, Dimension, Ops, Parameter, Quantity, System

__all__ = [
    "LOG_LIMIT",
    "SIGMA_FLOOR",
    "Belief",
    "Card",
    "Channel",
    "Components",
    "Cost",
    "Dimension",
    "Draws",
    "Estimate",
    "Force",
    "Identifier",
    "InitialState",
    "InputError",
    "Marginal",
    "NoEstimate",
    "Normal",
    "Ops",
    "OutputError",
    "Parameter",
    "Prior",
    "Problem",
    "Quantity",
    "Reconstruction",
    "Record",
    "Search",
    "Serves",
    "SimulatedResponse",
    "Standardised",
    "Start",
    "Status",
    "System",
    "Units",
    "acceleration",
    "estimate_at",
    "fitted_start",
    "mass_matrix",
    "measurements",
    "numpy_ops",
    "regression_columns",
    "report_progress",
    "rk4_step",
    "simulate",
    "state_matrix",
    "state_rate",
]
__version__ = "0.1.0"
__path__ = [
    *__path__,
    *(f"{folder}/commands" for folder in __path__),
]  # python -m bench.tables is bench/commands/tables.py
