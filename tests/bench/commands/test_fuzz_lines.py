"""A few seconds of the fuzzer of command lines; ``python -m tests.fuzz`` goes on for minutes."""

from __future__ import annotations

from forked import Forked
from fuzz.lines import LINES, check_line
from hypothesis import HealthCheck, given, settings


@settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(line=LINES)
def test_a_line_that_makes_no_sense_is_one_line(line: list[str], forked: Forked) -> None:
    check_line(line, forked)
