"""``python -m bench.certify``: the certificate of a measured record, as a page and as JSON.

usage: python -m bench.certify data=record.csv [out=certificate] [twins=200] [field=value ...]

The fields are those of a measured record (see python -m bench --help): columns, units, rate, from, to, decimate,
detrend, system [auto], method, seed. The first method is the primary one, whose values the certificate states; the
others stand beside it.
  method  [fast]  a list, or fast: the methods that take seconds, shooting first
  out             the folder of certificate.html and certificate.json
  twins           simulated records like this one on which the intervals are checked; 0: none

Exit status: 0, 1 where the verdict is "do not trust", 2 for bad input.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from bench.commands.fields import listed, path_of, read_fields, whole
from bench.commands.guard import command
from bench.errors import InputError
from bench.reporting.whole_file import check_folder, write

OWN = {"out": "certificate", "twins": "200", "system": "auto", "method": "fast"}
"""Fields that are read here, since they have other values than for a simulated record."""
MOST_TWINS = 100_000


def main(argv: Sequence[str] | None = None) -> int:
    """Write the certificate; exit status 1 where its verdict is "do not trust", 2 for bad input."""
    return command("bench.certify", __doc__ or "", argv, _main)


def _main(arguments: list[str]) -> int:
    fields, rest = _own_fields(arguments)
    twins, request = whole("twins", fields["twins"], 0, MOST_TWINS), _request(fields, rest)
    folder = path_of(fields["out"])
    try:
        from bench.face.results import nulls
        from bench.measured.certificate import certify
        from bench.measured.record import read_measured
        from bench.measured.trust import Trust
        from bench.reporting.certificate.contents import contents, listed
        from bench.reporting.certificate.page import page

        _check_packages()
    except ImportError as error:
        print(f"bench.certify: {error.name} is missing: pip install 'vibration-bench[report]'", file=sys.stderr)
        return 2
    measured = read_measured(request)
    check_folder(folder)
    with _bar() as say:
        certificate = certify(request, measured, twins, say)
    shown = contents(certificate, shlex.join(["python", "-m", "bench.certify", *arguments]))
    text = page(shown)
    paths = (folder / "certificate.html", folder / "certificate.json")
    write(paths[0], text, folder)
    write(paths[1], json.dumps(nulls(listed(shown)), allow_nan=False, ensure_ascii=False, indent=1) + "\n", folder)
    print(f"{certificate.primary.trust.value}: {paths[0]} {paths[1]}")
    return int(certificate.primary.trust is Trust.NO)


def _own_fields(arguments: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """The fields of this command, and the arguments that are of any measured record."""
    rest = [argument for argument in arguments if argument.partition("=")[0] not in OWN]
    fields = read_fields([argument for argument in arguments if argument not in rest], OWN)
    if not any(argument.startswith("data=") for argument in rest):
        raise InputError("data", None, "name a record: data=record.csv")
    return fields, rest


def _request(fields: dict[str, str], rest: Sequence[str]) -> Any:
    from bench.config.choices import check_choice, choices
    from bench.config.overrides import read_overrides
    from bench.config.records import certificate_methods
    from bench.measured.request import ALL, request_of

    overrides = read_overrides(rest)
    for name in ("plot", "picture"):
        if name in overrides:
            raise InputError(name, overrides[name][0], "it is of python -m bench; a certificate has its pictures")
    names = listed("method", fields["method"])
    if names == ["fast"]:
        names = [name for name in certificate_methods() if name in choices("method")]
    for name in names if names != [ALL] else []:
        check_choice("method", name)
    return request_of({**overrides, "system": [fields["system"]], "method": names})


def _check_packages() -> None:
    """Raise ImportError before the work where the page could not be made after it."""
    import jinja2  # noqa: F401
    import matplotlib  # noqa: F401


@contextmanager
def _bar() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar over steps on the error stream; the callback that moves it on."""
    from tqdm.auto import tqdm

    with tqdm(total=1, unit="step", file=sys.stderr, dynamic_ncols=True, mininterval=0.2) as bar:

        def say(what: str, done: int, of: int) -> None:
            bar.total = of
            bar.set_description(what, refresh=False)
            bar.n = done
            bar.refresh()

        yield say


if __name__ == "__main__":
    sys.exit(main())
