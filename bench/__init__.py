"""Benchmark of methods that identify mass, damping and stiffness of vibrating systems from noisy samples.

The names below are the interface for methods and systems, which the benchmark does not import itself. ``run``,
``identify`` and ``experiment`` run the benchmark from Python; they are imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bench.isolation import signals as _  # noqa: F401 - first, so that Ctrl-C is handled during the other imports

# isort: split
from bench.contract.distribution import Distribution, Draws, Marginal, Normal
from bench.contract.estimate import Cost, Estimate, NoEstimate, Reconstruction, Status
from bench.contract.method import EVERY_PROBLEM, Card, Choice, Identifier, Scope
from bench.contract.modal import (
    Blows,
    FreeDecays,
    FrequencyResponses,
    ModalCard,
    ModalEstimate,
    ModalIdentifier,
    ModalProblem,
    Mode,
)
from bench.contract.online import (
    Layout,
    OnlineCard,
    OnlineIdentifier,
    Sample,
    SampleStatus,
    Sensor,
    Tracker,
    TrackerOutput,
)
from bench.contract.prior import Prior, dimension_scale
from bench.contract.problem import Channel, Force, InitialState, Problem, Record, Units
from bench.contract.progress import report_progress
from bench.contract.window import WindowTracker
from bench.contract.zero import remove_jumps
from bench.dynamics.discrete_model import DiscreteModel
from bench.dynamics.intervals import Steps, interval_polynomials, step_counts
from bench.dynamics.mechanics import acceleration, mass_matrix, regression_columns, state_matrix, state_rate
from bench.dynamics.ops import array_ops, numpy_ops, ops_from
from bench.dynamics.rates import fastest_rates
from bench.dynamics.simulate import SimulatedMotion, SimulatedResponse, fit_initial_state, measurements, simulate
from bench.dynamics.stepper import compiled_path, rk4, rk4_path, rk4_scan, rk4_step
from bench.entry_points import entry_points_of, load_entry_point
from bench.errors import InputError, check_name
from bench.likelihood.autoregression import autoregression, whiten_model
from bench.likelihood.batching import batches, layout
from bench.likelihood.least_squares import (
    FIRST_DAMPING,
    Linearisation,
    Minimum,
    StepLimits,
    covariances,
    degrees_used,
    minimise,
)
from bench.likelihood.output_error import LOG_LIMIT, SIGMA_FLOOR, InitialValues, OutputError, SimulatedData, estimate_at
from bench.systems import Components, Dimension, Ops, Parameter, Quantity, System
from bench.systems.linear import SDOF

if TYPE_CHECKING:
    from bench.face.identification import Identification, identify
    from bench.face.results import Results, experiment, run

__all__ = [
    "EVERY_PROBLEM",
    "FIRST_DAMPING",
    "LOG_LIMIT",
    "SDOF",
    "SIGMA_FLOOR",
    "Blows",
    "Card",
    "Channel",
    "Choice",
    "Components",
    "Cost",
    "Dimension",
    "DiscreteModel",
    "Distribution",
    "Draws",
    "Estimate",
    "Force",
    "FreeDecays",
    "FrequencyResponses",
    "Identification",
    "Identifier",
    "InitialState",
    "InitialValues",
    "InputError",
    "Layout",
    "Linearisation",
    "Marginal",
    "Minimum",
    "ModalCard",
    "ModalEstimate",
    "ModalIdentifier",
    "ModalProblem",
    "Mode",
    "NoEstimate",
    "Normal",
    "OnlineCard",
    "OnlineIdentifier",
    "Ops",
    "OutputError",
    "Parameter",
    "Prior",
    "Problem",
    "Quantity",
    "Reconstruction",
    "Record",
    "Results",
    "Sample",
    "SampleStatus",
    "Scope",
    "Sensor",
    "SimulatedData",
    "SimulatedMotion",
    "SimulatedResponse",
    "Status",
    "StepLimits",
    "Steps",
    "System",
    "Tracker",
    "TrackerOutput",
    "Units",
    "WindowTracker",
    "acceleration",
    "array_ops",
    "autoregression",
    "batches",
    "check_name",
    "compiled_path",
    "covariances",
    "degrees_used",
    "dimension_scale",
    "entry_points_of",
    "estimate_at",
    "experiment",
    "fastest_rates",
    "fit_initial_state",
    "identify",
    "interval_polynomials",
    "layout",
    "load_entry_point",
    "mass_matrix",
    "measurements",
    "minimise",
    "numpy_ops",
    "ops_from",
    "regression_columns",
    "remove_jumps",
    "report_progress",
    "rk4",
    "rk4_path",
    "rk4_scan",
    "rk4_step",
    "run",
    "simulate",
    "state_matrix",
    "state_rate",
    "step_counts",
    "whiten_model",
]
__version__ = "0.2.0"

FACE = {
    "Identification": "identification",
    "identify": "identification",
    "Results": "results",
    "experiment": "results",
    "run": "results",
}
"""Names imported on first use, by module in ``bench.face``."""


def __getattr__(name: str) -> Any:
    if name in FACE:
        return getattr(import_module(f"bench.face.{FACE[name]}"), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")
