"""The verb ``check``: whether a method or a system, also of another package, keeps the contract."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Literal

from bench.commands.declaration import Others, Within, settings_of

LOG_LINES = 12


def check(
    package: Annotated[str, "file, folder with a pyproject.toml, installed package, or a registered name"],
    settings: Annotated[Sequence[str], Others(("method", "system")), "method.<setting>=, system.<option>="],
    timeout_s: Annotated[float, Within(gt=0, le=1e9), "time limit of one check, and the import"] = 300,
    format: Annotated[Literal["table", "json"], "json: one line per check"] = "table",
) -> int:
    """Check that a method or a system keeps the contract; every check has its own process.

    A method: contract, seeds, state, honesty, units, difficult data, pickling and time. A system: its declaration
    against its equation. The package need not be installed.
    Exit status: 0, 1 where a check failed, 2 for bad input.
    """
    from bench.conformance.process import CHECKS, checked
    from bench.reporting.terminal import wrapped

    subjects, outcomes = [], []
    for subject, outcome in checked(package, settings_of(settings), timeout_s):
        if subject not in subjects:
            subjects.append(subject)
            if format == "table":
                print(f"{subject.kind} {subject.name} ({subject.value})")
        outcomes.append(outcome)
        if format == "json":
            print(json.dumps({"kind": subject.kind, "subject": subject.name, **asdict(outcome)}), flush=True)
        elif outcome.passed:
            print(wrapped(f"  passed  {outcome.name:<28} {outcome.message}".rstrip(), " " * 38), flush=True)
        else:
            print(wrapped(f"  FAILED  {outcome.name:<28} {outcome.about}", " " * 38))
            print(wrapped(f"{'':10}found:  {outcome.message}", " " * 18))
            print(wrapped(f"{'':10}remedy: {outcome.remedy}", " " * 18))
            lines = outcome.traceback.strip().splitlines()[-LOG_LINES:]
            print("".join(f"{'':10}| {line}\n" for line in lines), end="", flush=True)
    passed = sum(outcome.passed for outcome in outcomes)
    if format == "table":
        skipped = sum(len(CHECKS[subject.kind]) for subject in subjects) - len(outcomes)
        print(f"{passed} of {len(outcomes)} checks passed" + (f"; {skipped} skipped without that" if skipped else ""))
    return int(passed < len(outcomes))
