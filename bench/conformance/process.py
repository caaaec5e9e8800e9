"""The process in which somebody else's code is imported and checked; where it hangs or dies, one check is lost."""

from __future__ import annotations

import importlib
import inspect
import pickle
import re
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint
from multiprocessing.connection import Connection

from bench.config.limits import check_numbers, check_system
from bench.conformance.check import Checks, Outcome
from bench.conformance.method_checks import METHOD_CHECKS, Candidate
from bench.conformance.system_checks import SYSTEM_CHECKS, Specimen
from bench.conformance.target import Subject, Target
from bench.contract.method import Identifier
from bench.entrants import registry
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.limits import limit_files
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.systems import System, make_system, registered_systems

MEMORY_MB = 4096.0
CHECKS: Mapping[str, Checks] = {"method": METHOD_CHECKS, "system": SYSTEM_CHECKS}


def checked(target: Target, timeout_s: float) -> Iterator[tuple[Subject, Outcome]]:
    """Run the checks of all that a target names, each within a time limit (s), up to a gate that fails.

    Raises:
        InputError: Where the target cannot be imported or made.
    """
    with Children() as children:
        child, subjects = _opened(children, target, timeout_s)
        for subject in subjects:
            for check in CHECKS[subject.kind]:
                child.send(pickle.dumps((subject, check.name)))
                try:
                    outcome = pickle.loads(child.receive(timeout_s, MEMORY_MB))
                except Died as died:
                    remedy = "nothing that estimate does may end its process: raise bench.NoEstimate instead"
                    if died.reason == "timeout":
                        remedy = "make it faster, or give it more with timeout_s=; a sweep stops a fit in the same way"
                    outcome = check.failed(died.message, remedy, died.log)
                    child, _ = _opened(children, target, timeout_s)
                yield subject, outcome
                if check.gate and not outcome.passed:
                    break


def _opened(children: Children, target: Target, timeout_s: float) -> tuple[Child, list[Subject]]:
    child = children.start(serve, target)
    try:
        child.receive(READY_S)  # the start is no fault of the package
        answer = pickle.loads(child.receive(timeout_s, MEMORY_MB))
    except Died as died:
        remedy = "what is imported must neither end its process nor keep it"
        raise InputError("package", target.text, f"cannot be imported: {died.message}; {remedy}") from None
    if isinstance(answer, InputError):
        raise answer
    return child, answer


def serve(connection: Connection, target: Target) -> None:
    """Import a target, and run one check after another until nobody asks any more."""
    limit_files()
    connection.send_bytes(b"ready")
    sys.path[:0] = target.paths
    try:
        subjects = list(target.subjects) or _classes(target)
        for kind in target.settings.keys() - {subject.kind for subject in subjects}:
            raise InputError(kind, dict(target.settings[kind]), f"left out: no {kind} is checked")
        made = {subject: _made(subject, target) for subject in subjects}
    except InputError as error:
        connection.send_bytes(pickle.dumps(error))
        return
    connection.send_bytes(pickle.dumps(subjects))
    while True:
        subject, name = pickle.loads(connection.recv_bytes())
        (check,) = (check for check in CHECKS[subject.kind] if check.name == name)
        connection.send_bytes(pickle.dumps(check.outcome(made[subject])))


def _classes(target: Target) -> list[Subject]:
    """Return the methods and systems whose classes stand in a module."""
    try:
        module = importlib.import_module(target.module)
    except Exception as error:
        raise InputError("package", target.text, f"cannot be imported: {one_line(error)}") from None
    subjects = []
    for name, item in vars(module).items():
        if not inspect.isclass(item) or item.__module__ != module.__name__ or inspect.isabstract(item):
            continue
        value = f"{item.__module__}:{item.__qualname__}"
        if issubclass(item, System):
            subjects.append(Subject("system", str(item.name), value))
        elif issubclass(item, Identifier):
            subjects.append(Subject("method", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower(), value))
    if not subjects:
        raise InputError("package", target.text, "no class in it subclasses bench.Identifier or bench.System")
    return subjects


def _made(subject: Subject, target: Target) -> Candidate | Specimen:
    """Register a subject in this process, as an installed package has it, and make it with its settings."""
    name, settings = subject.name, dict(target.settings.get(subject.kind, {}))
    points = registry.registered() if subject.kind == "method" else registered_systems()
    if points.get(name, subject).value != subject.value or name in registry.REFERENCES:
        raise InputError(subject.kind, name, "the benchmark has one of that name; choose another")
    points[name] = EntryPoint(name, subject.value, subject.kind)
    if subject.kind == "method":
        if missing := registry.missing_package(name):
            raise InputError("package", target.text, missing)
        return Candidate(registry.make_method(name, settings))
    try:
        check_numbers({"system": {"options": settings}})
        check_system(name, settings)
    except InputError as error:
        raise InputError(error.field.replace("system.options.", "system."), error.value, error.remedy) from None
    return Specimen(name, settings, make_system(name, settings))
