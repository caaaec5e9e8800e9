"""Command lines as hypothesis makes them: fields and values of every command, put together by chance."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from forked import Call, Forked
from hypothesis import strategies as st
from malformed import TRACKS, all_malformed, entry

from bench.commands.verbs import VERBS
from bench.config.overrides import settable

COMMANDS = ("bench", *VERBS, *TRACKS)
ASKED = {"-h", "--help", "--version"}
"""Where one of these is on a line, the rest of it does not matter."""
WORDS = [word for case in all_malformed() for word in case.arguments if len(word) < 400]
FIELDS = sorted({word.partition("=")[0] for word in WORDS} | set(settable()))
VALUES = st.one_of(
    st.sampled_from(sorted({word.partition("=")[2] for word in WORDS})),
    st.text(st.characters(exclude_characters="\x00", exclude_categories=()), max_size=12),
    st.floats().map(repr),
    st.recursive(
        st.sampled_from(["1", "a", "null", "true", "range(0,3)", "interval(0,1)", "${x}", "'q'", ""]),
        lambda inner: st.one_of(
            st.lists(inner, max_size=3).map(lambda parts: f"[{','.join(parts)}]"),
            st.lists(inner, max_size=3).map(lambda parts: ",".join(parts)),
            inner.map(lambda part: f"{{a:{part}}}"),
            inner.map(lambda part: f"choice({part})"),
        ),
        max_leaves=6,
    ),
)
ARGUMENTS = st.one_of(
    st.builds(lambda field, value: f"{field}={value}", st.sampled_from(FIELDS), VALUES),
    st.sampled_from(WORDS),
    st.text(st.characters(exclude_characters="\x00", exclude_categories=()), max_size=12),
)
NEVER = "snr=never"
"""What no command takes for a number: it ends before it does anything, whatever else is on its line."""


LINES = st.tuples(st.sampled_from(COMMANDS), st.lists(ARGUMENTS, max_size=5).map(lambda arguments: [*arguments, NEVER]))
"""A command with its arguments, of which one at least makes no sense."""


def check_line(command: str, arguments: list[str], forked: Forked) -> None:
    """Run a line that makes no sense; it ends with status 2, one line, and nothing left behind."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder) / "here"
        here.mkdir()
        ended = forked.run(Call([*entry(command), *arguments], str(here)))
        assert list(here.iterdir()) == [], "left something behind"
    if ASKED & set(arguments):
        return
    lines = ended.err.splitlines()
    assert (ended.status, ended.out, len(lines)) == (2, "", 1), ended
    assert re.match(r"bench[.\w]*: .*=.*: .", lines[0]), ended
    assert lines[0].isprintable(), ended
