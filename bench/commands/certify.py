"""The verb ``certify``: the certificate of a measured record."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from bench.commands.declaration import Bare, Others, Within, command_line
from bench.commands.log import LOG
from bench.config.fields import RECORD
from bench.errors import InputError
from bench.isolation.processes import start_server
from bench.records.workers import PRELOADED

if TYPE_CHECKING:
    from bench.config.overrides import Overrides
    from bench.records.modal_data import ModalRecord
    from bench.records.problem import Measured
    from bench.records.request import ModalRequest, Request

RECORD_FIELDS = (
    *(name for name in RECORD if name not in ("plot", "picture")),
    "initial_state", "prior", "seed", "method", "system",
)  # fmt: skip
"""Fields of a measured record, which several verbs read as a run does, with the settings of method and system."""
FAST = ("fast",)


def certify(
    data: Annotated[str, Bare(), "measured record, or several of one rig: run1.csv,run2.csv"],
    record: Annotated[list[str], Others(RECORD_FIELDS), "columns=, units=, modes=, ... as for python -m bench data="],
    out: Annotated[Path, "folder of certificate.html and certificate.json"] = Path("certificate"),
    twins: Annotated[int, Within(ge=0, le=100_000), "simulated replicas that check the intervals; 0: none"] = 200,
    system: Annotated[str, "system, or auto: the best of the model classes"] = "auto",
    method: Annotated[tuple[str, ...], "methods, the primary one first, or fast: those that take seconds"] = FAST,
) -> int:
    """Write the certificate of a measured record, as a page and as JSON.

    The first method gives the values; the others are compared with it. With modes= the modes are certified.
    Exit status: 0, 1 where the verdict is "do not trust", 2 for bad input.
    """
    again = command_line(certify, locals())
    from bench.records.request import ModalRequest

    request = _request(data, system, method, record)
    several_modes = isinstance(request, ModalRequest)
    if all(path.is_file() for path in request.files):
        start_server(PRELOADED)  # the server imports while this process does
    from bench.face.results import nulls
    from bench.records.modal_data import read_modal
    from bench.records.problem import read_measured
    from bench.reporting.certificate.page import page
    from bench.reporting.terminal import wrapped
    from bench.reporting.whole_file import check_folder, write

    measured: Any = read_modal(request) if several_modes else read_measured(request)
    check_folder(out)
    shown = _modes(request, measured, again) if several_modes else _one_mode(request, measured, twins, again)
    paths = (out / "certificate.html", out / "certificate.json")
    write(paths[0], page(shown), out)
    write(paths[1], json.dumps(nulls(shown), allow_nan=False, ensure_ascii=False, indent=1) + "\n", out)
    reasons = [wrapped(f"- {reason}", "    ", "  ") for reason in shown["reasons"]]
    print(wrapped(f"{shown['verdict']}: {shown['answer']}"), *reasons, *paths, sep="\n")
    return int(shown["verdict"] == "do not trust")


def _installed(names: Iterable[str]) -> list[str]:
    """Return the methods whose packages are installed, and warn which are left out."""
    from bench.entrants.registry import missing_package, registered

    lacking = {name: missing_package(name) if name in registered() else None for name in names}
    if left_out := [why for why in lacking.values() if why]:
        LOG.warning("left out: %s", "; ".join(left_out))
    return [name for name, why in lacking.items() if why is None]


def _one_mode(request: Request, measured: Measured, twins: int, again: str) -> dict[str, Any]:
    from bench.engine.progress import progress_bar
    from bench.records.certificate import certify as certificate_of
    from bench.reporting.certificate.contents import contents

    with progress_bar() as on_progress:
        certificate = certificate_of(request, measured, twins, on_progress, LOG.info)
    return contents(certificate, again)


def _modes(request: ModalRequest, records: Sequence[ModalRecord], again: str) -> dict[str, Any]:
    from bench.records.modal import find_modes
    from bench.reporting.certificate.modal_contents import modal_contents

    if len(records) > 1:
        raise InputError("data", request.config.data, f"{len(records)} records; a certificate of modes is of one")
    return modal_contents(find_modes(request, records[0], others=True), request.files, again)


def _request(data: str, system: str, method: Sequence[str], record: Sequence[str]) -> Any:
    """Return the request of a certificate; with ``modes=`` that of a certificate of modes."""
    from bench.config.choices import check_choice, choices
    from bench.config.overrides import read_overrides
    from bench.config.records import certificate_methods
    from bench.records.request import ALL, AUTO, modal_request_of, request_of

    given: Overrides = read_overrides([f"data={data}", *record])
    if given.get("modes", [None]) != [None]:
        chosen = {"method": list(method) if method != FAST else [], "system": [system] if system != AUTO else []}
        return modal_request_of({**given, **{name: values for name, values in chosen.items() if values}})
    if method == FAST:
        method = _installed(name for name in certificate_methods() if name in choices("method"))
    for name in method if method != (ALL,) else []:
        check_choice("method", name)
    return request_of({**given, "system": [system], "method": list(method)})
