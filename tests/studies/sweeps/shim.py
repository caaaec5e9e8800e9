"""A disk that is slow, full or failing at will, and a clock that jumps: what a process sees through LD_PRELOAD.

A small library is compiled (``cc``) that stands before ``write``, ``fsync`` and ``rename`` of the C library: on files
below one folder they wait, or fail, as a control file says at that moment. The clock is libfaketime's, where it is
installed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>

/* The control file holds "delay_ms error": how long to wait, and the errno to fail with (0: none). */
static int fault(void) {
    const char *path = getenv("SHIM_CONTROL");
    FILE *file = path ? fopen(path, "re") : NULL;
    int delay = 0, error = 0;
    if (!file) return 0;
    if (fscanf(file, "%d %d", &delay, &error) < 1) delay = 0;
    fclose(file);
    if (delay > 0) usleep(1000 * delay);
    return error;
}

static int inside(const char *path) {
    const char *folder = getenv("SHIM_FOLDER");
    return folder && path && strncmp(path, folder, strlen(folder)) == 0;
}

static int ours(int fd) {
    char link[64], path[4096];
    int saved = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    errno = saved;
    if (n < 0) return 0;
    path[n] = 0;
    return inside(path);
}

#define REAL(name) ((typeof(&name))dlsym(RTLD_NEXT, #name))
#define FAIL(condition) if (condition) { int e = fault(); if (e) { errno = e; return -1; } }

ssize_t write(int fd, const void *data, size_t size) { FAIL(fd > 2 && ours(fd)) return REAL(write)(fd, data, size); }
ssize_t writev(int fd, const struct iovec *v, int n) { FAIL(fd > 2 && ours(fd)) return REAL(writev)(fd, v, n); }
int fsync(int fd) { FAIL(ours(fd)) return REAL(fsync)(fd); }
int fdatasync(int fd) { FAIL(ours(fd)) return REAL(fdatasync)(fd); }
int rename(const char *from, const char *to) { FAIL(inside(to)) return REAL(rename)(from, to); }
"""
FAKETIME = (
    "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
)


def why_not() -> str:
    """Why no shim can be made here; empty where one can."""
    return "" if shutil.which("cc") else "cc is not installed"


@dataclass(frozen=True)
class Shim:
    """The library in a folder, and the files that steer it."""

    folder: Path
    store: Path

    @staticmethod
    def made(folder: Path, store: Path) -> Shim:
        """Compile it."""
        source, library = folder / "shim.c", folder / "shim.so"
        source.write_text(SOURCE)
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        shim = Shim(folder, store)
        shim.disk()
        shim.clock(0)
        return shim

    @property
    def clock_jumps(self) -> bool:
        """Whether libfaketime is installed."""
        return any(Path(place).is_file() for place in FAKETIME)

    def environment(self) -> dict[str, str]:
        """What a process needs to run behind it."""
        fake = [place for place in FAKETIME if Path(place).is_file()][:1]
        return {
            "LD_PRELOAD": ":".join([str(self.folder / "shim.so"), *fake]),
            "SHIM_CONTROL": str(self.folder / "control"),
            "SHIM_FOLDER": str(self.store),
            "FAKETIME_TIMESTAMP_FILE": str(self.folder / "clock"),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "FAKETIME_DISABLE_SHM": "1",
        }

    def disk(self, delay_ms: int = 0, error: int = 0) -> None:
        """From now on: wait so long at every write, and fail with that number of errno."""
        self._put("control", f"{delay_ms} {error}\n")

    def clock(self, seconds: int) -> None:
        """From now on the time of day is off by so much."""
        self._put("clock", f"{seconds:+d}s\n")

    def _put(self, name: str, text: str) -> None:
        part = self.folder / f"{name}.part"
        part.write_text(text)
        os.replace(part, self.folder / name)
