"""``python -m bench.expect``: what each method is expected to do at a free decay, from the atlas and its model."""

from __future__ import annotations

import math
import sys
import zlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from bench.commands.fields import file_of, number, one_of, read_fields, whole
from bench.commands.guard import command
from bench.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

FIELDS = {
    "samples": "", "cycles": "", "damping": "", "snr": "", "phase": "0", "start": "unknown", "quantity": "k_over_m",
    "atlas": "results/atlas.csv.gz",
}  # fmt: skip
USAGE = """usage: python -m bench.expect samples=50 cycles=5 damping=0.02 snr=20 [field=value ...]

  samples    of the displacement, evenly spread
  cycles     undamped periods over which they are spread
  damping    damping ratio
  snr        mean square of the clean samples over the noise's variance, dB
  phase      [0] degrees: of the start; 0 released from rest, 90 from an impact
  start      [unknown] or known: whether a method is told it
  quantity   [k_over_m] or c_over_m
  atlas      [results/atlas.csv.gz] what python -m bench -m experiment=atlas made"""


def main(argv: Sequence[str] | None = None) -> int:
    """Say what to expect."""
    return command("bench.expect", USAGE, argv, expected)


def expected(arguments: Sequence[str]) -> int:
    """Read the test, ask the model of each method, print; raises InputError."""
    from bench.atlas.model import ensembles
    from bench.atlas.point import GROUPS

    fields = read_fields(arguments, FIELDS)
    one_of("quantity", fields["quantity"], GROUPS)
    ensembles()  # before the work, where it is missing
    frame = _frame(fields)
    atlas = _atlas(fields["atlas"], fields["quantity"])
    print(_answer(frame, atlas, fields["quantity"]))
    return 0


def _frame(fields: Mapping[str, str]) -> pd.DataFrame:
    """The test as a line of the atlas, with its bounds."""
    from bench.atlas.point import FreeDecay
    from bench.reporting.atlas import point_frame

    for name in ("samples", "cycles", "damping", "snr"):
        if not fields[name]:
            raise InputError(name, "", f"{name}=...; see python -m bench.expect --help")
    known = one_of("start", fields["start"], ("known", "unknown")) == "known"
    samples = whole("samples", fields["samples"], 4, 100_000)
    cycles = number("cycles", fields["cycles"], 0.0, 1e6, "a positive number")
    damping = number("damping", fields["damping"], 0.0, 100.0, "a positive number")
    snr = number("snr", fields["snr"], -100.0, 300.0, "decibels above -100")
    phase = math.radians(number("phase", fields["phase"]) % 180.0)
    point = FreeDecay(samples, cycles, damping, snr, phase, known)
    return point_frame(point)


def _atlas(text: str, quantity: str) -> pd.DataFrame:
    import pandas as pd

    wanted = "a file that python -m bench -m experiment=atlas has written"
    path = file_of("atlas", text, wanted)
    try:
        found = pd.read_csv(path)
    except (OSError, ValueError, EOFError, zlib.error):
        raise InputError("atlas", text, wanted) from None
    if not {"method", f"{quantity}_core", f"{quantity}_gross"} <= set(found):
        raise InputError("atlas", text, wanted)
    return found


def _answer(frame: pd.DataFrame, atlas: pd.DataFrame, quantity: str) -> str:
    from bench.atlas.model import Model, unknown
    from bench.entrants.registry import load_method
    from bench.reporting.atlas import RARE
    from bench.reporting.terminal import table, wrapped

    why = unknown(frame, quantity)
    bound = float(frame[f"bound_{quantity}"].iloc[0])
    if why:
        return wrapped(f"The atlas does not know: {why}.")
    rows = []
    for name, own in atlas.groupby("method", sort=False):
        try:
            one = Model(own, quantity).expected(frame)[0]
        except ValueError:
            continue
        low, middle, high = one.excess
        spread = "-" if math.isnan(middle) else f"{middle:.2f} ({low:.2f} to {high:.2f})"
        order = (one.gross > RARE, middle if math.isfinite(middle) else math.inf)
        rows.append((order, [load_method(str(name)).card.title, spread, f"{100 * one.gross:.1f}"]))
    if not rows:
        raise InputError("atlas", "", "an atlas with more points of some method")
    text = table(
        [cells for _, cells in sorted(rows, key=lambda row: row[0])],
        ["method", "error over the bound (range)", "gross errors, %"],
    )
    wrong = float(frame.wrong_basin.iloc[0])
    meaning = MEANING.format(quantity=TITLES[quantity], bound=100 * bound, wrong=100 * wrong)
    return f"{text}\n\n{wrapped(meaning, '')}"


MEANING = (
    "The bound on the standard deviation of {quantity} is {bound:.2g} %; in {wrong:.2g} % of such records the "
    "likelihood is largest at a wrong frequency. Errors are those of fits that are not gross, with the range in which "
    "eight of ten tests like this lie; gross are those beyond five times the bound."
)
TITLES = {"k_over_m": "k/m", "c_over_m": "c/m"}


if __name__ == "__main__":
    sys.exit(main())
