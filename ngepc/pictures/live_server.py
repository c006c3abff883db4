"""A local web server for a laboratory in the browser, without a notebook."""

from __future__ import annotations

import http.server
import json
import secrets
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from string import Template
from typing import Protocol

PAGE = Template(Path(__file__).with_name("live.html").read_text(encoding="utf-8"))


class ServedLaboratory(Protocol):
    """The methods of a laboratory that a page needs."""

    title: str
    script: str
    setup: dict

    def frames(self, values: Mapping[str, float]) -> Iterator[dict]:
        """The pictures for a position of the sliders."""


class LabServer(http.server.HTTPServer):
    """A page with a laboratory for the browser of this machine; nothing is fetched from elsewhere.

    The address contains a random secret.
    """

    def __init__(self, laboratory: ServedLaboratory, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), _Answers)
        self.laboratory = laboratory
        self.word = secrets.token_urlsafe(12)

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self.server_port}/{self.word}/"

    def run(self) -> None:
        """Answer until Ctrl-C."""
        with self:
            self.serve_forever()


class _Answers(http.server.BaseHTTPRequestHandler):
    """The page, its script and its first picture; then pictures, one JSON text on a line each."""

    server: LabServer

    def do_GET(self) -> None:
        """Answer with the page, its script or its data."""
        laboratory = self.server.laboratory
        setup = as_json(laboratory.setup)
        title = escape(laboratory.title or "laboratory")
        known = {
            "": ("text/html; charset=utf-8", PAGE.substitute(title=title)),
            "live.js": ("text/javascript; charset=utf-8", laboratory.script),
            "setup": ("application/json", setup),
        }
        page = self._asked()
        if page not in known:
            self.send_error(404)
            return
        kind, text = known[page]
        self._head(kind)
        self.wfile.write(text.encode())

    def do_POST(self) -> None:
        """Answer with frames, one line of JSON each."""
        if self._asked() != "frames":
            self.send_error(404)
            return
        length = int(self.headers["Content-Length"])
        message = json.loads(self.rfile.read(length))
        self._head("application/json-lines")
        for frame in self.server.laboratory.answers(message["values"]):
            self.wfile.write(f"{as_json(frame)}\n".encode())
            self.wfile.flush()

    def _asked(self) -> str | None:
        """The path of the request without the secret; None if the secret is missing."""
        _, word, *rest = self.path.split("/")
        known = secrets.compare_digest(word, self.server.word)
        return "/".join(rest) if known and rest else None

    def _head(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def log_message(self, form: str, *arguments: object) -> None:
        """Do not log requests."""


def as_json(data: dict) -> str:
    """A picture in JSON."""
    return json.dumps(data, default=float, allow_nan=False)


def json_ready(data: dict) -> dict:
    """A picture with Python's own numbers and lists."""
    return json.loads(as_json(data))
