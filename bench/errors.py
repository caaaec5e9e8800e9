"""The one error a user can cause: an input that names its field, its value and the remedy."""

from __future__ import annotations

from collections.abc import Collection

LONGEST_VALUE, LONGEST_LINE = 200, 1900


class InputError(ValueError):
    """Bad input. ``str(error)`` is one line: field, value, and what would be right.

    The command line prints that line and exits with status 2; nothing has run by then.
    """

    def __init__(self, field: str, value: object, remedy: str) -> None:
        self.field, self.value, self.remedy = field, value, remedy
        super().__init__(" ".join(f"{field}={value}: {remedy}".split()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        return type(self), (self.field, self.value, self.remedy)


def line_of(error: InputError) -> str:
    """An error as a terminal may show it: what is long is cut, what is no letter is written out."""
    line = f"{shortened(error.field)}={shortened(error.value)}: {shortened(error.remedy, LONGEST_LINE)}"
    return shortened(line, LONGEST_LINE)


def shortened(value: object, longest: int = LONGEST_VALUE) -> str:
    """A value in one line of letters that a terminal shows, cut in its middle where it is longer than so many."""
    text = " ".join(str(value).split())
    if len(text) > longest:
        text = f"{text[: longest - 60]}...{text[-50:]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text)


def did_you_mean(written: object, names: Collection[str]) -> str:
    """Return ``did you mean ls? `` with the name that is nearest in spelling; an empty text where none is near."""
    from difflib import get_close_matches

    text = str(written)[:LONGEST_VALUE]
    near = get_close_matches(text, names, n=1, cutoff=0.6)
    if not near and len(text) == 2:  # two letters that changed places are half a match
        near = [name for name in names if name == text[::-1]]
    return f"did you mean {near[0]}? " if near else ""


def check_name(field: str, value: object, names: Collection[str], more: str = "") -> None:
    """Raise InputError for a value that is none of some names, with the one that may have been meant."""
    if value not in names:
        raise InputError(field, value, f"{did_you_mean(value, names)}one of {', '.join(names)}{more}")
