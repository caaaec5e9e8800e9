"""A checksum at the head of a text file, so that no change of a bit passes for content.

A sealed file is a JSON object whose first keys are its format and the SHA-256 of both together with all that follows:
``{"format":5,"sha256":"...",``. It shows that a file is as it was written, not by whom.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any, NoReturn

HEAD = re.compile(rb'\{"format":(\d{1,6}),"sha256":"([0-9a-f]{64})",')
FORMAT = re.compile(rb'\s*\{\s*"format"\s*:\s*(\d{1,6})\b')


class Unsealed(ValueError):
    """The reason why a file is not sealed content of the format that is read: the end of a sentence."""


def sealed(number: int, text: str) -> bytes:
    """Seal the text of a JSON object, of at least one key and without blanks before it, in a format."""
    body = text[1:].encode("utf-8", "replace")  # a label may have been read from bytes that are no text
    return b'{"format":%d,"sha256":"%s",%s' % (number, _digest(number, body), body)


def unsealed_text(number: int, content: bytes) -> str:
    """Return the text that was sealed in a format; raises Unsealed."""
    head = HEAD.match(content)
    stated = head or FORMAT.match(content)
    if stated and int(stated[1]) != number:
        raise Unsealed(f"of format {int(stated[1])}, this version reads {number}")
    if head is None:
        raise Unsealed("not sealed")
    body = content[head.end() :]
    if _digest(number, body) != head[2]:
        raise Unsealed("its checksum is not that of its content")
    return "{" + body.decode("utf-8", "replace")


def unsealed(number: int, content: bytes) -> dict[str, Any]:
    """Return the object that was sealed in a format; raises Unsealed, also where it is nested too deep."""
    return parsed(unsealed_text(number, content))


def parsed(text: str | bytes) -> dict[str, Any]:
    """Parse a JSON object; raises Unsealed."""
    try:
        value = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise Unsealed("not JSON") from None
    if not isinstance(value, dict):
        raise Unsealed("no JSON object")
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def _digest(number: int, body: bytes) -> bytes:
    return hashlib.sha256(b"%d\n%s" % (number, body)).hexdigest().encode()
