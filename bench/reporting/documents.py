"""Fill numbers into documents and check their conclusions.

``{{ name }}`` is replaced by a number, and ``<!-- holds: name -->`` marks a sentence that depends on a conclusion. The
pages of docs/ are filled in when the site is built. README.md and the paper contain their numbers between comments,
``<!-- {{ name }} -->25<!-- / -->``, which ``python -m bench tables what=claims`` checks.
"""

from __future__ import annotations

import re
from pathlib import Path

from bench.errors import InputError
from bench.reporting.sentences import Facts

KEPT = re.compile(r"<!-- \{\{ (\w+) \}\} -->(.*?)<!-- / -->", re.DOTALL)
PLACE = re.compile(r"\{\{ (\w+) \}\}")
HOLDS = re.compile(r" *<!-- holds: (\w+) -->")
PAGES = ("README.md", "paper/*.md", "docs/**/*.md")
"""Documents with numbers, relative to the folder that contains ``results``."""


def documents(root: Path) -> dict[Path, str]:
    """Read the documents in a folder; raises InputError without a README.md, or for a page that cannot be read."""
    if not (root / "README.md").is_file():
        raise InputError("root", root, "a folder with a README.md; run the command in a clone")
    try:
        return {path: path.read_text("utf-8") for path in sorted({p for page in PAGES for p in root.glob(page)})}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("root", root, f"a page cannot be read: {error}") from None


def used(text: str) -> tuple[set[str], set[str]]:
    """Return the names of numbers and of conclusions in a text."""
    return set(PLACE.findall(text)), set(HOLDS.findall(text))


def rewritten(text: str, facts: Facts) -> str:
    """Return the text with every number between comments updated from the results."""
    return KEPT.sub(lambda place: f"<!-- {{{{ {place[1]} }}}} -->{facts.numbers.get(place[1], '?')}<!-- / -->", text)


def filled(text: str, facts: Facts) -> str:
    """Fill in the numbers and remove the marks; raises InputError for a text with :func:`problems`."""
    wrong = problems(text, facts)
    if wrong:
        raise InputError("documents", wrong[0], "see python -m bench tables what=claims")
    for pattern in (KEPT, PLACE):
        text = pattern.sub(lambda place: facts.numbers[place[1]], text)
    return HOLDS.sub("", text)


def problems(text: str, facts: Facts) -> list[str]:
    """List the problems of a text: unknown names, and conclusions that do not hold."""
    numbers, conclusions = used(text)
    return [
        *(f"no number is called {name}" for name in sorted(numbers - facts.numbers.keys())),
        *(f"no conclusion is called {name}" for name in sorted(conclusions - facts.conclusions.keys())),
        *(f"{name} does not hold" for name in sorted(conclusions) if not facts.conclusions.get(name, True)),
    ]
