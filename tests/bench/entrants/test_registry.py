"""Settings that a method does not take are refused in one line that names the setting and its value."""

from __future__ import annotations

from typing import Any

import pytest

from bench.entrants.registry import make_method
from bench.errors import InputError


@pytest.mark.parametrize(
    ("method", "settings", "line"),
    [
        ("rls", {"forgetting": 2.0}, "method.forgetting=2.0: a number above 0, at most 1"),  # the method's own check
        ("iqml", {"rounds": 0}, "method.rounds=0: at least 1"),
        ("iqml", {"rounds": "many"}, "method.rounds=many: "),  # its type
        ("ls", {"smoothing": 1}, "method.smoothing=1: settings of ls: "),  # its name
    ],
)
def test_a_setting_that_makes_no_sense_is_named_with_its_value(
    method: str, settings: dict[str, Any], line: str
) -> None:
    with pytest.raises(InputError) as caught:
        make_method(method, settings)
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)
