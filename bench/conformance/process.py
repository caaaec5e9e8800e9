"""Run the checks in a separate process; if the checked code hangs or crashes, only one check fails."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator, Mapping
from multiprocessing.connection import Connection
from typing import Any

from bench.conformance.check import CheckOutcome, Checks
from bench.conformance.method_checks import METHOD_CHECKS
from bench.conformance.subjects import Subject, made, subjects_of
from bench.conformance.system_checks import SYSTEM_CHECKS
from bench.errors import InputError
from bench.isolation.limits import limit_files
from bench.isolation.processes import READY_S, Child, Children, Died

MEMORY_MB = 4096.0
CHECKS: Mapping[str, Checks] = {"method": METHOD_CHECKS, "system": SYSTEM_CHECKS}
Settings = Mapping[str, Mapping[str, Any]]
"""Settings of methods and options of systems, by kind."""


def checked(text: str, settings: Settings, timeout_s: float) -> Iterator[tuple[Subject, CheckOutcome]]:
    """Run the checks of all subjects that a text names, each with a time limit (s), up to a gate that fails.

    Raises:
        InputError: If the text names no subject, or one that cannot be imported or created.
    """
    with Children() as children:
        child, subjects = _opened(children, text, settings, timeout_s)
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
                    child, _ = _opened(children, text, settings, timeout_s)
                yield subject, outcome
                if check.gate and not outcome.passed:
                    break


def _opened(children: Children, text: str, settings: Settings, timeout_s: float) -> tuple[Child, list[Subject]]:
    child = children.start(serve, text, settings, os.getcwd())
    try:
        child.receive(READY_S)  # the start is no fault of the package
        answer = pickle.loads(child.receive(timeout_s, MEMORY_MB))
    except Died as died:
        remedy = "what is imported must neither end its process nor keep it"
        raise InputError("package", text, f"cannot be imported: {died.message}; {remedy}") from None
    if isinstance(answer, InputError):
        raise answer
    return child, answer


def serve(connection: Connection, text: str, settings: Settings, folder: str) -> None:
    """Import the subjects that a text names, and run the requested checks until the connection closes."""
    limit_files()
    connection.send_bytes(b"ready")
    os.chdir(folder)
    try:
        subjects = subjects_of(text)
        for kind in settings.keys() - {subject.kind for subject in subjects}:
            raise InputError(kind, dict(settings[kind]), f"left out: no {kind} is checked")
        instances = {subject: made(subject, dict(settings.get(subject.kind, {}))) for subject in subjects}
    except InputError as error:
        connection.send_bytes(pickle.dumps(error))
        return
    connection.send_bytes(pickle.dumps(subjects))
    while True:
        subject, name = pickle.loads(connection.recv_bytes())
        (check,) = (check for check in CHECKS[subject.kind] if check.name == name)
        connection.send_bytes(pickle.dumps(check.outcome(instances[subject])))
