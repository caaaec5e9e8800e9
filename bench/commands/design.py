"""``python -m bench.design``: the cheapest free decay that tells a quantity as well as is wanted.

With ``force=optimal``: the force of a given energy that tells most. With ``given=record.csv``: what a decay that was
taken would tell, if it had gone on for longer or were taken again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from bench.commands.design_request import request_of
from bench.commands.fields import one_of, read_fields
from bench.commands.guard import command
from bench.config.atlas import on_the_bound
from bench.errors import InputError

FIELDS = {
    "want": "", "frequency": "", "damping": "", "noise": "", "amplitude": "", "rate": "", "samples": "", "duration": "",
    "method": "", "verify": "0", "times": "even", "force": "none", "energy": "", "mass": "", "out": "",
}  # fmt: skip
CHOICES = {"times": ("even", "optimal"), "force": ("none", "optimal")}
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
  force      [none] optimal: the best forces of an energy in a test that is given
             (samples=, duration=, energy=, mass=), from rest, beside a hammer
             blow, noise and an even multisine
  energy     of the force: the integral of its square (N² s)
  mass       as far as it is known (kg)
  out        a file for the best times (s), one a line, or for the best force
  method     [{method}] that verify= asks
  verify     [0] simulate the proposed test so many times

       python -m bench.design given=record.csv [want=damping_ratio:5%] [field=value ...]

  given      a record of a free decay: what it would tell, had it gone on or
             were it taken again
  method     [{method}] that fits it
  ...        columns=, units=, rate=, from=, to=, as for python -m bench data="""


def main(argv: Sequence[str] | None = None) -> int:
    """Propose tests."""
    return command("bench.design", USAGE.format(method=on_the_bound()[0]), argv, designed)


def designed(arguments: Sequence[str]) -> int:
    """Propose, print, and simulate where asked; raises InputError."""
    if any(argument.startswith("given=") for argument in arguments):
        from bench.commands.design_given import gone_on

        return gone_on(arguments)
    fields = read_fields(arguments, FIELDS)
    request = request_of(fields)
    for name, choices in CHOICES.items():
        one_of(name, fields[name], choices)
    if fields["force"] == "optimal":
        from bench.commands.design_force import driven

        return driven(request)
    for name in ("energy", "mass"):
        if fields[name]:
            raise InputError(name, fields[name], "force=optimal beside it: a free decay has none")
    if fields["times"] == "optimal":
        from bench.commands.design_times import sampled

        return sampled(request)
    if fields["out"]:
        raise InputError("out", fields["out"], "with times=optimal or force=optimal, which it is for")
    from bench.commands.design_plan import planned

    return planned(request)


if __name__ == "__main__":
    sys.exit(main())
