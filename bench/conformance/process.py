"""The process in which somebody else's code is imported and checked; where it hangs or dies, one check is lost."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import pickle
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from bench.config.limits import check_numbers, check_options
from bench.conformance.candidate import Candidate
from bench.conformance.check import Check, Outcome, outcome
from bench.conformance.method_checks import METHOD_CHECKS
from bench.conformance.specimen import Specimen
from bench.conformance.system_checks import SYSTEM_CHECKS
from bench.conformance.target import KINDS, Subject, Target
from bench.contract.method import Identifier
from bench.entrants import registry
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method, make_method, missing_package
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.limit import limit_files
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.systems import System, load_system, make_system, registered_systems

MEMORY_MB = 4096.0
CHECKS: dict[str, tuple[Check[Any], ...]] = {"method": METHOD_CHECKS, "system": SYSTEM_CHECKS}


def checked(target: Target, timeout_s: float) -> Iterator[tuple[Subject, Outcome]]:
    """Run all checks of all that a target names, each within a limit (s); raises InputError where nothing can be.

    Those behind one that fails and is a gate are left out.
    """
    children = Children()
    try:
        child, subjects = _opened(children, target, timeout_s)
        for subject in subjects:
            for check in CHECKS[subject.kind]:
                child.send(pickle.dumps((subject, check.name)))
                try:
                    found = pickle.loads(child.receive(timeout_s, MEMORY_MB))
                except Died as died:
                    found = _lost(check, died)
                    child, _ = _opened(children, target, timeout_s)
                yield subject, found
                if check.gate and not found.passed:
                    break
    finally:
        children.close()


def _opened(children: Children, target: Target, timeout_s: float) -> tuple[Child, list[Subject]]:
    child = children.start(serve, target)
    try:
        child.receive(READY_S)  # what it takes to start is no fault of the package
        kind, found = pickle.loads(child.receive(timeout_s, MEMORY_MB))
    except Died as died:
        remedy = "what is imported must neither end its process nor keep it"
        raise InputError("package", target.text, f"cannot be imported: {died.message}; {remedy}") from None
    if kind == "refused":
        raise found
    return child, found


def _lost(check: Check[Any], died: Died) -> Outcome:
    if died.reason == "timeout":
        remedy = "make it faster, or give it more with timeout_s=; a sweep stops a fit in the same way"
    else:
        remedy = "nothing that estimate does may end its process: raise bench.NoEstimate instead"
    return Outcome(check.name, check.about, False, found=died.message, remedy=remedy, traceback=died.log)


def serve(connection: Connection, target: Target) -> None:
    """Import what is named, and run check after check of it until nobody asks any more."""
    limit_files()
    connection.send_bytes(b"ready")
    with tempfile.TemporaryDirectory() as site:
        try:
            sys.path[:0] = [*target.paths, site]
            subjects = list(target.subjects) or _looked_for(target)
            if not target.installed:
                _register(subjects, Path(site))
            _check_settings(subjects, target)
            made = {subject: _made(subject, target) for subject in subjects}
        except InputError as error:
            connection.send_bytes(pickle.dumps(("refused", error)))
            return
        connection.send_bytes(pickle.dumps(("found", subjects)))
        while True:
            subject, name = pickle.loads(connection.recv_bytes())
            check = next(check for check in CHECKS[subject.kind] if check.name == name)
            connection.send_bytes(pickle.dumps(outcome(check, made[subject])))


def _looked_for(target: Target) -> list[Subject]:
    """The methods and systems whose classes stand in a module."""
    try:
        module = importlib.import_module(target.module)
    except Exception as error:
        raise InputError("package", target.text, f"cannot be imported: {one_line(error)}") from None
    found = []
    for name, item in vars(module).items():
        if not inspect.isclass(item) or item.__module__ != module.__name__ or inspect.isabstract(item):
            continue
        if issubclass(item, Identifier):
            found.append(Subject("method", _free(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()), _value(item)))
        elif issubclass(item, System):
            found.append(Subject("system", str(item.name), _value(item)))
    if not found:
        raise InputError("package", target.text, "no class in it subclasses bench.Identifier or bench.System")
    return found


def _value(own: type) -> str:
    return f"{own.__module__}:{own.__qualname__}"


def _free(name: str) -> str:
    """The name, or one like it that nothing is registered by."""
    return f"own_{name}" if name in registry.method_names() else name


def _register(subjects: Sequence[Subject], site: Path) -> None:
    """Have the entry points of subjects found, as those of an installed package are; what is installed is already."""
    points = {"method": registry.registered(), "system": registered_systems()}
    new = []
    for subject in subjects:
        known = points[subject.kind].get(subject.name)
        if known is None and subject.name not in REFERENCES:
            new.append(subject)
        elif known is None or known.value != subject.value:
            raise InputError(subject.kind, subject.name, "the benchmark has one of that name; choose another")
    info = site / "under_check-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: under-check\nVersion: 0\n", encoding="utf-8")
    lines = [f"[{group}]\n" + "".join(f"{s.name} = {s.value}\n" for s in new if s.kind == kind)
             for group, kind in KINDS.items()]  # fmt: skip
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    importlib.invalidate_caches()
    for function in (registry.registered, load_method, registered_systems, load_system):
        with contextlib.suppress(AttributeError):  # a test may have replaced one
            function.cache_clear()  # type: ignore[attr-defined]


def _check_settings(subjects: Sequence[Subject], target: Target) -> None:
    """Raise InputError for a setting of a method where there is none, an option of a system likewise, or no number."""
    for kind in target.settings.keys() - {subject.kind for subject in subjects}:
        for name, value in target.settings[kind].items():
            raise InputError(f"{kind}.{name}", value, f"left out: no {kind} is checked")
    options = target.settings.get("system", {})
    try:
        check_numbers({"system": {"options": options}})
        for subject in subjects:
            if subject.kind == "system":
                check_options({"kind": subject.name, "options": options})
    except InputError as error:
        raise InputError(error.field.replace("system.options.", "system."), error.value, error.remedy) from None


def _made(subject: Subject, target: Target) -> Candidate | Specimen:
    settings = dict(target.settings.get(subject.kind, {}))
    if subject.kind == "system":
        return Specimen(subject.name, settings, make_system(subject.name, settings))
    missing = missing_package(subject.name)
    if missing:
        raise InputError("package", target.text, missing)
    return Candidate(make_method(subject.name, settings))
