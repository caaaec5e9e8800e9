"""Child processes: what of the machine is looked at to know their memory."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from bench.isolation.descendants import descendants_of

ASLEEP = [sys.executable, "-c", "import sys; sys.stdin.read()"]
NESTED = [sys.executable, "-c", f"import subprocess; subprocess.run({ASLEEP!r})"]


def test_descendants_are_found_whichever_thread_started_them_and_however_deep() -> None:
    starter = subprocess.Popen(ASLEEP, stdin=subprocess.PIPE)
    with starter, ThreadPoolExecutor(1) as pool:
        assert descendants_of(starter.pid) == []
        nested = pool.submit(subprocess.Popen, NESTED, stdin=subprocess.PIPE, stdout=subprocess.PIPE).result()
        with nested:
            found: set[int] = set()
            while len(found) < 3:
                found = set(descendants_of(os.getpid()))
            assert {starter.pid, nested.pid} < found
            assert nested.stdin is not None
            nested.stdin.close()
        assert starter.stdin is not None
        starter.stdin.close()
