"""Command lines as hypothesis makes them: fields and values of every command, put together by chance."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from forked import Call, Forked
from hypothesis import strategies as st
from malformed import all_malformed

from bench.commands.verbs import VERBS
from bench.config.overrides import settable

STARTS = ("method=ls", *VERBS, "experiment=online", "experiment=modal", "experiment=atlas", "experiment=measured")
ASKED = {"-h", "--help", "--version"}
"""Where one of these is on a line, the rest of it does not matter."""
WORDS = sorted({word for case in all_malformed() for word in case.words if len(word) < 400})
FIELDS = sorted({word.partition("=")[0] for word in WORDS} | set(settable()))
TEXTS = st.text(st.characters(exclude_characters="\x00", exclude_categories=()), max_size=12)
VALUES = st.one_of(
    st.sampled_from(sorted({word.partition("=")[2] for word in WORDS})),
    TEXTS,
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
ARGUMENTS = st.one_of(st.builds("{}={}".format, st.sampled_from(FIELDS), VALUES), st.sampled_from(WORDS), TEXTS)
NEVER = "snr=never"
"""No command takes this for a number, so that each ends before it does anything, whatever else is on its line."""
LINES = st.tuples(st.sampled_from(STARTS), st.lists(ARGUMENTS, max_size=5)).map(lambda line: [line[0], *line[1], NEVER])


def check_line(words: list[str], forked: Forked) -> None:
    """Run a line that makes no sense; it ends with status 2, one line, and nothing left behind."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder) / "here"
        here.mkdir()
        ended = forked.run(Call(words, str(here)))
        assert list(here.iterdir()) == [], "left something behind"
    if ASKED & set(words):
        return
    lines = ended.err.splitlines()
    assert (ended.status, ended.out, len(lines)) == (2, "", 1), ended
    assert re.match(r"bench: .*=.*: .", lines[0]), ended
    assert lines[0].isprintable(), ended
