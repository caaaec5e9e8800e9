"""The fuzzer of command lines: a few seconds; minutes with ``--hypothesis-profile=long``."""

from __future__ import annotations

from forked import Forked
from fuzz.lines import LINES, check_line
from hypothesis import given


@given(line=LINES)
def test_a_line_that_makes_no_sense_is_one_line(line: list[str], forked: Forked) -> None:
    check_line(line, forked)
