"""Checksums of JSON files, which detect any damage.

The first keys of a sealed JSON object are the number of its format and the SHA-256 of this number and the rest of the
object: ``{"format":5,"sha256":"...",``. The checksum detects damage; it does not identify the author.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any, NoReturn

HEAD = re.compile(rb'\{"format":(\d{1,6}),"sha256":"([0-9a-f]{64})",')
FORMAT = re.compile(rb'\s*\{\s*"format"\s*:\s*(\d{1,6})\b')


class Unsealed(ValueError):
    """A file is damaged, or not of the expected format; the message gives the reason."""


def sealed(number: int, text: str) -> bytes:
    """Add format and checksum to the text of a JSON object with at least one key and no leading blanks."""
    body = text[1:].encode("utf-8", "replace")  # a label may contain bytes that are not UTF-8
    return b'{"format":%d,"sha256":"%s",%s' % (number, _digest(number, body), body)


def unsealed_text(number: int, content: bytes) -> str:
    """Return the text of a sealed object; raises Unsealed if it is damaged or of another format."""
    head = HEAD.match(content)
    stated = head or FORMAT.match(content)
    if stated and int(stated[1]) != number:
        raise Unsealed(f"it has format {int(stated[1])}, this version reads {number}")
    if head is None:
        raise Unsealed("it has no checksum")
    body = content[head.end() :]
    if _digest(number, body) != head[2]:
        raise Unsealed("its checksum does not match its content")
    return "{" + body.decode("utf-8", "replace")


def unsealed(number: int, content: bytes) -> dict[str, Any]:
    """Return a sealed object; raises Unsealed if it is damaged, of another format, or nested too deeply."""
    return parsed(unsealed_text(number, content))


def parsed(text: str | bytes) -> dict[str, Any]:
    """Parse a JSON object; raises Unsealed if it is invalid."""
    try:
        value = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise Unsealed("it is not JSON") from None
    if not isinstance(value, dict):
        raise Unsealed("it is not a JSON object")
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def _digest(number: int, body: bytes) -> bytes:
    return hashlib.sha256(b"%d\n%s" % (number, body)).hexdigest().encode()
