"""`shmgen view`: the screens, the gate around the page, and the page in a real browser."""

from __future__ import annotations

import asyncio
import dataclasses
import math
import re
import subprocess
import sys
import threading

import aiohttp
import pytest

textual = pytest.importorskip("textual", reason="no Textual: pip install '.[view]'")

from textual.widgets import DataTable, TabbedContent, TextArea, Tree  # noqa: E402

from shmgen.config import Config  # noqa: E402
from shmgen.live.classes import ClassRegistry, publisher, subscriber  # noqa: E402
from shmgen.live.session import Session  # noqa: E402
from shmgen.tools.messages import parse  # noqa: E402
from shmgen.tools.watch import top  # noqa: E402
from shmgen.view.app import Viewer  # noqa: E402
from shmgen.view.curves import _thinned  # noqa: E402
from shmgen.view.memory import Memory  # noqa: E402
from shmgen.view.source import Source, stretches  # noqa: E402

from .browser import Page  # noqa: E402

HOSTILE = "[red]x[/red]<img src=x onerror=alert(1)>\x1b]0;hi\x07"


@pytest.fixture
def registry(tmp_path):
    return ClassRegistry(Session(Config(tmp_path)), None)


@pytest.fixture
def moving(topic, registry):
    """A pose that goes round, at 100 Hz, with a name that would like to be more than text."""
    kind, over = registry.message("geometry_msgs/msg/PoseStamped"), threading.Event()

    def publish():
        angle = 0.0
        while not over.wait(0.01):
            angle += 0.05
            position = {"x": math.sin(angle), "y": math.cos(angle), "z": 2.5}
            writer.publish(parse.build(kind, {"header": {"frame_id": HOSTILE}, "pose": {"position": position}}))

    with publisher(kind, topic, 3) as writer:
        thread = threading.Thread(target=publish)
        thread.start()
        yield topic
        over.set()
        thread.join()


async def until(pilot, condition):
    for _ in range(600):
        await pilot.pause(0.05)
        if condition():
            return
    raise AssertionError


def test_table_fields_curves_and_memory(moving, registry):
    async def walk():
        app = Viewer(registry, allow_write=False)
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(DataTable) and moving in app.screen.query_one(DataTable).rows)
            table = app.screen.query_one(DataTable)
            row = [str(cell) for cell in table.get_row(moving)]
            assert (row[0], row[1], row[2]) == ("ok", moving, "geometry_msgs/msg/PoseStamped")
            table.move_cursor(row=list(table.rows).index(moving))
            await pilot.press("enter")
            await until(pilot, lambda: app.screen.query(Tree))
            screen = app.screen
            labels = lambda: {path: str(node.label) for path, node in screen._fields.items()}  # noqa: E731
            await until(pilot, lambda: "2.5" in labels()["pose.position.z"])
            assert labels()["header.frame_id"].startswith("frame_id: '[red]x[/red]<img")
            assert "\x1b" not in labels()["header.frame_id"]
            node = screen._fields["pose.position.x"]
            screen.query_one(Tree).move_cursor(node)
            await pilot.press("enter")
            await until(pilot, lambda: len(screen._source.curves.get("pose.position.x", ())) > 10)
            await pilot.press("p", "+", "[")
            held = labels()
            await pilot.pause(0.5)
            assert labels() == held
            screen.query_one(TabbedContent).active = "memory"
            await until(pilot, lambda: screen.query_one(Memory).size.height > 3)
            line = screen.query_one(Memory).render_line(1).text
            assert line.startswith("       0  ")
            assert "[red]x" in line
            assert not screen.query(TextArea)
            await pilot.press("escape")
            await until(pilot, lambda: app.screen.query(DataTable))

    asyncio.run(walk())


def test_the_table_is_not_looked_after_where_nobody_sees_it_and_measures_only_what_is_wider(
    topic, registry, monkeypatch
):
    """Each narrower cell measures its whole column: with 200 regions that took most of a core."""

    async def walk():
        app = Viewer(registry, allow_write=False)
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(DataTable) and topic in app.screen.query_one(DataTable).rows)
            regions, looks, measured, update = app.screen, [], [], DataTable.update_cell
            mine = next(row for row in top.look({}) if row.topic == topic)

            def updated(self, row, column, value, *, update_width):
                measured.append((column, str(value), update_width))
                update(self, row, column, value, update_width=update_width)

            monkeypatch.setattr(DataTable, "update_cell", updated)
            for missed, wider in ((0, None), (1, False), (12_345_678, True), (7, False)):
                row = dataclasses.replace(mine, missed=missed)
                monkeypatch.setattr(top, "look", lambda past, row=row: looks.append(1) or [row])
                regions.look()
                assert wider is None or measured[-1] == ("MISSED", f"{missed:,}", wider)
                await pilot.pause()
            app.open(topic)
            await until(pilot, lambda: app.screen.query(Tree))
            looks.clear()
            regions.look()
            assert looks == []

    with publisher(registry.message("std_msgs/msg/Int32"), topic, 1):
        asyncio.run(walk())


def test_a_sample_by_hand_only_where_it_is_allowed(topic, registry):
    kind = registry.message("std_msgs/msg/Int32")

    async def walk():
        app = Viewer(registry, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(TextArea))
            said = app.screen.query_one("#said")
            app.screen.query_one(TabbedContent).active = "publish"
            for text, answer in (
                ("data: 7", "sample 1 is in the region"),
                ("data: x", "error: data: 'x' is str, not int32"),
            ):
                app.screen.query_one(TextArea).text = text
                await until(pilot, lambda: app.screen.query_one("#send").region.height > 0)
                await pilot.click("#send")
                await until(pilot, lambda answer=answer: str(said.render()).startswith(answer))

    with subscriber(kind, topic, 1) as reader:
        asyncio.run(walk())
        assert reader.read().data == 7


def test_a_source_follows_its_region(topic, registry, tmp_path):
    from ..support.command import run

    source = None
    for name, value in (("std_msgs/msg/Int32", 5), ("std_msgs/msg/Float64", 2.5)):
        kind = registry.message(name)
        with publisher(kind, topic, 1) as writer:
            writer.publish(kind(data=value))
            source = source or Source(topic, registry)
            assert source.look()
            assert source.message.data == value
            assert source.toggle("data")
            assert source.memory(16, 8).startswith(bytes(kind(data=value)))
        assert run(["clean", topic, "--force"], tmp_path).code == 0
    assert [path for _, _, path in stretches(source.layout, source.layouts)] == ["data"]
    source.close()
    points = [(float(x), float(x == 500)) for x in range(1000)]
    assert (500.0, 1.0) in _thinned(points, 40)
    assert len(_thinned(points, 40)) <= 40


@pytest.fixture
def page(tmp_path):
    """`shmgen view` in a folder without shmgen.toml: its address, with the token."""
    command = [sys.executable, "-m", "shmgen", "view", "--port", "0"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        yield process.stdout.readline().strip()
        process.terminate()
        assert "token" not in process.stdout.read()
        assert process.wait(10) == 0


def test_nobody_else_gets_in(page):
    address, _, token = page.partition("/?token=")
    own = {"Cookie": f"shmgen-view-{address.rpartition(':')[2]}={token}"}
    cases = [
        ("/", {}, 403),
        ("/?token=guessed", {}, 403),
        (f"/?token={token}", {}, 303),
        ("/", own, 200),
        ("/", own | {"Host": "evil.example"}, 403),
        ("/", own | {"Origin": "http://evil.example"}, 403),
        ("/", own | {"Origin": "null"}, 403),
        ("/static/js/textual.js", {}, 403),
        ("/ws", own, 403),
        ("/ws", own | {"Origin": "http://evil.example"}, 403),
        ("/ws", {"Origin": address}, 403),
        ("/ws", own | {"Origin": address}, 101),
    ]
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}

    async def knock():
        async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar()) as session:
            for path, headers, wanted in cases:
                if path == "/ws":
                    headers = headers | upgrade | {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
                async with session.get(address + path, headers=headers, allow_redirects=False) as answer:
                    assert answer.status == wanted, (path, headers)
                    if wanted == 101:
                        answer.close()
                        continue
                    assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
                    assert "Access-Control-Allow-Origin" not in answer.headers
                    if wanted == 303:
                        cookie = answer.headers["Set-Cookie"]
                        assert "HttpOnly" in cookie
                        assert "SameSite=Strict" in cookie
                    if wanted == 200:
                        assert not re.findall(
                            r"https?://(?!127\.0\.0\.1)",
                            (await answer.text()).replace("http://www.w3.org/2000/svg", ""),
                        )

    asyncio.run(knock())


@pytest.mark.slow
def test_in_a_real_browser(moving, page, tmp_path):
    """All comes from this machine; what is drawn changes; a page of another origin gets nothing."""
    address = page.partition("/?")[0]

    async def walk():
        async with Page() as browser:
            await browser.open(page)
            for _ in range(100):
                if await browser.run("document.body.classList.contains('-first-byte')") is True:
                    break
                await asyncio.sleep(0.2)
            await asyncio.sleep(2)
            first = await browser.picture(tmp_path / "regions.png")
            assert await browser.run("location.href") == f"{address}/"
            await browser.click(300, 60)
            await browser.press("Enter")
            await asyncio.sleep(2)
            second = await browser.picture(tmp_path / "region.png")
            assert len({first, second}) == 2
            assert min(map(len, (first, second))) > 8000
            assert all(asked.startswith((address, address.replace("http", "ws"))) for asked in browser.asked), (
                browser.asked
            )
            assert any("/ws?" in asked for asked in browser.asked)
            await browser.open("data:text/html,<p>elsewhere")
            await asyncio.sleep(0.5)
            stolen = f"fetch('{address}/').then(a => a.text(), e => 'refused')"
            assert await browser.run(stolen) == "refused"
            socket = (
                f"new Promise(done => {{ const s = new WebSocket('{address.replace('http', 'ws')}/ws');"
                "s.onopen = () => done('open'); s.onerror = () => done('refused'); })"
            )
            assert await browser.run(socket) == "refused"

    asyncio.run(walk())


def test_without_the_extra_it_says_what_to_install(tmp_path, monkeypatch):
    from ..support.command import run

    monkeypatch.setitem(sys.modules, "textual", None)
    said = run(["view"], tmp_path)
    assert (said.code, said.stdout) == (1, "")
    assert "pip install '.[view]'" in said.stderr


def test_the_picture_of_the_latency_is_that_of_the_page():
    """The screens are drawn anew by hand: `make pictures`."""
    from ..rigs.pictures import DOCS, latency

    assert latency((DOCS / "performance.md").read_text()) == (DOCS / "latency.svg").read_text()
    assert "url(" not in re.sub(r"url\(#[\w-]+\)", "", (DOCS / "top.svg").read_text())
    assert (DOCS / "view.gif").stat().st_size < 300_000
