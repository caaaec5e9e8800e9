"""Requirements on systems, of this project and of others: the equation agrees with its declaration."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from typing import Any, get_args

import numpy as np

from bench.conformance.check import Checks, Refusal
from bench.conformance.imports import HARNESS, check_imports
from bench.contract.problem import InitialState, Units
from bench.dynamics.mechanics import mass_matrix
from bench.dynamics.ops import array_ops, float_ops, numpy_ops, sympy_ops
from bench.dynamics.simulate import simulate
from bench.errors import InputError
from bench.information.structural import readable, structure_of
from bench.scenario.scenario import Scenario
from bench.scenario.truth import integrated_response
from bench.systems import FORCE, MEASURED, Kind, Ops, System

SYSTEM_CHECKS = Checks()
NEAR = 1e-9
"""Largest difference due to rounding, relative to the largest number of the same row."""
SAME_PATH = 1e-5
"""Largest difference of paths, over the largest displacement, between a fixed step and a tight tolerance."""
OTHER_UNITS = Units(mass=3.0, length=5.0, time=7.0)
ALLOWED = ("bench", "bench.systems")
POINTS = 5
TYPICAL: Mapping[Kind, float] = {"mass": 1.0, "damping": 0.2, "stiffness": 8.0, "other": 0.5}
"""Typical parameters of each kind (SI units)."""
Motion = Sequence[Any]
"""Displacement, velocity, acceleration, force and hidden states: arrays (n, POINTS), or sequences of n numbers."""


@dataclass(frozen=True, eq=False)
class Specimen:
    """A system under check: its registered name and options, and the instance."""

    name: str
    options: Mapping[str, Any]
    system: System

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Typical parameters, different for each parameter of a kind."""
        return {p.name: TYPICAL[p.kind] * 1.1**i for i, p in enumerate(self.system.parameters)}

    @property
    def motion(self) -> list[np.ndarray]:
        """Random motion at ``POINTS`` instants, the same at every access."""
        rng, n = np.random.default_rng(7), self.system.n_dof
        return [rng.standard_normal((size, POINTS)) for size in (n, n, n, n, self.system.n_hidden)]

    def rows(self, p: Mapping[str, Any], motion: Motion, ops: Ops = numpy_ops) -> list[Any]:
        """Return the residual and the rates of the hidden states; raises Refusal for a wrong number of them."""
        x, v, a, f, z = (list(part) for part in motion)
        residual = self.system.residual(p, x, v, a, f, z, ops)
        if not isinstance(residual, list | tuple) or len(residual) != self.system.n_dof:
            count = len(residual) if isinstance(residual, list | tuple) else f"a {type(residual).__name__}"
            raise Refusal(f"residual returned {count} for {self.system.n_dof} DOF")
        rates = self.system.hidden_rates(p, x, v, f, z, ops)
        if len(rates) != self.system.n_hidden:
            raise Refusal(f"hidden_rates returned {len(rates)} for n_hidden = {self.system.n_hidden}")
        return [*residual, *rates]

    def numbers(self, p: Mapping[str, Any], motion: Motion) -> np.ndarray:
        """Return :meth:`rows` as numpy computes them, shape (n_dof + n_hidden, POINTS)."""
        return np.array([np.broadcast_to(np.asarray(row, float), POINTS) for row in self.rows(p, motion)])


@SYSTEM_CHECKS.add("declaration", "list every parameter as bench.Parameter(name, unit, kind, dimension)")
def declaration(specimen: Specimen) -> str:
    """It declares its parameters and groups."""
    system = specimen.system
    if not is_dataclass(system) or not type(system).__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise Refusal("the class is no frozen dataclass", "declare it @dataclass(frozen=True)")
    if system.name != specimen.name:
        raise Refusal(f"its name is {system.name!r}, it is registered as {specimen.name!r}", "give both one name")
    names = system.names
    if not names or len(set(names)) < len(names):
        raise Refusal(f"parameters {', '.join(names) or 'none'}: each needs a name of its own")
    wrong = [p.name for p in system.parameters if p.kind not in get_args(Kind) or not p.unit.strip()]
    if wrong:
        raise Refusal(f"{', '.join(wrong)}: a parameter has a unit and a kind, one of {', '.join(get_args(Kind))}")
    if not any(p.kind == "mass" for p in system.parameters):
        raise Refusal("no parameter is of the kind mass, to which groups are ratios")
    for quantity in (*system.groups, *system.modal):
        unknown = set(quantity.exponents) - set(names)
        if unknown:
            raise Refusal(f"{quantity.name} is made of {', '.join(sorted(unknown))}; parameters: {', '.join(names)}")
    return f"{len(names)} parameters, {system.n_dof} DOF, {system.n_hidden} hidden states"


@SYSTEM_CHECKS.add("imports", "import names of bench and bench.systems")
def only_systems(specimen: Specimen) -> str:
    """Its modules import public names of bench and bench.systems only."""
    if type(specimen.system).__module__.partition(".")[0] == HARNESS:
        return "a system of the benchmark itself"
    check_imports(type(specimen.system), ALLOWED)
    return ""


@SYSTEM_CHECKS.add(
    "libraries",
    "write the residual with plain operators, and with ops.sin, ops.tanh, ops.abs, ops.where instead of numpy's",
    gate=True,
)
def every_library(specimen: Specimen) -> str:
    """Numbers, numpy, jax and sympy run the same residual."""
    p = specimen.parameters
    expected = specimen.numbers(p, specimen.motion)
    if not np.all(np.isfinite(expected)):
        raise Refusal(f"its residual is not finite at {p}")
    libraries: dict[str, Callable[[Specimen], np.ndarray]] = {"plain numbers": _floats, "jax": _jax, "sympy": _sympy}
    for library, run in libraries.items():
        try:
            computed = run(specimen)
        except Refusal:
            raise
        except Exception as error:
            raise Refusal(f"{library} cannot run it: {type(error).__name__}: {str(error).splitlines()[0]}") from None
        if not _near(computed, expected):
            raise Refusal(f"{library} gets {computed[:, 0]}, numpy {expected[:, 0]}")
    return ", ".join(libraries)


@SYSTEM_CHECKS.add("input", "compute from the arguments alone, and assign to none of them")
def untouched(specimen: Specimen) -> None:
    """The same motion gives the same residual, and is left as it was."""
    p, motion = dict(specimen.parameters), specimen.motion
    first = specimen.numbers(p, motion)
    if p != specimen.parameters or not all(map(np.array_equal, motion, specimen.motion)):
        raise Refusal("it changes the arrays that it is given")
    specimen.numbers(p, [2.0 * part for part in motion])
    if not np.array_equal(first, specimen.numbers(p, motion)):
        raise Refusal("evaluated again, the residual is another")


@SYSTEM_CHECKS.add("affinity", "let the accelerations a stand in the equation as factors only")
def affine_as_declared(specimen: Specimen) -> str:
    """It is affine in the accelerations, and in the parameters and the motion where it says so."""
    system, p, motion = specimen.system, specimen.parameters, specimen.motion
    x, v, a, f, z = motion
    if not _affine(lambda scale: specimen.numbers(p, [x, v, scale * a, f, z])):
        raise Refusal("its residual is not affine in the accelerations")
    if system.affine_in_parameters and not _affine(
        lambda scale: specimen.numbers({name: scale * value for name, value in p.items()}, motion)
    ):
        raise Refusal(
            "it says that it is affine in its parameters, and is not", "set affine_in_parameters = False on the class"
        )
    other = [-0.7 * part[:, ::-1] for part in motion]
    total, first, second, rest = (
        specimen.numbers(p, parts)
        for parts in ([a + b for a, b in zip(motion, other, strict=True)], motion, other, [0.0 * a for a in motion])
    )
    superposed = _near(total - rest, (first - rest) + (second - rest))
    if system.linear and not superposed:
        raise Refusal("it says that it is linear in the motion, and is not", "leave linear out, or set it to False")
    return "linear in the motion, though it does not say so" if superposed and not system.linear else ""


@SYSTEM_CHECKS.add("parameters", "use it in residual, or drop it")
def every_parameter_counts(specimen: Specimen) -> None:
    """Each parameter changes the residual."""
    p = specimen.parameters
    before = specimen.numbers(p, specimen.motion)
    idle = [n for n in p if _near(specimen.numbers({**p, n: 1.5 * p[n]}, specimen.motion), before)]
    if idle:
        raise Refusal(f"{', '.join(idle)} changes nothing")


@SYSTEM_CHECKS.add("dimensions", "compare the dimensions of the parameters with the terms that they stand in")
def dimensions(specimen: Specimen) -> str:
    """In other units its equation is the same equation: the declared dimensions are those of its terms."""
    p, there = specimen.parameters, specimen.system.rescaled(OTHER_UNITS.of)
    if there.n_hidden:
        return "not asked of hidden states, whose dimension is not declared"
    scales = OTHER_UNITS.scales(specimen.system)
    units = [MEASURED[quantity] for quantity in ("displacement", "velocity", "acceleration")]
    sizes = [*map(OTHER_UNITS.of, units), OTHER_UNITS.of(FORCE), 1.0]
    motion = [part / size for part, size in zip(specimen.motion, sizes, strict=True)]
    rescaled = Specimen(specimen.name, specimen.options, there)
    after = rescaled.numbers({name: value / scales[name] for name, value in p.items()}, motion)
    ratios = specimen.numbers(p, specimen.motion) / after
    for i, ratio in enumerate(ratios):
        if not _near(ratio, np.full_like(ratio, ratio[0])):
            raise Refusal(f"entry {i} of the residual adds terms of different dimensions")
    return ""


@SYSTEM_CHECKS.add("motion", "look at the signs; set smooth = False where it bends suddenly")
def moves(specimen: Specimen) -> None:
    """Its mass matrix is regular, and its motion can be simulated."""
    system, p = specimen.system, specimen.parameters
    x, v, _, f, z = (part[:, 0].tolist() for part in specimen.motion)
    matrix, _ = mass_matrix(system, p, x, v, f, z, numpy_ops)
    if abs(float(np.linalg.det(np.array(matrix, float)))) < NEAR:
        raise Refusal("its mass matrix is singular: some DOF has no acceleration in the equation")
    start = InitialState(0.3 + 0.1 * np.arange(system.n_dof), np.full(system.n_dof, 0.2))
    times = np.linspace(0.0, 3.0, 31)
    exact = integrated_response(system, p, start, times)
    difference = np.max(abs(simulate(system, p, start, times).displacement - exact)) / np.max(abs(exact))
    if not difference <= SAME_PATH:
        raise Refusal(f"two integrators differ by {difference:.2g} of its motion within 3 s, at {p}")


@SYSTEM_CHECKS.add(
    "groups", "declare these as groups; python -m bench identifiability shows what a scenario determines"
)
def groups_are_identifiable(specimen: Specimen) -> str:
    """The groups that it declares are those that free vibration determines."""
    system = specimen.system
    if not system.smooth:
        return "not asked of what bends suddenly: one piece of its equation determines less than all of them"
    initial = (tuple(0.3 + 0.1 * i for i in range(system.n_dof)), (0.2,) * system.n_dof)
    scenario = Scenario(specimen.name, specimen.parameters, initial, 20.0, options=specimen.options)
    try:
        structure = structure_of(scenario)
    except (InputError, TypeError, ValueError) as error:
        return f"not known: {error}"
    determined = ", ".join(map(readable, structure.groups)) or "none"
    unknown = [group.name for group in system.groups if not structure.identifiable(group)]
    if unknown:
        raise Refusal(f"free vibration does not determine {', '.join(unknown)}; it determines {determined}")
    rows = np.array([group.vector(system.names) for group in system.groups]).reshape(-1, len(system.names))
    missing = len(structure.groups) - (int(np.linalg.matrix_rank(rows)) if rows.size else 0)
    if missing > 0:
        raise Refusal(f"{missing} more are determined than it declares; all: {determined}")
    return ", ".join(group.name for group in system.groups)


@SYSTEM_CHECKS.add("pickling", "a frozen dataclass of a module does, with plain fields")
def travels(specimen: Specimen) -> None:
    """It can be sent to another process, and compared."""
    try:
        copy = pickle.loads(pickle.dumps(specimen.system))
    except Exception as error:
        raise Refusal(f"it cannot be pickled: {error}") from None
    if copy != specimen.system or hash(copy) != hash(specimen.system):
        raise Refusal("its copy is not equal to it")


def _floats(specimen: Specimen) -> np.ndarray:
    instants = [[part[:, i].tolist() for part in specimen.motion] for i in range(POINTS)]
    return np.array([specimen.rows(specimen.parameters, instant, float_ops) for instant in instants], float).T


def _jax(specimen: Specimen) -> np.ndarray:
    import jax

    jax.config.update("jax_enable_x64", True)
    ops = array_ops(jax.numpy)

    def rows(p: Any, motion: Motion) -> list[Any]:
        return [jax.numpy.broadcast_to(row, POINTS) for row in specimen.rows(p, motion, ops)]

    return np.array(jax.jit(rows)(specimen.parameters, [jax.numpy.asarray(part) for part in specimen.motion]))


def _sympy(specimen: Specimen) -> np.ndarray:
    import sympy

    motion = specimen.motion
    symbols = [sympy.symbols(f"{letter}:{len(part)}", real=True) for letter, part in zip("xvafz", motion, strict=True)]
    p = {name: sympy.Symbol(f"p_{name}", positive=True) for name in specimen.parameters}
    function = sympy.lambdify([list(p.values()), *symbols], specimen.rows(p, symbols, sympy_ops()), "math")
    values = list(specimen.parameters.values())
    return np.array([function(values, *(part[:, i].tolist() for part in motion)) for i in range(POINTS)]).T


def _affine(residual: Callable[[float], np.ndarray]) -> bool:
    """Return whether a function of a factor has equal slopes: r(2) - r(1) = r(1) - r(0)."""
    none, once, twice = residual(0.0), residual(1.0), residual(2.0)
    return bool(np.allclose(twice - once, once - none, rtol=0.0, atol=NEAR * max(1.0, float(np.max(abs(twice))))))


def _near(computed: np.ndarray, expected: np.ndarray) -> bool:
    size = max(float(np.max(abs(expected), initial=0.0)), math.ulp(1.0))
    return computed.shape == expected.shape and bool(np.allclose(computed, expected, rtol=0.0, atol=NEAR * size))
