"""The verb ``share``: submit, merge, publish and export results."""

from __future__ import annotations

from typing import Annotated, Literal

from bench.commands.export import arviz, notebook, petab
from bench.commands.merge import merge
from bench.commands.publish import publish
from bench.commands.submit import submit
from bench.errors import InputError


def share(action: Annotated[Literal["submit", "merge", "export", "publish"], "what to do"]) -> int:
    """Share results: action=submit, merge, export or publish."""
    raise InputError("form", "", f"action={action} needs form=petab, arviz or notebook")


VARIANTS = {
    "action=submit": submit, "action=merge": merge, "action=publish": publish, "action=export form=petab": petab,
    "action=export form=arviz": arviz, "action=export form=notebook": notebook,
}  # fmt: skip
