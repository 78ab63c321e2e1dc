"""A server for one person on this machine: loopback only, a secret in the address, five things it can do."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from flexmap_tasks.errors import FlexMapError
from flows.editor.review_session import ReviewSession
from flows.editor.session import EditSession

HOST = "127.0.0.1"
MOST_BYTES = 64 << 20
TIMEOUT_S = 30
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


Page = Callable[[], bytes]
Act = Callable[[dict[str, Any]], dict[str, Any]]


class EditServer(ThreadingHTTPServer):
    """Serves sessions; whoever does not know the token is refused, and so is a page of another origin."""

    daemon_threads = True

    def __init__(self, points: EditSession | None, review: ReviewSession | None, port: int = 0) -> None:
        """Listen on the loopback at `port`, or at one that is free when it is 0. Raises OSError where it is taken."""
        super().__init__((HOST, port), _Handler)
        self.token = secrets.token_urlsafe(24)
        self.pages: dict[str, Page] = {}
        self.acts: dict[str, Act] = {}
        if review is not None:
            self.pages |= {"review": review.page, "": review.page}
            self.acts["decide"] = review.save
        if points is not None:
            self.pages[""] = points.page
            self.acts |= {"preview": points.preview, "save": points.save}

    @property
    def origin(self) -> str:
        """Scheme, host and port."""
        return f"http://{HOST}:{self.server_address[1]}"

    @property
    def address(self) -> str:
        """What to open in the browser."""
        return f"{self.origin}/{self.token}/"


class _RefusedError(Exception):
    """A request that is not answered; carries the status."""

    def __init__(self, status: HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    server: EditServer
    timeout = TIMEOUT_S
    protocol_version = "HTTP/1.1"
    server_version = "flexmap"
    sys_version = ""

    def do_GET(self) -> None:
        """The page."""
        self._guarded(self._page)

    def do_POST(self) -> None:
        """A preview, or a save."""
        self._guarded(self._act)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name is the library's
        """Nothing: the address holds the secret."""

    def _guarded(self, answer: Callable[[str], tuple[str, bytes]]) -> None:
        try:
            kind, content = answer(self._route())
            self._reply(HTTPStatus.OK, kind, content)
        except _RefusedError as refused:
            self.close_connection = True
            self._reply(refused.status, "application/json", json.dumps({"error": str(refused)}).encode())
        except FlexMapError as error:
            self._reply(HTTPStatus.OK, "application/json", json.dumps({"error": str(error)}).encode())

    def _route(self) -> str:
        """What is asked for, behind the token."""
        if self.headers.get("Host") != self.server.origin.removeprefix("http://"):
            raise _RefusedError(HTTPStatus.FORBIDDEN)
        if self.headers.get("Origin", self.server.origin) != self.server.origin:
            raise _RefusedError(HTTPStatus.FORBIDDEN)
        token, slash, rest = self.path.removeprefix("/").partition("/")
        if not slash or not secrets.compare_digest(token.encode(), self.server.token.encode()):
            raise _RefusedError(HTTPStatus.FORBIDDEN)
        return rest

    def _page(self, route: str) -> tuple[str, bytes]:
        if route not in self.server.pages:
            raise _RefusedError(HTTPStatus.NOT_FOUND)
        try:
            return "text/html; charset=utf-8", self.server.pages[route]()
        except FlexMapError as error:
            return "text/plain; charset=utf-8", f"{error}\n".encode()

    def _act(self, route: str) -> tuple[str, bytes]:
        if route not in self.server.acts:
            raise _RefusedError(HTTPStatus.NOT_FOUND)
        if self.headers.get("Content-Type") != "application/json":
            raise _RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > MOST_BYTES:
            raise _RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        try:
            body = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            raise _RefusedError(HTTPStatus.BAD_REQUEST) from None
        if not isinstance(body, dict):
            raise _RefusedError(HTTPStatus.BAD_REQUEST)
        return "application/json", json.dumps(self.server.acts[route](body)).encode()

    def _reply(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)
