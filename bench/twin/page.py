"""The page of a twin, served to this machine alone: the motion, each quantity with its band, alarms, as they come.

aiohttp serves four files and one stream of server-sent events, on 127.0.0.1 and nowhere else. What is shown is bounded:
the last :data:`KEPT` samples. Curves are drawn by uPlot (L. Sun, MIT licence), which travels with the package; the
page may load nothing from elsewhere.
"""

from __future__ import annotations

import asyncio
import json
import threading
from collections import deque
from importlib.resources import files
from typing import Any

from aiohttp import web

from bench.contract.online import Layout
from bench.errors import InputError

HOST = "127.0.0.1"
KEPT = 2000
SEND_S = 0.05
"""Between two messages: samples that came meanwhile go together."""
ASSETS = {
    "page.js": "text/javascript", "page.css": "text/css", "uplot.js": "text/javascript", "uplot.css": "text/css",
}  # fmt: skip
POLICY = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; img-src data:"
"""Nothing from elsewhere; the library of the curves sets styles on its elements."""


class Page:
    """Serves the page in a thread of its own; ``url`` is where."""

    def __init__(self, layout: Layout, port: int) -> None:
        self.layout = layout
        self.kept: deque[tuple[int, str]] = deque(maxlen=KEPT)
        self.count = 0
        self._lock, self._ready = threading.Lock(), threading.Event()
        self._ended = False
        self._error: OSError | None = None
        self._port = port
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise InputError("port", port, f"cannot be served: {self._error.strerror}; leave it out for a free one")

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self._port}/"

    def add(self, found: dict[str, Any]) -> None:
        """Take an answer in; whoever has the page open is sent it."""
        text = json.dumps(found, allow_nan=False, separators=(",", ":"))
        with self._lock:
            self.count += 1
            self.kept.append((self.count, text))

    def close(self) -> None:
        """End the server, after those who look have been sent the last samples."""
        self._ended = True
        self._thread.join(5.0)

    def _serve(self) -> None:
        asyncio.run(self._served())

    async def _served(self) -> None:
        app = web.Application()
        app.router.add_get("/", self._index)
        app.router.add_get("/events", self._events)
        app.router.add_get("/{name}", self._asset)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.5)
        try:
            await runner.setup()
            await web.TCPSite(runner, HOST, self._port).start()
            self._port = runner.addresses[0][1]
            self._ready.set()
            while not self._ended:
                await asyncio.sleep(SEND_S)
            await asyncio.sleep(4 * SEND_S)
        except OSError as error:
            self._error = error
        finally:
            self._ready.set()
            await runner.cleanup()

    async def _index(self, _: web.Request) -> web.Response:
        return _response("page.html", "text/html")

    async def _asset(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in ASSETS:
            raise web.HTTPNotFound
        return _response(name, ASSETS[name])

    async def _events(self, request: web.Request) -> web.StreamResponse:
        """Everything that is kept, then what comes, several samples a message."""
        response = web.StreamResponse(headers={"Content-Type": "text/event-stream", "Cache-Control": "no-store"})
        await response.prepare(request)
        head = {
            "system": self.layout.system.name,
            "sensors": [f"{s.measures} of DOF {s.dof + 1}" for s in self.layout.sensors],
            "quantities": [{"name": q.name, "unit": q.unit} for q in self.layout.quantities],
            "kept": KEPT,
        }
        await response.write(f"event: head\ndata: {json.dumps(head)}\n\n".encode())
        sent = 0
        try:
            while True:
                with self._lock:
                    fresh = [text for number, text in self.kept if number > sent] if self.count > sent else []
                    sent = self.count
                if fresh:
                    await response.write(f"data: [{','.join(fresh)}]\n\n".encode())
                elif self._ended:
                    await response.write(b"event: end\ndata: 0\n\n")
                    return response
                await asyncio.sleep(SEND_S)
        except (ConnectionError, asyncio.CancelledError):
            return response


def _response(name: str, kind: str) -> web.Response:
    text = files("bench.twin").joinpath("assets", name).read_text(encoding="utf-8")
    headers = {"Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff", "Cache-Control": "no-store"}
    return web.Response(text=text, content_type=kind, headers=headers)
