"""``python -m bench.check``: does somebody else's method or system keep the contract?

Runs every check of ``bench/conformance`` in a process of its own, and prints which passed and, of those that did not,
what was found and what to do. For a method: contract, seeds, state, honesty, units, hard data, pickling and time; for a
system: what it declares against what its equation does. The package need not be installed.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bench.commands.fields import one_of, positive, read_fields
from bench.commands.guard import command
from bench.errors import InputError

USAGE = """usage: python -m bench.check <package> [field=value ...]

<package>        a file, a folder with a pyproject.toml, an installed package, or
                 the name of a registered method or system
fields (defaults in brackets):
  method.<setting>, system.<option>    as for python -m bench
  timeout_s      [300] limit of one check, and of the import
  format         [table] table, json: a line of JSON a check

exit status: 0, 1 where a check failed, 2 for bad input\n\n"""
DEFAULTS = {"timeout_s": "300", "format": "table"}
LOG_LINES, MOST_S = 12, 1e9
NUMBER = re.compile(r"[-+]?[0-9.]+e[-+]?[0-9]+", re.IGNORECASE)
"""Such as 1e-3, which YAML takes for a word."""


def main(argv: Sequence[str] | None = None) -> int:
    """Print the outcomes; exit status 0, 1 where a check failed, 2 for bad input."""
    return command("bench.check", USAGE + str(__doc__), argv, _main)


def _main(arguments: Sequence[str]) -> int:
    names = [argument for argument in arguments if "=" not in argument]
    if len(names) != 1:
        raise InputError("package", " ".join(names), "name one file, folder, package, method or system")
    own = [argument for argument in arguments if argument.startswith(("method.", "system."))]
    fields = read_fields([a for a in arguments if "=" in a and a not in own], DEFAULTS)
    timeout_s = positive("timeout_s", fields["timeout_s"], MOST_S)
    one_of("format", fields["format"], ("table", "json"))

    from bench.conformance.process import CHECKS, checked
    from bench.conformance.target import read_target

    target = read_target(names[0], _settings(own))
    subjects, outcomes = [], []
    for subject, found in checked(target, timeout_s):
        outcomes.append(found)
        if fields["format"] == "json":
            print(json.dumps({"kind": subject.kind, "subject": subject.name, **asdict(found)}), flush=True)
            continue
        if subject not in subjects:
            subjects.append(subject)
            print(f"{subject.kind} {subject.name} ({subject.value})")
        print("\n".join(_lines(found)), flush=True)
    n, passed = len(outcomes), sum(found.passed for found in outcomes)
    if fields["format"] == "table":
        left_out = sum(len(CHECKS[subject.kind]) for subject in subjects) - n
        print(f"{passed} of {n} checks passed" + (f"; {left_out} not tried without that" if left_out else ""))
    return int(passed < n)


def _lines(found: Any) -> list[str]:
    from bench.reporting.terminal import wrapped

    indent = " " * 38
    if found.passed:
        return [wrapped(f"  passed  {found.name:<28} {found.remark}".rstrip(), indent)]
    lines = [
        wrapped(f"  FAILED  {found.name:<28} {found.about}", indent),
        wrapped(f"{'':10}found:  {found.found}", " " * 18),
        wrapped(f"{'':10}remedy: {found.remedy}", " " * 18),
    ]
    return [*lines, *(f"{'':10}| {line}" for line in found.traceback.strip().splitlines()[-LOG_LINES:])]


def _settings(arguments: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Settings of methods and options of systems, by ``method`` and ``system``."""
    import yaml

    found: dict[str, dict[str, Any]] = {}
    for argument in arguments:
        path, equals, value = argument.partition("=")
        kind, _, name = path.partition(".")
        if not equals or not value or not name:
            raise InputError("argument", argument, f"write {kind}.<name>=<value>")
        own = found.setdefault(kind, {})
        if name in own:
            raise InputError(path, value, "given twice; give it once")
        try:
            own[name] = float(value) if NUMBER.fullmatch(value) else yaml.safe_load(value)
        except (yaml.YAMLError, RecursionError, ValueError):
            raise InputError(path, value, "a number, a word or a list") from None
    return found


if __name__ == "__main__":
    sys.exit(main())
