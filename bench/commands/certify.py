"""The verb ``certify``: the certificate of a measured record."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from bench.commands.declaration import Others, Within, command_line
from bench.config.fields import RECORD as OF_RECORD
from bench.errors import InputError
from bench.isolation.processes import start_server
from bench.records.workers import PRELOADED

RECORD = (
    *(name for name in OF_RECORD if name not in ("plot", "picture")),
    "initial_state", "prior", "seed", "method", "system",
)  # fmt: skip
"""Fields of a measured record that other verbs take as a run does; settings of method and system with them."""


def certify(
    data: Annotated[str, "measured record, or several of one rig: run1.csv,run2.csv"],
    record: Annotated[list[str], Others(RECORD), "columns=, units=, ... as for python -m bench data="],
    out: Annotated[Path, "folder of certificate.html and certificate.json"] = Path("certificate"),
    twins: Annotated[int, Within(ge=0, le=100_000), "simulated replicas that check the intervals; 0: none"] = 200,
    system: Annotated[str, "system, or auto: the best of the model classes"] = "auto",
    method: Annotated[tuple[str, ...], "methods, the primary one first, or fast: those that take seconds"] = ("fast",),
) -> int:
    """Write the certificate of a measured record, as a page and as JSON.

    The primary method states the values; the others are compared with it.
    Exit status: 0, 1 where the verdict is "do not trust", 2 for bad input.
    """
    again = command_line(certify, locals())
    request = _request(data, system, method, record)
    if all(path.is_file() for path in request.files):
        start_server(PRELOADED)  # it imports while this process does
    try:
        import jinja2  # noqa: F401 - before the work: the page needs it after it

        from bench.engine.progress import progress_bar
        from bench.face.results import nulls
        from bench.records.certificate import certify as certificate_of
        from bench.records.problem import read_measured
        from bench.records.verdict import Trust
        from bench.reporting.certificate.contents import contents
        from bench.reporting.certificate.page import page
        from bench.reporting.terminal import wrapped
        from bench.reporting.whole_file import check_folder, write
    except ImportError as error:
        raise InputError("package", error.name, "missing: pip install 'vibration-bench[report]'") from None
    measured = read_measured(request)
    check_folder(out)
    with progress_bar() as on_look:
        certificate = certificate_of(request, measured, twins, on_look, lambda said: print(said, file=sys.stderr))
    shown = contents(certificate, again)
    paths = (out / "certificate.html", out / "certificate.json")
    write(paths[0], page(shown), out)
    write(paths[1], json.dumps(nulls(shown), allow_nan=False, ensure_ascii=False, indent=1) + "\n", out)
    print(wrapped(f"{shown['verdict']}: {shown['answer']}"), *paths, sep="\n")
    return int(certificate.primary.trust is Trust.NO)


def _request(data: str, system: str, method: Sequence[str], record: Sequence[str]) -> Any:
    from bench.config.choices import check_choice, choices
    from bench.config.overrides import read_overrides
    from bench.config.records import certificate_methods
    from bench.records.request import ALL, request_of

    if method == ("fast",):
        method = [name for name in certificate_methods() if name in choices("method")]
    for name in method if method != (ALL,) else []:
        check_choice("method", name)
    overrides = read_overrides([f"data={data}", *record])
    return request_of({**overrides, "system": [system], "method": list(method)})
