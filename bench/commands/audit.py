"""The verb ``audit``: compare the numbers of a published claim with what its data allow."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from bench.commands.declaration import Bare, file

if TYPE_CHECKING:
    from bench.audit.claim import StatedClaim


def audit(
    claim: Annotated[Path, Bare(), "file of the claim, like those of claims/; see docs/how_to/audit_claim.md"],
    format: Annotated[Literal["text", "json"], "json: all numbers, as one object"] = "text",
    out: Annotated[
        Path | None, "folder of NAME.json, NAME.md (a paragraph to cite) and NAME.svg (a badge) [none]"
    ] = None,
) -> int:
    """Audit a published claim: what its data allow, and where the reported numbers fall.

    It checks whether published data agree with the stated equation and whether each quantity is identifiable, and
    states the bound, the scores of an efficient estimator with the share of its draws that do as well or as badly,
    whether a comparison of methods is decided, and the influence of prior and initial guess. Without noise only the
    bias is stated.
    """
    from bench.audit.evidence import audit as audited
    from bench.audit.sentences import as_dict, badge, lines_of, paragraph, summary
    from bench.face.results import nulls
    from bench.reporting.terminal import wrapped
    from bench.reporting.whole_file import check_folder, write

    stated = read(claim)
    if out is not None:
        check_folder(out)
    result = audited(stated)
    content = json.dumps(nulls(as_dict(result)), allow_nan=False, ensure_ascii=False, indent=1) + "\n"
    if format == "json":
        print(content, end="")
    else:
        print(*[wrapped(line) for line in (f"{claim.stem}: {summary(result)}", *lines_of(result))], sep="\n")
    if out is not None:
        for ending, text in {"json": content, "md": paragraph(result) + "\n", "svg": badge(result)}.items():
            path = out / f"{claim.stem}.{ending}"
            write(path, text, out)
            print(path)
    return 0


def read(path: Path) -> StatedClaim:
    """Read the file of a claim; raises InputError for a malformed one."""
    from bench.audit.claim import read_claim
    from bench.config.files import read_user_yaml

    content = read_user_yaml(str(file("claim", path)), "claim", "a claim is wanted: see docs/how_to/audit_claim.md")
    return read_claim(path.stem, content, path.parent)
