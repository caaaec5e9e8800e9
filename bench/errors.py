"""The one error a user can cause: an input that names its field, its value and the remedy."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input. ``str(error)`` is one line: field, value, and what would be right.

    The command line prints that line and exits with status 2; nothing has run by then.
    """

    def __init__(self, field: str, value: object, remedy: str) -> None:
        self.field, self.value, self.remedy = field, value, remedy
        super().__init__(" ".join(f"{field}={value}: {remedy}".split()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        return type(self), (self.field, self.value, self.remedy)
