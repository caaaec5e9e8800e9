"""Headless Chromium by the DevTools protocol over a pipe, without a driver (chromedevtools.github.io)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

PROGRAM = shutil.which("chromium") or shutil.which("google-chrome") or ""
ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--remote-debugging-pipe",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # no name can be resolved
)  # fmt: skip


class Browser:
    """A window with one page; ``events`` are what it has reported."""

    def __init__(self, profile: Path) -> None:
        (reading, to_us), (to_it, self._writing) = os.pipe(), os.pipe()
        connected = ["bash", "-c", f'exec "$@" 3<&{to_it} 4>&{to_us} 2>/dev/null', "bash", PROGRAM, *ARGUMENTS]
        self._process = subprocess.Popen([*connected, f"--user-data-dir={profile}"], pass_fds=(to_it, to_us))
        for end in (to_it, to_us):
            os.close(end)
        self._answers, self._sent, self._page = os.fdopen(reading, "rb"), 0, {}
        self.events: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._page = {"sessionId": self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]}
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **values: Any) -> dict[str, Any]:
        """Send a command, and wait for its answer."""
        self._sent += 1
        command = {"id": self._sent, "method": method, "params": values, **self._page}
        os.write(self._writing, json.dumps(command).encode() + b"\0")
        while True:
            letters = bytearray()
            while (letter := self._answers.read(1)) != b"\0":
                assert letter, "the browser has ended"
                letters += letter
            answer = json.loads(letters)
            if answer.get("id") == self._sent:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self.events.append(answer)

    def run(self, script: str) -> Any:
        """The value of an expression in the page; of a promise, what it becomes."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until a condition holds in the page; fails after ten seconds."""
        ask = f"setInterval(() => {{ if ({condition}) yes(); }}, 20)"
        self.run(f"new Promise((yes, no) => {{ {ask}; setTimeout(() => no({json.dumps(condition)}), 10000); }})")

    def visit(self, address: str) -> None:
        """Open a page anew, and wait until it is whole."""
        for url in ("about:blank", address):
            self.call("Page.navigate", url=url)
        self.wait("document.readyState === 'complete'")

    def close(self) -> None:
        """End the program."""
        self._process.terminate()
        self._process.wait()
        self._answers.close()
        os.close(self._writing)
