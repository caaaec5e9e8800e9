"""Everything that arrives in a store, counted by the kernel: a cell that is stored twice is seen twice."""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
from collections import Counter
from pathlib import Path

MOVED_TO = 0x80  # IN_MOVED_TO of inotify(7): how a whole cell arrives
EVENT = struct.Struct("iIII")


class Journal:
    """How often each cell was stored, from the moment that the journal is made (Linux: inotify)."""

    def __init__(self, folder: Path) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._handle = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self._libc.inotify_add_watch(self._handle, os.fsencode(folder), MOVED_TO) < 0:
            raise OSError(ctypes.get_errno(), "inotify_add_watch", str(folder))
        self._stored: Counter[str] = Counter()

    def stored(self) -> Counter[str]:
        """Times that each cell was stored so far, by identity."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._read(os.read(self._handle, 65536))
        return self._stored

    def _read(self, content: bytes) -> None:
        at = 0
        while at < len(content):
            length = EVENT.unpack_from(content, at)[3]
            name = content[at + EVENT.size : at + EVENT.size + length].rstrip(b"\0").decode()
            at += EVENT.size + length
            if name.endswith(".json"):
                self._stored[name.removesuffix(".json")] += 1


def held_claims(claims: Path) -> dict[str, int]:
    """Cells that are being computed, and the process that holds the claim of each (Linux: /proc/locks)."""
    inodes = {}
    with contextlib.suppress(OSError):
        for path in claims.glob("*.claim"):
            with contextlib.suppress(OSError):
                inodes[path.stat().st_ino] = path.stem
    held = {}
    for line in Path("/proc/locks").read_text(encoding="utf-8").splitlines():
        fields = line.split()
        if "FLOCK" in fields and "->" not in fields:
            inode = int(fields[5].rpartition(":")[2])
            if inode in inodes:
                held[inodes[inode]] = int(fields[4])
    return held
