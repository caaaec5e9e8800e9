"""The error for invalid input, with the field, its value and the remedy."""

from __future__ import annotations

from collections.abc import Collection

LONGEST_VALUE, LONGEST_LINE = 200, 1900
"""Largest number of characters of a value and of an error that are printed."""


class InputError(ValueError):
    """Invalid input. ``str(error)`` is one line: field, value, and the remedy.

    The command line prints this line and exits with status 2, before anything is computed.

    Args:
        field: Name of the field.
        value: Its value.
        remedy: What is wrong, or what would be valid.
    """

    def __init__(self, field: str, value: object, remedy: str) -> None:
        self.field, self.value, self.remedy = field, value, remedy
        super().__init__(" ".join(f"{field}={value}: {remedy}".split()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        return type(self), (self.field, self.value, self.remedy)


def line_of(error: InputError) -> str:
    """Return an error as one printable line of limited length."""
    line = f"{shortened(error.field)}={shortened(error.value)}: {shortened(error.remedy, LONGEST_LINE)}"
    return shortened(line, LONGEST_LINE)


def shortened(value: object, longest: int = LONGEST_VALUE) -> str:
    """Return a value as one line of at most ``longest`` printable characters, shortened in the middle."""
    text = " ".join(str(value).split())
    if len(text) > longest:
        text = f"{text[: longest - 60]}...{text[-50:]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text)


def did_you_mean(written: object, names: Collection[str]) -> str:
    """Return ``did you mean ls? `` with the most similar name, or an empty string if no name is similar."""
    from difflib import get_close_matches

    text = str(written)[:LONGEST_VALUE]
    near = get_close_matches(text, names, n=1, cutoff=0.6)
    if not near and len(text) == 2:  # two swapped letters have a similarity of only one half
        near = [name for name in names if name == text[::-1]]
    return f"did you mean {near[0]}? " if near else ""


def check_name(field: str, value: object, names: Collection[str], more: str = "") -> None:
    """Check that a value is one of some names.

    Args:
        field: Name of the field.
        value: Its value.
        names: Valid names.
        more: Text to append to the error.

    Raises:
        InputError: If the value is none of the names; it suggests the most similar one.
    """
    if value not in names:
        raise InputError(field, value, f"{did_you_mean(value, names)}one of {', '.join(names)}{more}")
