"""Serves the screens as a page to the browser on this machine, and to nobody else.

textual-serve brings the page and the WebSocket that drives a process of ours for each visit. Around all of it stand
here: the loopback address; the Host that was meant, so that no name of others leads here; a token that opens once, for
a cookie; a path nobody can guess, as a cookie goes to every port of a host; for the WebSocket the Origin; and a policy
by which the page loads nothing from anywhere else and no other page may frame it.
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
    """textual-serve behind the gate; `tell` takes each address to print."""

    def __init__(self, command: str, listening: socket.socket, tell: Callable[[str], None]) -> None:
        self._host = f"{HOST}:{listening.getsockname()[1]}"
        super().__init__(command, public_url=f"http://{self._host}", title="shmgen view")
        self._path = f"/{secrets.token_urlsafe(12)}"
        self._key, self._token = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._listening, self._tell = listening, tell
        self._door = ExitStack()

    @property
    def address(self) -> str:
        return f"{self.public_url}/?token={self._token}"

    def door(self) -> str:
        """A file that leads to the address until somebody has come in: what a browser is started with, all can read.

        It is in the home folder and not hidden, as a browser from a snap reads no other.
        """
        file = tempfile.NamedTemporaryFile("w", prefix="shmgen-view-", suffix=".html", dir=Path.home())  # noqa: SIM115
        self._door.enter_context(file).write(f'<meta http-equiv="refresh" content="0; url={self.address}">')
        file.flush()
        return file.name

    @web.middleware
    async def guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Who may come in."""
        if request.headers.get("Host") != self._host:
            raise web.HTTPForbidden(text=f"open {self.public_url}/ as shmgen view has printed it")
        origin = request.headers.get("Origin")
        if origin not in (None, self.public_url) or (origin is None and request.path.endswith("/ws")):
            raise web.HTTPForbidden(text="another page asks for it")
        if request.path == "/" and _same(request.query.get("token", ""), self._token):
            return self._enter()
        if not _same(request.cookies.get(_COOKIE, ""), self._key):
            raise web.HTTPForbidden(text="open the address that shmgen view printed last: each opens once")
        return await handler(request)

    def _enter(self) -> web.Response:
        """No redirect: from a file, as from any other site, a browser would follow it without a strict cookie."""
        self._token = secrets.token_urlsafe(24)
        self._door.close()
        self._tell(f"opened; for another browser: {self.address}")
        answer = web.Response(headers={"Refresh": f"0; url={self._path}/"})
        answer.set_cookie(_COOKIE, self._key, httponly=True, samesite="Strict", path=f"{self._path}/")
        return answer

    async def finish(self, request: web.Request, response: web.StreamResponse) -> None:
        """The headers of every answer."""
        for name, value in _HEADERS.items():
            response.headers[name] = value.format(host=self._host)

    async def handle_index(self, request: web.Request) -> web.StreamResponse:
        """Without the font that textual-serve's page would have from the internet, and without an idle scroll bar."""
        page = await super().handle_index(request)
        page.text = _FOREIGN.sub("<style>.xterm-viewport { scrollbar-width: none }</style>", page.text)
        return cast(web.StreamResponse, page)

    def serve(self, debug: bool = False) -> None:
        """Until Ctrl-C or SIGTERM. No line for each request: the first has the token in it."""
        logging.basicConfig(level=logging.WARNING)
        with self._door:
            web.run_app(self._make_app(), sock=self._listening, print=None)

    async def on_startup(self, app: web.Application) -> None:
        """Says nothing: whoever made the socket has said where it is."""

    async def _make_app(self) -> web.Application:
        app = web.Application(middlewares=[self.guard])
        app.add_subapp(self._path, await super()._make_app())
        app.on_response_prepare.append(self.finish)
        return app


def _same(said: str, meant: str) -> bool:
    return hmac.compare_digest(said.encode(errors="replace"), meant.encode())
