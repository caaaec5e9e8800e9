"""The verb ``check``: the contract of somebody else's methods and systems."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal

from bench.commands.declaration import Number, Others, read_settings

LOG_LINES = 12
INDENT = " " * 38


def check(
    package: Annotated[str, "file, folder with a pyproject.toml, installed package, or a registered name"],
    settings: Annotated[Sequence[str], Others(("method", "system")), "method.<setting>=, system.<option>="],
    timeout_s: Annotated[float, Number(0.0, 1e9, "a positive number"), "time limit of one check, and the import"] = 300,
    format: Annotated[Literal["table", "json"], "json: one line per check"] = "table",
) -> int:
    """Check that a method or a system keeps the contract, each check in its own process.

    A method: contract, seeds, state, honesty, units, difficult data, pickling and time. A system: its declaration
    against its equation. The package need not be installed.
    Exit status: 0, 1 where a check failed, 2 for bad input.
    """
    from bench.conformance.process import CHECKS, checked
    from bench.conformance.target import read_target

    target = read_target(package, read_settings(settings))
    subjects, outcomes = [], []
    for subject, outcome in checked(target, timeout_s):
        outcomes.append(outcome)
        if format == "json":
            print(json.dumps({"kind": subject.kind, "subject": subject.name, **asdict(outcome)}), flush=True)
            continue
        if subject not in subjects:
            subjects.append(subject)
            print(f"{subject.kind} {subject.name} ({subject.value})")
        print("\n".join(_lines(outcome)), flush=True)
    passed = sum(outcome.passed for outcome in outcomes)
    if format == "table":
        skipped = sum(len(CHECKS[subject.kind]) for subject in subjects) - len(outcomes)
        print(f"{passed} of {len(outcomes)} checks passed" + (f"; {skipped} skipped without that" if skipped else ""))
    return int(passed < len(outcomes))


def _lines(outcome: Any) -> list[str]:
    from bench.reporting.terminal import wrapped

    if outcome.passed:
        return [wrapped(f"  passed  {outcome.name:<28} {outcome.remark}".rstrip(), INDENT)]
    return [
        wrapped(f"  FAILED  {outcome.name:<28} {outcome.about}", INDENT),
        wrapped(f"{'':10}found:  {outcome.found}", " " * 18),
        wrapped(f"{'':10}remedy: {outcome.remedy}", " " * 18),
        *(f"{'':10}| {line}" for line in outcome.traceback.strip().splitlines()[-LOG_LINES:]),
    ]
