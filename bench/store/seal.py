"""A seal on a text file: no change of a bit passes for content, and only a regular file is read.

A sealed file is a JSON object whose first keys are its format and the SHA-256 of both together with all that follows:
``{"format":3,"sha256":"...",``. The seal says that a file is as it was written. It does not say by whom: whoever can
write a file can seal it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

HEAD = re.compile(rb'\{"format":(\d{1,6}),"sha256":"([0-9a-f]{64})",')
FORMAT = re.compile(rb'\s*\{\s*"format"\s*:\s*(\d{1,6})\b')
"""How a file begins that states its format, sealed or not."""


LONGEST_LINE = 2**24
"""Bytes; a description takes some thousand."""


class Unsealed(ValueError):
    """Why a file is not sealed content of the format that is read: the end of a sentence."""


class OtherFormat(Unsealed):
    """A file of another format; of an older one perhaps, which had no seal."""

    def __init__(self, found: int) -> None:
        super().__init__(f"of format {found}")
        self.found = found


def read_regular(path: Path) -> bytes:
    """The content of a file; raises OSError, also for what is no file: a pipe would be waited for without end."""
    with _opened(path) as file:
        return file.read()


def read_first_line(path: Path) -> bytes:
    """The first line of a file, of at most so many bytes; raises OSError as :func:`read_regular`."""
    with _opened(path) as file:
        return file.readline(LONGEST_LINE)


def _opened(path: Path) -> BinaryIO:
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    return os.fdopen(handle, "rb")


def write_new(path: Path, content: bytes) -> None:
    """Write a file that is not there yet and flush it to disk; raises OSError.

    Never through a symbolic link that somebody has left under its name. Its rights are what the umask leaves.
    """
    with path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sealed(number: int, text: str) -> bytes:
    """A JSON object's text, of at least one key and without blanks before it, under a seal of a format."""
    body = text[1:].encode("utf-8", "replace")  # a label may have been read from bytes that are no text
    return b'{"format":%d,"sha256":"%s",%s' % (number, _digest(number, body).encode(), body)


def unsealed_text(number: int, content: bytes) -> str:
    """The text that a file was sealed with in a format; raises Unsealed."""
    head = HEAD.match(content)
    if head is None or int(head[1]) != number:
        stated = head or FORMAT.match(content)
        if stated and int(stated[1]) != number:
            raise OtherFormat(int(stated[1]))
        raise Unsealed("not sealed")
    body = content[head.end() :]
    if _digest(number, body) != head[2].decode():
        raise Unsealed("its checksum is not that of its content")
    try:
        return "{" + body.decode()
    except UnicodeDecodeError:
        raise Unsealed("not JSON") from None


def unsealed(number: int, content: bytes) -> dict[str, Any]:
    """The object of a file sealed in a format; raises Unsealed, also where it is nested too deep."""
    return parsed(unsealed_text(number, content))


def parsed(text: str) -> dict[str, Any]:
    """The object of a JSON text; raises Unsealed."""
    try:
        found = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise Unsealed("not JSON") from None
    if not isinstance(found, dict):
        raise Unsealed("no JSON object")
    return found


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def _digest(number: int, body: bytes) -> str:
    return hashlib.sha256(b"%d\n%s" % (number, body)).hexdigest()
