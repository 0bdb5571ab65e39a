"""A real headless Chromium, controlled through its DevTools protocol: pages, keys, clicks on words, pictures.

A terminal emulator reads the bytes of the page's WebSocket, and so finds the position of a text in `shmgen view`. The
visible canvas gives the place of that position in the window.
"""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import aiohttp
import pyte
import pytest


def find_chromium() -> str:
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("no Chromium: apt-get install chromium")
    return path


class Page:
    """A tab of 1280 by 800 pixels, or of the size that `resize` sets: `async with Page() as page`."""

    def __init__(self) -> None:
        self._program = find_chromium()
        self.asked: list[str] = []
        """Addresses that the page requested, including WebSockets."""
        self.screen = pyte.Screen(80, 24)
        """The terminal screen that the bytes of the newest WebSocket draw."""
        self._number = 0

    async def __aenter__(self) -> Page:
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        command = [
            *(self._program, "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"),
            *(f"--user-data-dir={self._folder.name}", "--window-size=1280,800", "--no-first-run", "about:blank"),
        ]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = Path(self._folder.name) / "DevToolsActivePort"
        for _ in range(600):
            if port.exists() and port.read_text().strip():
                break
            await asyncio.sleep(0.05)
        self._session = aiohttp.ClientSession()
        async with self._session.get(f"http://127.0.0.1:{port.read_text().split()[0]}/json/list") as answer:
            tabs = [tab for tab in await answer.json() if tab["type"] == "page"]
        self._socket = await self._session.ws_connect(tabs[0]["webSocketDebuggerUrl"], max_msg_size=0)
        await self.call("Network.enable")
        await self.call("Page.enable")
        await self.resize(1280, 800)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._socket.close()
        await self._session.close()
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        await self._socket.send_json({"id": self._number, "method": method, "params": parameters})
        while True:
            response = json.loads((await self._socket.receive(timeout=60)).data)
            if response.get("id") == self._number:
                return dict(response.get("result", response))
            self._handle_event(response.get("method", ""), response.get("params", {}))

    def _handle_event(self, method: str, parameters: dict[str, Any]) -> None:
        match method:
            case "Network.requestWillBeSent":
                self.asked.append(parameters["request"]["url"])
            case "Network.webSocketCreated":
                self.asked.append(parameters["url"])
                size = {name: int(values[0]) for name, values in parse_qs(urlsplit(parameters["url"]).query).items()}
                self.screen = pyte.Screen(size.get("width", 80), size.get("height", 24))
                self._terminal = pyte.ByteStream(self.screen)
            case "Network.webSocketFrameReceived" if parameters["response"]["opcode"] == 2:
                self._terminal.feed(base64.b64decode(parameters["response"]["payloadData"]))

    async def resize(self, width: int, height: int) -> None:
        size = {"width": width, "height": height}
        await self.call("Emulation.setDeviceMetricsOverride", **size, deviceScaleFactor=1, mobile=False)

    async def open(self, address: str) -> None:
        await self.call("Page.navigate", url=address)

    async def run(self, script: str) -> Any:
        """Evaluate an expression, await its result, and return the value."""
        response = await self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        return response.get("result", {}).get("value", response)

    async def press(self, *keys: str) -> None:
        codes = {"Enter": ("\r", 13), "ArrowDown": ("", 40), "Escape": ("", 27)}
        for key in keys:
            text, number = codes.get(key, (key, ord(key.upper()[0])))
            data = {"key": key, "windowsVirtualKeyCode": number, **({"text": text} if text else {})}
            await self.call("Input.dispatchKeyEvent", type="keyDown", **data)
            await self.call("Input.dispatchKeyEvent", type="keyUp", **data)
            await asyncio.sleep(0.05)

    async def until(self, text: str) -> tuple[int, int]:
        """Wait until the screen shows `text`. Return its line and column."""
        for _ in range(300):
            await self.run("document.body.classList.contains('-first-byte')")
            for number, line in enumerate(self.screen.display):
                if text in line:
                    return number, line.index(text)
            await asyncio.sleep(0.1)
        raise AssertionError(f"no {text!r} in\n" + "\n".join(self.screen.display))

    async def canvas(self) -> dict[str, float]:
        """Return the edges of the visible canvas in the window."""
        edges = "(({left, top, right, bottom}) => ({left, top, right, bottom}))"
        return dict(await self.run(f"{edges}(document.querySelector('.xterm-screen canvas').getBoundingClientRect())"))

    async def click_on(self, text: str) -> None:
        """Move the mouse to the middle of `text` on the canvas, and click."""
        (line, column), canvas = await self.until(text), await self.canvas()
        x = canvas["left"] + (column + len(text) / 2) * (canvas["right"] - canvas["left"]) / self.screen.columns
        y = canvas["top"] + (line + 0.5) * (canvas["bottom"] - canvas["top"]) / self.screen.lines
        await self.click(int(x), int(y))

    async def click(self, x: int, y: int) -> None:
        for type_ in ("mousePressed", "mouseReleased"):
            await self.call("Input.dispatchMouseEvent", type=type_, x=x, y=y, button="left", clickCount=1)

    async def picture(self, file: Path | None = None) -> bytes:
        """Return a PNG of the tab, and write it to `file` if given."""
        data = base64.b64decode((await self.call("Page.captureScreenshot", format="png"))["data"])
        if file:
            file.write_bytes(data)
        return data
