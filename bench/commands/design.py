"""``python -m bench.design``: the cheapest free decay that tells a quantity as well as is wanted.

With ``given=record.csv``: what a decay that was taken would tell, if it had gone on for longer or were taken again.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING

from bench.commands.guard import command, read_fields, whole
from bench.config.atlas import on_the_bound
from bench.errors import InputError
from bench.measured.reading.units import unit_of
from bench.planning.free_decay import QUANTITIES
from bench.planning.search import SHARE, WITHIN, Likely, Proposal, cheapest, proposal
from bench.reporting.tables.common import markdown_table

if TYPE_CHECKING:
    import numpy as np

    from bench.planning.free_decay import Decay
    from bench.planning.longer import Taken

FIELDS = {
    "want": "", "frequency": "", "damping": "", "noise": "", "amplitude": "", "rate": "", "samples": "", "duration": "",
    "method": "", "verify": "0", "times": "even", "out": "",
}  # fmt: skip
STARTS = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
"""Starts that are proposed where none is said, over the noise."""
USAGE = """usage: python -m bench.design want=c_over_m:5% frequency=2 damping=0.02 noise=0.5mm [field=value ...]

  want       <quantity>:<error>%, of k_over_m, c_over_m, natural_frequency,
             damping_ratio; the error is a standard deviation
  frequency  natural frequency (Hz) as far as it is known: 2, or 2:10% with its
             standard deviation
  damping    damping ratio, 0.02 or 0.02:50%
  noise      standard deviation of a sample, with its unit: 0.5mm
  amplitude  displacement at the start, with its unit; without: several
  rate       samples a second that there are; without: any
  samples, duration
             of a test that is given (s): what it would tell
  times      [even] optimal: the best times of the samples of a test that is
             given (samples=, duration=, amplitude=), beside even ones
  out        with times=optimal: a file for the times (s), one a line
  method     [{method}] that verify= asks
  verify     [0] simulate the proposed test so many times

       python -m bench.design given=record.csv [want=damping_ratio:5%] [field=value ...]

  given      a record of a free decay: what it would tell, had it gone on or
             were it taken again
  method     [{method}] that fits it
  ...        columns=, units=, rate=, from=, to=, as for python -m bench data="""
TITLES = {"k_over_m": "k/m", "c_over_m": "c/m", "natural_frequency": "frequency", "damping_ratio": "damping ratio"}


def main(argv: Sequence[str] | None = None) -> int:
    """Propose tests."""
    return command("bench.design", USAGE.format(method=on_the_bound()[0]), argv, designed)


def designed(arguments: Sequence[str]) -> int:
    """Propose, print, and simulate where asked; raises InputError."""
    if any(argument.startswith("given=") for argument in arguments):
        return _gone_on(arguments)
    fields = read_fields(arguments, FIELDS)
    for name in ("want", "frequency", "damping", "noise"):
        if not fields[name]:
            raise InputError(name, "", f"{name}=...; see python -m bench.design --help")
    quantity, error = _wanted(fields["want"])
    (frequency, frequency_sd), (damping, damping_sd) = (_known(name, fields[name]) for name in ("frequency", "damping"))
    likely = Likely(frequency, damping, frequency_sd, damping_sd)
    noise, number = _length("noise", fields["noise"]), whole("verify", fields["verify"], least=0)
    if fields["times"] not in ("even", "optimal"):
        raise InputError("times", fields["times"], "even or optimal")
    if fields["times"] == "optimal":
        return _sampled(fields, likely, quantity, error, noise, number)
    found = _proposals(fields, likely, quantity, error, noise)
    if not found:
        print(
            f"no free decay of up to 100,000 samples tells {TITLES[quantity]} to {100 * error:g} %; start further out"
        )
        return 1
    method = fields["method"] or on_the_bound()[0]
    tests = [(one.decay, None) for one in found]
    checked = _simulated(fields, likely, quantity, error, number, tests) if number else None
    print(_table(found, noise, checked))
    print(f"\n{_meaning(likely, method, quantity, number)}")
    return 0


def _proposals(fields: Mapping[str, str], likely: Likely, quantity: str, error: float, noise: float) -> list[Proposal]:
    starts = [_length("amplitude", fields["amplitude"]) / noise] if fields["amplitude"] else list(STARTS)
    if fields["samples"] or fields["duration"]:
        from bench.planning.free_decay import Decay

        samples, duration = whole("samples", fields["samples"] or "0", 8), _positive("duration", fields["duration"])
        return [proposal(likely, Decay(samples, duration, start)) for start in starts]
    rate = _positive("rate", fields["rate"]) if fields["rate"] else 0.0
    tried = [cheapest(likely, quantity, error, start, rate) for start in starts]
    return [one for one in tried if one is not None]


def _table(found: Sequence[Proposal], noise: float, checked: Sequence[str] | None) -> str:
    """A line a test; ``checked``: what simulating it gave."""
    rows = []
    for one in found:
        rate = (one.decay.samples - 1) / one.decay.duration
        cells = [f"{1e3 * noise * one.decay.amplitude:.3g}", f"{one.decay.samples}", f"{one.decay.duration:.3g}",
                 f"{rate:.3g}"]  # fmt: skip
        for name in QUANTITIES:
            same = math.isclose(one.median[name], one.share[name], rel_tol=1e-3)
            cells.append(f"{_percent(one.median[name])}" + ("" if same else f" ({_percent(one.share[name])})"))
        rows.append([*cells, f"{100 * one.wrong_basin:.1g}"])
    headers = ["start, mm", "samples", "duration, s", "samples a second", *(f"{t}, %" for t in TITLES.values()),
               "wrong frequency, %"]  # fmt: skip
    if checked is not None:
        rows, headers = [[*row, text] for row, text in zip(rows, checked, strict=True)], [*headers, "simulated, %"]
    return markdown_table(rows, headers)


def _percent(value: float) -> str:
    percent = 100 * value
    return "-" if not math.isfinite(value) else f"{percent:.0f}" if percent >= 10 else f"{percent:.2g}"


def _meaning(likely: Likely, method: str, quantity: str, number: int) -> str:
    said = ["Each line is the test of fewest samples for its start, released from rest; percentages are standard",
            "deviations by the Cramér-Rao bound"]  # fmt: skip
    if likely.in_doubt:
        said.append(f"(median over the likely oscillators; in brackets not exceeded in {100 * SHARE:g} % of them)")
    text = " ".join(said) + f". Methods that reach it: {', '.join(on_the_bound())}."
    if number:
        text += (
            f" simulated: of {number} tests, answered by {method}, those whose error of {TITLES[quantity]} is within "
            f"{WITHIN:g} times the wanted one; 95 % where it is just reached."
        )
    return text


def _median_words(likely: Likely) -> str:
    return ", median over the likely oscillators" if likely.in_doubt else ""


def _simulated(
    fields: Mapping[str, str],
    likely: Likely,
    quantity: str,
    error: float,
    number: int,
    tests: Sequence[tuple[Decay, np.ndarray | None]],
) -> list[str]:
    """The share of simulated tests that reach what was wanted, test by test."""
    from tqdm import tqdm

    from bench.entrants.registry import make_method
    from bench.planning.verify import reached, simulated

    identifier = make_method(fields["method"] or on_the_bound()[0], {})
    with tqdm(total=number * len(tests), unit="test", file=sys.stderr) as bar:
        every = [simulated(likely, decay, quantity, identifier, number, bar.update, times) for decay, times in tests]
    return [f"{100 * reached(errors, error):.1f}" for errors in every]


def _sampled(fields: Mapping[str, str], likely: Likely, quantity: str, error: float, noise: float, number: int) -> int:
    """A test that is given with its samples evenly spread, and where they tell most."""
    from bench.planning.free_decay import Decay
    from bench.planning.optimal import VOLUME, best_times, told_by

    for name in ("samples", "duration", "amplitude"):
        if not fields[name]:
            raise InputError(name, "", f"{name}=..., of the test whose times are sought")
    decay = Decay(
        whole("samples", fields["samples"], 8, 500), _positive("duration", fields["duration"]),
        _length("amplitude", fields["amplitude"]) / noise,
    )  # fmt: skip
    found = {
        "even": told_by(likely, decay.times, decay.amplitude),
        f"best for {TITLES[quantity]}": best_times(likely, decay, quantity),
        "best for k/m and c/m": best_times(likely, decay, VOLUME),
    }
    rows = [[title, *(_percent(one.median[name]) for name in QUANTITIES)] for title, one in found.items()]
    headers = ["times", *(f"{title}, %" for title in TITLES.values())]
    if number:
        headers.append("simulated, %")
        tests = [(decay, one.times) for one in found.values()]
        rows = [[*row, share] for row, share in zip(
            rows, _simulated(fields, likely, quantity, error, number, tests), strict=True
        )]  # fmt: skip
    best = found[f"best for {TITLES[quantity]}"].times
    print(
        f"{markdown_table(rows, headers)}\n\n{fill(f'Best for {TITLES[quantity]} (s): {_bursts(best, decay)}.', 120)}"
    )
    print(f"Percentages are standard deviations by the Cramér-Rao bound{_median_words(likely)}.")
    if fields["out"]:
        _write_times(fields["out"], best)
    return 0


def _bursts(times: np.ndarray, decay: Decay) -> str:
    """Times in a row as one burst."""
    gap, bursts = 0.5 * decay.duration / (decay.samples - 1), [[times[0]]]
    for time in times[1:]:
        if time - bursts[-1][-1] <= gap:
            bursts[-1].append(time)
        else:
            bursts.append([time])
    return ", ".join(
        f"{one[0]:.3g}" if len(one) == 1 else f"{len(one)} from {one[0]:.3g} to {one[-1]:.3g}" for one in bursts
    )


def _write_times(path: str, times: np.ndarray) -> None:
    try:
        with open(path, "w", encoding="utf-8") as file:
            file.write("\n".join(["t (s)", *(f"{time:.9g}" for time in times)]) + "\n")
    except OSError as error:
        raise InputError("out", path, f"cannot be written: {error.strerror}") from None


FACTORS = (1.25, 1.5, 2.0, 3.0)
"""Times its duration, for which it is said what a record would tell."""
AGAIN = (2, 4)


def _gone_on(arguments: Sequence[str]) -> int:
    """What a record would tell, had it gone on or were it taken again."""
    from bench.config.overrides import read_overrides
    from bench.planning.taken import taken

    own = {"given": "", "want": "", "method": on_the_bound()[0]}
    fields = read_fields([one for one in arguments if one.partition("=")[0] in own], own)
    rest = [one for one in arguments if one.partition("=")[0] not in own]
    wanted = _wanted(fields["want"]) if fields["want"] else None
    given = [f"data={fields['given']}", f"method={fields['method']}", *rest]
    record = taken(read_overrides(given))
    lines = [("as it is", record.duration, record.supported)]
    lines += [(f"{factor:g} times as long", factor * record.duration, record.expected(factor)) for factor in FACTORS]
    lines += [(f"{number} records alike", number * record.duration, record.repeated(number)) for number in AGAIN]
    rows = [[title, f"{seconds:.3g}", *(_percent(told[name]) for name in QUANTITIES)] for title, seconds, told in lines]
    print(markdown_table(rows, ["record", "seconds", *(f"{title}, %" for title in TITLES.values())]))
    print(f"\n{GONE_ON}")
    if wanted:
        print(_until(record, *wanted))
    return 0


GONE_ON = """Percentages are standard errors; those of the record are what it supports, the others follow by ratios of
Cramér-Rao bounds. A longer record goes on at the same rate."""


def _until(record: Taken, quantity: str, error: float) -> str:
    """What it takes to tell a quantity as well as is wanted."""
    title, factor = TITLES[quantity], record.factor_for(quantity, error)
    if factor == 1.0:
        return f"The record tells {title} to {_percent(record.supported[quantity])} %, which is enough."
    number = record.number_for(quantity, error)
    again = f"{number} records like it do"
    if factor is None:
        return f"No longer record tells {title} to {100 * error:g} %: the motion has died away; {again}."
    seconds = (factor - 1.0) * record.duration
    now = _percent(record.supported[quantity])
    return f"{seconds:.2g} s more bring {title} from {now} to {100 * error:g} %; {again} as well."


def _wanted(text: str) -> tuple[str, float]:
    quantity, _, error = text.partition(":")
    if quantity not in QUANTITIES:
        raise InputError("want", text, f"<quantity>:<error>%, of {', '.join(QUANTITIES)}")
    return quantity, _share("want", error)


def _known(field: str, text: str) -> tuple[float, float]:
    """A number and the standard deviation of its logarithm."""
    value, colon, doubt = text.partition(":")
    return _positive(field, value), _share(field, doubt) if colon else 0.0


def _share(field: str, text: str) -> float:
    if not text.endswith("%"):
        raise InputError(field, text, "a percentage, as 5%")
    return _positive(field, text[:-1]) / 100.0


def _positive(field: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise InputError(field, text, "a positive number")
    return value


def _length(field: str, text: str) -> float:
    """A length with its unit, in metres."""
    parts = re.fullmatch(r"\s*([-+.\deE]+)\s*([^\d\s].*)", text)
    unit = unit_of(parts[2]) if parts else None
    if parts is None or unit is None or unit.measures != "displacement":
        raise InputError(field, text, "a length with its unit, as 0.5mm")
    return _positive(field, parts[1]) * unit.size


if __name__ == "__main__":
    sys.exit(main())
