"""Turns the screens into a page of the browser on this machine, and lets nobody else have it.

textual-serve brings the page and the WebSocket that drives a process of ours for each visit. Around all of it stand
here: the loopback address; the Host that was meant, so that no name of others leads here; a token, which comes with the
first address and stays as a cookie; for the WebSocket the Origin; and a policy by which the page loads nothing from
anywhere else and no other page may frame it.
"""

from __future__ import annotations

import hmac
import logging
import re
import secrets
import socket
from collections.abc import Awaitable, Callable
from typing import Any, cast

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
_FOREIGN = re.compile(r"""<link[^>]*href=["']https?://[^>]*>""")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Gate:
    """Who may come in, and with which headers they go."""

    def __init__(self, port: int, token: str) -> None:
        self.host = f"{HOST}:{port}"
        self.token = token
        self._cookie = f"shmgen-view-{port}"

    def middleware(self) -> Any:
        """For aiohttp."""

        @web.middleware
        async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
            if request.headers.get("Host") != self.host:
                raise web.HTTPForbidden(text=f"open http://{self.host}/ as shmgen view has printed it")
            origin = request.headers.get("Origin")
            own = f"http://{self.host}"
            if origin not in (None, own) or (origin is None and request.path == "/ws"):
                raise web.HTTPForbidden(text="another page asks for it")
            if self._is(request.query.get("token", "")) and request.path == "/":
                entered = web.HTTPSeeOther("/")
                entered.set_cookie(self._cookie, self.token, httponly=True, samesite="Strict", path="/")
                raise entered
            if not self._is(request.cookies.get(self._cookie, "")):
                raise web.HTTPForbidden(text="open the address that shmgen view has printed, with its token")
            return await handler(request)

        return guard

    async def finish(self, request: web.Request, response: web.StreamResponse) -> None:
        """The headers of every answer."""
        for name, value in _HEADERS.items():
            response.headers[name] = value.format(host=self.host)

    def _is(self, said: str) -> bool:
        return hmac.compare_digest(said.encode(), self.token.encode())


class Page(Server):
    """textual-serve behind the gate."""

    def __init__(self, command: str, listening: socket.socket) -> None:
        port = listening.getsockname()[1]
        super().__init__(command, host=HOST, port=port, title="shmgen view")
        self._gate = Gate(port, secrets.token_urlsafe(24))
        self._listening = listening

    @property
    def address(self) -> str:
        return f"http://{self._gate.host}/?token={self._gate.token}"

    def initialize_logging(self) -> None:
        """No line for each request: the first has the token in it."""
        logging.basicConfig(level=logging.WARNING)

    async def handle_index(self, request: web.Request) -> web.StreamResponse:
        """Without the font that textual-serve's page would have from the internet."""
        page = await super().handle_index(request)
        page.text = _FOREIGN.sub("", page.text)
        return cast(web.StreamResponse, page)

    def serve(self, debug: bool = False) -> None:
        """Until Ctrl-C or SIGTERM."""
        self.initialize_logging()
        web.run_app(self._make_app(), sock=self._listening, print=None)

    async def on_startup(self, app: web.Application) -> None:
        """Says nothing: whoever made the socket has said where it is."""

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.middlewares.append(self._gate.middleware())
        app.on_response_prepare.append(self._gate.finish)
        return app


def listen(port: int) -> socket.socket:
    """On that port of this machine alone, or for 0 on one that is free. Raises OSError where it is taken."""
    made = socket.socket()
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((HOST, port))
        made.listen()
    except BaseException:
        made.close()
        raise
    return made
