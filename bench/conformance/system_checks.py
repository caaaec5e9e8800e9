"""The requirements on any system, ours or anybody's: its equation does what it declares."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Mapping
from dataclasses import is_dataclass, replace
from typing import Any, get_args

import numpy as np

from bench.conformance.check import Check, Refusal
from bench.conformance.imports import HARNESS, foreign_imports, package_files
from bench.conformance.specimen import Motion, Specimen
from bench.contract.problem import InitialState, Units
from bench.dynamics.mechanics import mass_matrix
from bench.dynamics.ops import array_ops, float_ops, numpy_ops
from bench.dynamics.simulate import simulate
from bench.dynamics.symbolic import sympy_ops
from bench.errors import InputError
from bench.information.structural import readable, structure_of
from bench.scenario.scenario import Scenario
from bench.scenario.truth import integrated_response
from bench.systems import FORCE, MEASURED, Kind

NEAR = 1e-9
"""Relative to the largest number beside it: the same but for rounding."""
SAME_PATH = 1e-5
"""Of the largest displacement: a fixed step against an integrator with tight tolerance."""
OTHER_UNITS = Units(mass=3.0, length=5.0, time=7.0)
ALLOWED = ("bench", "bench.systems")


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


def only_systems(specimen: Specimen) -> str:
    """Its modules import public names of bench and bench.systems only."""
    if type(specimen.system).__module__.partition(".")[0] == HARNESS:
        return "a system of the benchmark itself"
    lines = [line for path in package_files(type(specimen.system)) for line in foreign_imports(path, ALLOWED)]
    if lines:
        raise Refusal("; ".join(lines[:3]))
    return ""


def every_library(specimen: Specimen) -> str:
    """Numbers, numpy, jax and sympy run the same residual."""
    p, motion = specimen.parameters, specimen.motion
    expected = specimen.numbers(p, motion)
    if not np.all(np.isfinite(expected)):
        raise Refusal(f"its residual is not finite at {p}")
    others = {"plain numbers": _plain, "jax": _jax, "sympy": _sympy}
    for library, run in others.items():
        try:
            computed = run(specimen, p, motion)
        except Refusal:
            raise
        except Exception as error:
            raise Refusal(f"{library} cannot run it: {type(error).__name__}: {str(error).splitlines()[0]}") from None
        if not _near(computed, expected):
            raise Refusal(f"{library} gets {computed[:, 0]}, numpy {expected[:, 0]}")
    return ", ".join(others)


def untouched(specimen: Specimen) -> str:
    """The same motion gives the same residual, and is left as it was."""
    p, motion = dict(specimen.parameters), copy.deepcopy(specimen.motion)
    first = specimen.numbers(p, motion)
    if p != specimen.parameters or not all(
        np.array_equal(a, b)
        for mine, theirs in zip(motion.parts, specimen.motion.parts, strict=True)
        for a, b in zip(mine, theirs, strict=True)
    ):
        raise Refusal("it changes the arrays that it is given")
    specimen.numbers(p, motion.changed(lambda c: 2.0 * c))
    if not np.array_equal(first, specimen.numbers(p, motion)):
        raise Refusal("evaluated again, the residual is another")
    return ""


def affine_as_declared(specimen: Specimen) -> str:
    """It is affine in the accelerations, and in the parameters and the motion where it says so."""
    system, p, m = specimen.system, specimen.parameters, specimen.motion
    if not _affine(lambda s: specimen.numbers(p, replace(m, a=[s * c for c in m.a]))):
        raise Refusal("its residual is not affine in the accelerations")
    if system.affine_in_parameters and not _affine(
        lambda s: specimen.numbers({name: s * value for name, value in p.items()}, m)
    ):
        raise Refusal(
            "it says that it is affine in its parameters, and is not", "set affine_in_parameters = False on the class"
        )
    superposed = _superposed(specimen)
    if system.linear and not superposed:
        raise Refusal("it says that it is linear in the motion, and is not", "leave linear out, or set it to False")
    return "linear in the motion, though it does not say so" if superposed and not system.linear else ""


def every_parameter_counts(specimen: Specimen) -> str:
    """Each parameter changes the residual."""
    p = specimen.parameters
    before = specimen.numbers(p, specimen.motion)
    idle = [n for n in p if _near(specimen.numbers({**p, n: 1.5 * p[n]}, specimen.motion), before)]
    if idle:
        raise Refusal(f"{', '.join(idle)} changes nothing")
    return ""


def dimensions(specimen: Specimen) -> str:
    """In other units its equation is the same equation: the declared dimensions are those of its terms."""
    system, p, m, units = specimen.system, specimen.parameters, specimen.motion, OTHER_UNITS
    there = system.rescaled(units.of)
    if there.n_hidden:
        return "not asked of hidden states, whose dimension is not declared"
    scales = units.scales(system)
    sizes = [units.of(MEASURED[what]) for what in ("displacement", "velocity", "acceleration")] + [units.of(FORCE)]
    x, v, a, f = ([c / size for c in part] for part, size in zip((m.x, m.v, m.a, m.f), sizes, strict=True))
    other = Specimen(specimen.name, specimen.options, there)
    after = other.numbers({name: value / scales[name] for name, value in p.items()}, Motion(x, v, a, f, []))
    before = specimen.numbers(p, m)
    for i, (here, now) in enumerate(zip(before, after, strict=True)):
        ratio = here / now
        if not _near(ratio, np.full_like(ratio, ratio[0])):
            raise Refusal(f"entry {i} of the residual adds terms of different dimensions")
    return ""


def moves(specimen: Specimen) -> str:
    """Its mass matrix is regular, and its motion can be simulated."""
    system, p, m = specimen.system, specimen.parameters, specimen.motion.at(0)
    matrix, _ = mass_matrix(system, p, m.x, m.v, m.f, m.z, numpy_ops)
    if abs(float(np.linalg.det(np.array(matrix, float)))) < NEAR:
        raise Refusal("its mass matrix is singular: some DOF has no acceleration in the equation")
    start = InitialState(0.3 + 0.1 * np.arange(system.n_dof), np.full(system.n_dof, 0.2))
    times = np.linspace(0.0, 3.0, 31)
    exact = integrated_response(system, p, start, times)
    motion = simulate(system, p, start, times).displacement
    if not np.all(np.isfinite(exact)) or not np.allclose(motion, exact, rtol=0.0, atol=SAME_PATH * np.max(abs(exact))):
        gap = float(np.max(abs(motion - exact)) / np.max(abs(exact)))
        raise Refusal(f"two integrators differ by {gap:.2g} of its motion within 3 s, at {_rounded(p)}")
    return ""


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
    unknown = [group.name for group in system.groups if not structure.identifiable(group)]
    if unknown:
        known = ", ".join(map(readable, structure.groups)) or "none"
        raise Refusal(f"free vibration does not determine {', '.join(unknown)}; it determines {known}")
    rows = np.array([group.vector(system.names) for group in system.groups]).reshape(-1, len(system.names))
    missing = len(structure.groups) - int(np.linalg.matrix_rank(rows)) if rows.size else len(structure.groups)
    if missing > 0:
        raise Refusal(
            f"{missing} more are determined than it declares; all: {', '.join(map(readable, structure.groups))}"
        )
    return ", ".join(group.name for group in system.groups)


def travels(specimen: Specimen) -> str:
    """It can be sent to another process, and compared."""
    try:
        copied = pickle.loads(pickle.dumps(specimen.system))
    except Exception as error:
        raise Refusal(f"it cannot be pickled: {error}") from None
    if copied != specimen.system or hash(copied) != hash(specimen.system):
        raise Refusal("its copy is not equal to it")
    return ""


def _plain(specimen: Specimen, p: Mapping[str, float], motion: Motion) -> np.ndarray:
    points = range(len(motion.x[0]))
    return np.array([specimen.numbers(p, motion.at(i), float_ops) for i in points]).T


def _jax(specimen: Specimen, p: Mapping[str, float], motion: Motion) -> np.ndarray:
    import jax

    jax.config.update("jax_enable_x64", True)
    ops = array_ops(jax.numpy)

    def rows(p: Any, x: Any, v: Any, a: Any, f: Any, z: Any) -> list[Any]:
        return [jax.numpy.broadcast_to(row, x[0].shape) for row in specimen.rows(p, Motion(x, v, a, f, z), ops)]

    parts = ([jax.numpy.asarray(c) for c in part] for part in motion.parts)
    return np.array(jax.jit(rows)(dict(p), *parts))


def _sympy(specimen: Specimen, p: Mapping[str, float], motion: Motion) -> np.ndarray:
    import sympy

    ops = sympy_ops()
    symbols = {letter: [sympy.Symbol(f"{letter}{i}", real=True) for i in range(len(part))]
               for letter, part in vars(motion).items()}  # fmt: skip
    names = {name: sympy.Symbol(f"p_{name}", positive=True) for name in p}
    rows = specimen.rows(names, Motion(**symbols), ops)
    arguments = [*names.values(), *(s for part in symbols.values() for s in part)]
    function = sympy.lambdify(arguments, rows, "math")
    points = range(len(motion.x[0]))
    instants = [[value for part in motion.at(i).parts for value in part] for i in points]
    return np.array([function(*p.values(), *instant) for instant in instants]).T


def _affine(residual: Any) -> bool:
    """Return whether a function of a factor has equal slopes: r(2) - r(1) = r(1) - r(0)."""
    none, once, twice = residual(0.0), residual(1.0), residual(2.0)
    return bool(np.allclose(twice - once, once - none, rtol=0.0, atol=NEAR * max(1.0, float(np.max(abs(twice))))))


def _superposed(specimen: Specimen) -> bool:
    """Return whether the residual of a sum of motions is the sum of theirs."""
    p, m = specimen.parameters, specimen.motion
    other = m.changed(lambda c: -0.7 * c[::-1])
    both = Motion(*([a + b for a, b in zip(*parts, strict=True)] for parts in zip(m.parts, other.parts, strict=True)))
    rest = m.changed(lambda c: 0.0 * c)
    r, r1, r2, r0 = (specimen.numbers(p, one) for one in (both, m, other, rest))
    return _near(r - r0, (r1 - r0) + (r2 - r0))


def _near(one: np.ndarray, other: np.ndarray) -> bool:
    size = float(np.max(abs(other), initial=0.0))
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=0.0, atol=NEAR * max(size, math.ulp(1.0))))


def _rounded(p: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.3g}" for name, value in p.items())


SYSTEM_CHECKS: tuple[Check[Specimen], ...] = (
    Check("declaration", declaration, "list every parameter as bench.Parameter(name, unit, kind, dimension)"),
    Check("imports", only_systems, "import names of bench and bench.systems"),
    Check(
        "libraries",
        every_library,
        "write the residual with plain operators, and with ops.sin, ops.tanh, ops.abs, ops.where instead of numpy's",
        gate=True,
    ),
    Check("input", untouched, "compute from the arguments alone, and assign to none of them"),
    Check("affinity", affine_as_declared, "let the accelerations a stand in the equation as factors only"),
    Check("parameters", every_parameter_counts, "use it in residual, or drop it"),
    Check("dimensions", dimensions, "compare the dimensions of the parameters with the terms that they stand in"),
    Check("motion", moves, "look at the signs; set smooth = False where it bends suddenly"),
    Check(
        "groups",
        groups_are_identifiable,
        "declare these as groups; python -m bench identifiability shows what a scenario determines",
    ),
    Check("pickling", travels, "a frozen dataclass of a module does, with plain fields"),
)
