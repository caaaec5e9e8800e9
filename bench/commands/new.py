"""The verb ``new``: a template of a method or a system."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from bench.errors import InputError


def new(
    method: Annotated[str | None, "name of a new method"] = None,
    system: Annotated[str | None, "name of a new system"] = None,
    out: Annotated[Path | None, "folder to write [bench-<name>]"] = None,
) -> int:
    """Write a small package with a method or a system to start from.

    It has a pyproject.toml with the entry point that registers the name, a module, a README, and a test that runs
    python -m bench check, which passes.
    """
    from bench.conformance.template_files import write_package

    name = method or system
    if name is None or (method and system):
        raise InputError("method", method or "", "give either method=<name> or system=<name>")
    folder = out or Path(f"bench-{name.replace('_', '-')}")
    print(*write_package("method" if method else "system", name, folder), sep="\n")
    print(f"try it: python -m bench check package={folder}")
    return 0
