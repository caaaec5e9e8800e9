"""Where the rows of a family's table are from, and with which packages they were computed."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version

from bench.contract.method import Choice
from bench.entrants.registry import default_settings, load_method
from bench.reporting.family import Family, Member
from bench.reporting.labels import cards


def sources(family: Family) -> str:
    """A list: every choice that a row has, then every other package."""
    usual = default_settings(family.method)
    own = [member for member in family.members if member.method == family.method]
    lines = []
    for setting, values in cards()[family.method].choices.items():
        for value in values:  # one of another package is loaded only where a row has it
            users = [member for member in own if member.settings.get(setting, usual[setting]) == value]
            lines += [_line(values[value], users)] if users else []
    lines += [_package_line(row.member) for row in family.others.rows]
    return "\n".join(f"- {line}" for line in dict.fromkeys(lines))


def _line(choice: Choice, users: Iterable[Member]) -> str:
    package = f" ({_versions(choice.package, users)})" if choice.package else ""
    return f"{choice.title}: {choice.source}{package}"


def _package_line(member: Member) -> str:
    method = load_method(member.method)
    packages = ", ".join(_versions(name, [member]) for name in method.requires)
    return f"{member.name}: {method.card.settings_source}" + (f" ({packages})" if packages else "")


def _versions(package: str, users: Iterable[Member]) -> str:
    """A package with the version that the stored cells were computed with, else with the one that is installed."""
    stored = [cell.stored.provenance.get("packages", {}) for m in users for cell in m.cells.values() if cell.stored]
    found = sorted(
        {
            str(own[name]).partition("+")[0]
            for own in stored
            for name in (package, package.replace("-", "_"))
            if name in own
        }
    )
    return f"{package} {', '.join(found) or _installed(package)}"


@cache
def _installed(package: str) -> str:
    """Return the installed version of a package, named as its distribution is or as it is imported."""
    with suppress(PackageNotFoundError):
        return version(package).partition("+")[0]
    names = _distributions().get(package, ())
    return version(names[0]).partition("+")[0] if names else "not installed here"


_distributions = cache(packages_distributions)
"""It reads what every installed package consists of, which takes half a second."""
