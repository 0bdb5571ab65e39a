"""Serves the screens as a web page to one user of this machine, and to nobody else.

textual-serve provides the page, and a WebSocket that runs one shmgen process for each visit. This module adds the
protection:

* The server listens on the loopback address only.
* The server checks the Host header, so that no other site reaches the page through a DNS name (DNS rebinding).
* A token in the address works once and sets a cookie.
* The path is random, because a browser sends a cookie to every port of a host.
* The server checks the Origin header of the WebSocket.
* The content security policy of the page blocks resources of other sites and frames in other pages.
"""

from __future__ import annotations

import hmac
import logging
import re
import secrets
import socket
import tempfile
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from pathlib import Path
from typing import cast

from aiohttp import web
from textual_serve.server import Server

HOST = "127.0.0.1"
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        "font-src 'self' data:; img-src 'self' data:; connect-src 'self' ws://{host}; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_FOREIGN = re.compile(rf"""<link[^>]*href=["']https?://(?!{re.escape(HOST)}:)[^>]*>""")
_COOKIE = "shmgen-view"
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Page(Server):
    """The web server of `shmgen view`: textual-serve behind an access check. `tell` prints a line for the user."""

    def __init__(self, command: str, listening: socket.socket, tell: Callable[[str], None]) -> None:
        self._host = f"{HOST}:{listening.getsockname()[1]}"
        super().__init__(command, public_url=f"http://{self._host}", title="shmgen view")
        self._path = f"/{secrets.token_urlsafe(12)}"
        self._key, self._token = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._listening, self._tell = listening, tell
        self._redirect_files = ExitStack()

    @property
    def address(self) -> str:
        return f"{self.public_url}/?token={self._token}"

    def create_redirect_file(self) -> str:
        """Create a file that redirects a browser to the secret address, and return its path.

        The browser gets the file instead of the address, because all users can read the arguments of a process. The
        file is in the home folder and not hidden, because a browser installed as a snap reads no other folder. The file
        is removed at the first visit.
        """
        file = tempfile.NamedTemporaryFile("w", prefix="shmgen-view-", suffix=".html", dir=Path.home())  # noqa: SIM115
        self._redirect_files.enter_context(file).write(f'<meta http-equiv="refresh" content="0; url={self.address}">')
        file.flush()
        return file.name

    @web.middleware
    async def guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Handle a request with the right host, origin, and token or cookie; reject other requests with status 403."""
        if request.headers.get("Host") != self._host:
            raise web.HTTPForbidden(text=f"open the address that shmgen view printed: {self.public_url}/")
        origin = request.headers.get("Origin")
        if origin not in (None, self.public_url) or (origin is None and request.path.endswith("/ws")):
            raise web.HTTPForbidden(text="requests from other pages are refused")
        if request.path == "/" and _same(request.query.get("token", ""), self._token):
            return self._enter()
        if not _same(request.cookies.get(_COOKIE, ""), self._key):
            raise web.HTTPForbidden(text="open the address that shmgen view printed last: each address works once")
        return await handler(request)

    def _enter(self) -> web.Response:
        """Answer a visit with a valid token: set the cookie, and send the browser to the page by a Refresh header.

        The cookie has SameSite=Strict. With an ordinary redirect, a browser that comes from a file or another site
        would send the next request without the cookie.
        """
        self._token = secrets.token_urlsafe(24)
        self._redirect_files.close()
        self._tell(f"the page was opened; address for another browser: {self.address}")
        answer = web.Response(headers={"Refresh": f"0; url={self._path}/"})
        answer.set_cookie(_COOKIE, self._key, httponly=True, samesite="Strict", path=f"{self._path}/")
        return answer

    async def finish(self, request: web.Request, response: web.StreamResponse) -> None:
        """Add the security headers to each response."""
        for name, value in _HEADERS.items():
            response.headers[name] = value.format(host=self._host)

    async def handle_index(self, request: web.Request) -> web.StreamResponse:
        """Serve the page without the web font of textual-serve and without an unused scroll bar.

        The web font would be loaded from the internet.
        """
        page = await super().handle_index(request)
        page.text = _FOREIGN.sub("<style>.xterm-viewport { scrollbar-width: none }</style>", page.text)
        return cast(web.StreamResponse, page)

    def serve(self, debug: bool = False) -> None:
        """Serve until Ctrl-C or SIGTERM. Log no requests: the first request contains the token."""
        logging.basicConfig(level=logging.WARNING)
        with self._redirect_files:
            web.run_app(self._make_app(), sock=self._listening, print=None)

    async def on_startup(self, app: web.Application) -> None:
        """Print nothing. textual-serve would print the address, but the caller has already printed it."""

    async def _make_app(self) -> web.Application:
        app = web.Application(middlewares=[self.guard])
        app.add_subapp(self._path, await super()._make_app())
        app.on_response_prepare.append(self.finish)
        return app


def _same(received: str, expected: str) -> bool:
    return hmac.compare_digest(received.encode(errors="replace"), expected.encode())
