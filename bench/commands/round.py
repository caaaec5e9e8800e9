"""The verb ``round``: rounds of problems whose true values are hidden, for organisers and participants."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from bench.commands.declaration import Bare, OneOf, Others, Within, folder, settings_of
from bench.commands.design import methods
from bench.commands.log import LOG
from bench.errors import InputError

Round = Annotated[Path, Bare(), "folder of the round"]


def round(action: Annotated[Literal["new", "solve", "open", "verify"], Bare(), "what to do"]) -> int:
    """Make a round of problems whose truth is hidden, solve it, open it, or verify an opened one.

    The folder of the round holds problems, template and commitment; seed and truth are kept elsewhere until the round
    is opened.
    """
    raise InputError("action", action, f"python -m bench round {action} and its fields; see --help")


def new(
    scenarios: Annotated[int, Within(ge=1, le=999), "number of problems"],
    out: Annotated[Path, "folder of the round to write"],
    secret: Annotated[Path | None, "folder of seed and truth, not inside the round [<out>_secret]"] = None,
) -> int:
    """Draw problems from the ranges of conf/round.yaml by a secret seed, and write them.

    Keep the folder of seed and truth secret until the round is over.
    """
    from secrets import randbits

    from bench.rounds.folder import write_round
    from bench.rounds.secret import SEED_BYTES

    hidden = secret or out.with_name(f"{out.name}_secret")
    for field, path in (("out", out), ("secret", hidden)):
        if path.exists():
            raise InputError(field, path, "a folder that does not exist yet")
        if not os.access(next(parent for parent in path.resolve().parents if parent.exists()), os.W_OK):
            raise InputError(field, path, "the folder cannot be created here: permission denied")
    if out.resolve() in (hidden.resolve(), *hidden.resolve().parents):
        raise InputError("secret", hidden, f"name a folder outside of {out}, which is published")
    print(f"drawing {scenarios} problems, about a second each", flush=True)
    write_round(out, hidden, randbits(8 * SEED_BYTES), scenarios)
    print(f"{out}: {scenarios} problems, to be published")
    print(f"{hidden}: seed and truth; keep it secret until the round is over")
    return 0


def solve(
    round: Round,
    method: Annotated[str, OneOf(methods), "method, or one of its variants"],
    out: Annotated[Path, "file of predictions to write"],
    settings: Annotated[Sequence[str], Others(("method",)), "method.<setting>="],
    timeout_s: Annotated[float, Within(gt=0, le=1e9), "time limit of one problem (s)"] = 120,
    memory_mb: Annotated[float, Within(ge=100, le=1e9), "memory limit of one problem (MB)"] = 4096,
) -> int:
    """Solve the problems of a round by a method of this project, from the files alone."""
    from bench.config.composition import content_of
    from bench.entrants.reference import REFERENCES
    from bench.entrants.registry import make_method
    from bench.reporting.whole_file import check_file, write
    from bench.rounds.folder import COLUMNS, PROBLEMS, problem_names, table
    from bench.rounds.solve import solve as solved

    names = problem_names(folder("round", round))
    content = {**content_of("method", method), **settings_of(settings).get("method", {})}
    if (name := content.pop("name")) in REFERENCES:
        raise InputError("method", method, "name a method that does not use the true values")
    identifier = make_method(name, content)
    check_file(out)
    rows, unanswered = [], 0
    for answers, reason in solved(round / PROBLEMS, names, identifier, timeout_s, memory_mb):
        rows += answers
        if reason:
            unanswered += 1
            LOG.warning(reason)
    write(out, table(COLUMNS, rows))
    print(f"{out}: {len(names) - unanswered} of {len(names)} problems answered by {method}")
    return 0


def open_(round: Round, secret: Annotated[Path, "folder of seed and truth, as round new has written it"]) -> int:
    """Publish seed and truth in the folder of a round, which anybody can then score and verify."""
    from bench.rounds.folder import open_round

    open_round(folder("round", round), folder("secret", secret))
    print(f"{round}: seed and truth are published; python -m bench round verify {round}")
    return 0


def verify(
    round: Round,
    secret: Annotated[Path | None, "folder of seed and truth, if the round is not yet opened"] = None,
) -> int:
    """Draw an opened round again from its seed, and compare problems, truth and commitment.

    Exit status: 0, 1 where something differs, 2 for bad input.
    """
    from bench.rounds.folder import verify_round

    differences = verify_round(folder("round", round), secret and folder("secret", secret))
    print("\n".join(differences) or f"{round}: commitment, truth and problems agree with the seed")
    return 1 if differences else 0


VARIANTS = {"new": new, "solve": solve, "open": open_, "verify": verify}
