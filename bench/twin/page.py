"""The live page, served to this machine only: motion, estimates with intervals, and alarms of the last samples.

The server listens on 127.0.0.1 only and serves five files and one stream of server-sent events with the last
:data:`KEPT` samples. It answers requests with the names of this machine only, as a protection against DNS rebinding.
Curves are drawn by uPlot (L. Sun, MIT licence), which is part of the package; the page loads nothing from elsewhere.
"""

from __future__ import annotations

import json
import mimetypes
import threading
import time
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from bench.contract.online import Layout
from bench.errors import InputError

HOST = "127.0.0.1"
NAMES = (HOST, "localhost", "[::1]")
MOST_THREADS, IDLE_S = 64, 30.0
"""Largest number of threads of the process for accepting a connection, and the timeout of an idle connection (s)."""
KEPT = 2000
SEND_S = 0.05
"""Interval between messages (s); samples that arrive within it are sent together."""
ASSETS = ("page.html", "page.js", "page.css", "uplot.js", "uplot.css")
POLICY = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; img-src data:"
"""Content security policy: nothing from other hosts; inline styles are required by uPlot."""


class PageServer:
    """Serves the page in background threads; ``url`` is its address."""

    def __init__(self, layout: Layout, port: int) -> None:
        self.head = {
            "system": layout.system.name,
            "sensors": [f"{s.measures} of DOF {s.dof + 1}" for s in layout.sensors],
            "quantities": [{"name": q.name, "unit": q.unit} for q in layout.quantities],
            "kept": KEPT,
        }
        self.kept: deque[str] = deque(maxlen=KEPT)
        self.count, self.ended = 0, False
        self.lock = threading.Lock()
        try:
            self._server = _Server((HOST, port), _Handler)
        except OSError as error:
            raise InputError("port", port, f"cannot be served: {error.strerror}; leave it out for a free one") from None
        self._server.page = self
        self.url = f"http://{HOST}:{self._server.server_port}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def add(self, report: dict[str, Any]) -> None:
        """Send a report to all open pages."""
        with self.lock:
            self.count += 1
            self.kept.append(json.dumps(report, allow_nan=False, separators=(",", ":")))

    def after(self, sent: int) -> tuple[int, list[str]]:
        """Return the number of reports so far, and the stored reports after the first ``sent``."""
        with self.lock:
            fresh = min(self.count - sent, len(self.kept))
            return self.count, list(self.kept)[len(self.kept) - fresh :]

    def close(self) -> None:
        """Stop the server after the last samples have been sent."""
        self.ended = True
        time.sleep(4 * SEND_S)
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    page: PageServer

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Limit the number of connections."""
        return threading.active_count() < MOST_THREADS

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing; an invalid request ends its connection."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = IDLE_S

    def do_GET(self) -> None:
        known = [f"{name}:{self.server.server_port}" for name in NAMES]
        host, origin = self.headers.get("Host"), self.headers.get("Origin")
        if host not in known or origin not in (None, *(f"http://{name}" for name in known)):
            return self.send_error(403, "only for pages of this machine")
        name = self.path.removeprefix("/") or "page.html"
        if name == "events":
            self._events(self.server.page)
        elif name in ASSETS:
            self._begin(f"{mimetypes.guess_type(name)[0]}; charset=utf-8")
            self.wfile.write(files("bench.twin").joinpath("assets", name).read_bytes())
        else:
            self.send_error(404)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Print nothing."""

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        for name, value in (("Content-Security-Policy", POLICY), ("X-Content-Type-Options", "nosniff")):
            self.send_header(name, value)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def _events(self, page: PageServer) -> None:
        """Send the stored reports, then new ones, several per message."""
        self._begin("text/event-stream")
        sent = 0
        try:
            self.wfile.write(f"event: head\ndata: {json.dumps(page.head)}\n\n".encode())
            while True:
                ended = page.ended  # read before the last reports are fetched
                sent, fresh = page.after(sent)
                if fresh:
                    self.wfile.write(f"data: [{','.join(fresh)}]\n\n".encode())
                elif ended:
                    self.wfile.write(b"event: end\ndata: 0\n\n")
                    return
                time.sleep(SEND_S)
        except OSError:  # the page was closed, or does not read
            return
