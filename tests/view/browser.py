"""A real headless Chromium, driven by its DevTools protocol: pages, keys, clicks on words, pictures.

What stands where on the page of `shmgen view` is known from the bytes that its WebSocket brought, by a terminal of our
own; where that is in the window is asked of the canvas that is seen, not of what catches the mouse.
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


def program() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("no Chromium: apt-get install chromium")
    return found


class Page:
    """`async with Page() as page`: one tab, 1280 by 800 or as `resize` says."""

    def __init__(self) -> None:
        self._program = program()
        self.asked: list[str] = []
        """Addresses that the page asked for, WebSockets too."""
        self.screen = pyte.Screen(80, 24)
        """What a terminal shows of all that the newest WebSocket has brought."""
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
            said = json.loads((await self._socket.receive(timeout=60)).data)
            if said.get("id") == self._number:
                return dict(said.get("result", said))
            self._heed(said.get("method", ""), said.get("params", {}))

    def _heed(self, method: str, about: dict[str, Any]) -> None:
        match method:
            case "Network.requestWillBeSent":
                self.asked.append(about["request"]["url"])
            case "Network.webSocketCreated":
                self.asked.append(about["url"])
                size = {name: int(values[0]) for name, values in parse_qs(urlsplit(about["url"]).query).items()}
                self.screen = pyte.Screen(size.get("width", 80), size.get("height", 24))
                self._terminal = pyte.ByteStream(self.screen)
            case "Network.webSocketFrameReceived" if about["response"]["opcode"] == 2:
                self._terminal.feed(base64.b64decode(about["response"]["payloadData"]))

    async def resize(self, width: int, height: int) -> None:
        size = {"width": width, "height": height}
        await self.call("Emulation.setDeviceMetricsOverride", **size, deviceScaleFactor=1, mobile=False)

    async def open(self, address: str) -> None:
        await self.call("Page.navigate", url=address)

    async def run(self, script: str) -> Any:
        """The value of an expression, awaited."""
        said = await self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        return said.get("result", {}).get("value", said)

    async def press(self, *keys: str) -> None:
        codes = {"Enter": ("\r", 13), "ArrowDown": ("", 40), "Escape": ("", 27)}
        for key in keys:
            text, number = codes.get(key, (key, ord(key.upper()[0])))
            data = {"key": key, "windowsVirtualKeyCode": number, **({"text": text} if text else {})}
            await self.call("Input.dispatchKeyEvent", type="keyDown", **data)
            await self.call("Input.dispatchKeyEvent", type="keyUp", **data)
            await asyncio.sleep(0.05)

    async def until(self, text: str) -> tuple[int, int]:
        """The first line that shows it, and the column."""
        for _ in range(300):
            await self.run("document.body.classList.contains('-first-byte')")
            for number, line in enumerate(self.screen.display):
                if text in line:
                    return number, line.index(text)
            await asyncio.sleep(0.1)
        raise AssertionError(f"no {text!r} in\n" + "\n".join(self.screen.display))

    async def canvas(self) -> dict[str, float]:
        """Where in the window is what is drawn."""
        edges = "(({left, top, right, bottom}) => ({left, top, right, bottom}))"
        return dict(await self.run(f"{edges}(document.querySelector('.xterm-screen canvas').getBoundingClientRect())"))

    async def click_on(self, text: str) -> None:
        """Where a person sees it."""
        (line, column), drawn = await self.until(text), await self.canvas()
        x = drawn["left"] + (column + len(text) / 2) * (drawn["right"] - drawn["left"]) / self.screen.columns
        y = drawn["top"] + (line + 0.5) * (drawn["bottom"] - drawn["top"]) / self.screen.lines
        await self.click(int(x), int(y))

    async def click(self, x: int, y: int) -> None:
        for type_ in ("mousePressed", "mouseReleased"):
            await self.call("Input.dispatchMouseEvent", type=type_, x=x, y=y, button="left", clickCount=1)

    async def picture(self, file: Path | None = None) -> bytes:
        """PNG."""
        data = base64.b64decode((await self.call("Page.captureScreenshot", format="png"))["data"])
        if file:
            file.write_bytes(data)
        return data
