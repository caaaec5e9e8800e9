"""The harness: problems, bounds, scores, tables. This face is the contract that methods import; it loads none."""

from bench.contract.estimate import Belief, Cost, Draws, Estimate, Marginal, NoEstimate, Normal, Reconstruction, Status
from bench.contract.method import Card, Identifier, Serves
from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record, Units
from bench.contract.progress import report_progress
from bench.dynamics.fixed_step import Steps, rk4_path, rk4_scan, rk4_step, step_counts
from bench.dynamics.intervals import interval_polynomials
from bench.dynamics.mechanics import acceleration, mass_matrix, regression_columns, state_matrix, state_rate
from bench.dynamics.ops import array_ops, nan_ops, numpy_ops, ops_from
from bench.dynamics.rates import fastest_rates
from bench.dynamics.simulate import SimulatedResponse, fitted_start, measurements, simulate
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
    "Steps",
    "System",
    "Units",
    "acceleration",
    "array_ops",
    "estimate_at",
    "fastest_rates",
    "fitted_start",
    "interval_polynomials",
    "mass_matrix",
    "measurements",
    "nan_ops",
    "numpy_ops",
    "ops_from",
    "regression_columns",
    "report_progress",
    "rk4_path",
    "rk4_scan",
    "rk4_step",
    "simulate",
    "state_matrix",
    "state_rate",
    "step_counts",
]
__version__ = "0.1.0"
__path__ = [
    *__path__,
    *(f"{folder}/commands" for folder in __path__),
]  # python -m bench.tables is bench/commands/tables.py
