"""The page of a twin, served to this machine alone: the motion, each quantity with its band, alarms, as they come.

A server on 127.0.0.1, and nowhere else, has five files and one stream of server-sent events. It shows the last
:data:`KEPT` samples. It answers to the names of this machine alone, so that a page from elsewhere whose name is bound
to 127.0.0.1 anew (DNS rebinding) reads nothing. Curves are drawn by uPlot (L. Sun, MIT licence), which travels with the
package; the page may load nothing from elsewhere.
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
"""Of the process, beyond which a connection is closed at once; and time after which one that does nothing is."""
KEPT = 2000
SEND_S = 0.05
"""Time between two messages (s): samples that came meanwhile go together."""
ASSETS = ("page.html", "page.js", "page.css", "uplot.js", "uplot.css")
POLICY = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; img-src data:"
"""Nothing from elsewhere; the library of the curves sets styles on its elements."""


class PageServer:
    """Serve the page in threads; ``url`` is its address."""

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
        """Send a report to all who have the page open."""
        with self.lock:
            self.count += 1
            self.kept.append(json.dumps(report, allow_nan=False, separators=(",", ":")))

    def after(self, sent: int) -> tuple[int, list[str]]:
        """Return the number of reports so far, and those behind the first ``sent`` that are kept."""
        with self.lock:
            fresh = min(self.count - sent, len(self.kept))
            return self.count, list(self.kept)[len(self.kept) - fresh :]

    def close(self) -> None:
        """End the server, once the last samples are sent."""
        self.ended = True
        time.sleep(4 * SEND_S)
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    page: PageServer

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Take no more connections than a few people need."""
        return threading.active_count() < MOST_THREADS

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing: what is no request ends its connection."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = IDLE_S

    def do_GET(self) -> None:
        known = [f"{name}:{self.server.server_port}" for name in NAMES]
        host, origin = self.headers.get("Host"), self.headers.get("Origin")
        if host not in known or origin not in (None, *(f"http://{name}" for name in known)):
            return self.send_error(403, "for pages of this machine alone")
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
        """Send what is kept, then what comes, several samples a message."""
        self._begin("text/event-stream")
        sent = 0
        try:
            self.wfile.write(f"event: head\ndata: {json.dumps(page.head)}\n\n".encode())
            while True:
                ended = page.ended  # before the last look
                sent, fresh = page.after(sent)
                if fresh:
                    self.wfile.write(f"data: [{','.join(fresh)}]\n\n".encode())
                elif ended:
                    self.wfile.write(b"event: end\ndata: 0\n\n")
                    return
                time.sleep(SEND_S)
        except OSError:  # gone, or nothing is read there
            return
