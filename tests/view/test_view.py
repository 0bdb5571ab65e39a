"""`shmgen view`: the screens, the gate around the page, and the page in a real browser."""

from __future__ import annotations

import asyncio
import dataclasses
import math
import os
import re
import shutil
import stat
import struct
import subprocess
import sys
import threading
from contextlib import AsyncExitStack, ExitStack, contextmanager
from pathlib import Path

import aiohttp
import pytest
from aiohttp import web

from ..support import import_or_skip
from ..support.build import put

textual = import_or_skip("textual", reason="no Textual: pip install '.[view]'")

from textual.widgets import DataTable, TabbedContent, TextArea, Tree  # noqa: E402

from shmgen.config import Config  # noqa: E402
from shmgen.config.entries import Bounds  # noqa: E402
from shmgen.live.classes import ClassRegistry, publisher, subscriber  # noqa: E402
from shmgen.live.session import Session  # noqa: E402
from shmgen.runtime import region_name  # noqa: E402
from shmgen.runtime.region.names import region_file  # noqa: E402
from shmgen.tools.messages import parse  # noqa: E402
from shmgen.tools.watch import overview  # noqa: E402
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
def first(topic):
    """A topic above those of other tests, which come and go: no row moves between a look and a click."""
    name = topic.replace("/shmgen_test/", "/a_click/")
    yield name
    for file in Path("/dev/shm").glob(f"*{name[1:].replace('/', '.')}*"):
        file.unlink()


@pytest.fixture
def moving(first, registry):
    """A pose that goes round, at 100 Hz, with a name that would like to be more than text."""
    kind, over = registry.message("geometry_msgs/msg/PoseStamped"), threading.Event()

    def publish():
        angle = 0.0
        while not over.wait(0.01):
            angle += 0.05
            position = {"x": math.sin(angle), "y": math.cos(angle), "z": 2.5}
            writer.publish(parse.build(kind, {"header": {"frame_id": HOSTILE}, "pose": {"position": position}}))

    with publisher(kind, first, 3) as writer:
        thread = threading.Thread(target=publish)
        thread.start()
        yield first
        over.set()
        thread.join()


async def until(pilot, condition):
    for _ in range(600):
        await pilot.pause(0.05)
        if condition():
            return
    raise AssertionError


def nodes(screen):
    """The lines of the tree by their paths, those of closed arrays too."""
    waiting, found = [screen.query_one(Tree).root], {}
    while waiting:
        node = waiting.pop()
        waiting += node.children
        found |= {node.data.path: node} if node.data and not node.data.is_more else {}
    return found


def test_table_fields_curves_and_memory(moving, registry):
    async def walk():
        app = Viewer(registry, allow_write=False)
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(DataTable) and moving in app.screen.query_one(DataTable).rows)
            table = app.screen.query_one(DataTable)
            row = [str(cell) for cell in table.get_row(moving)]
            assert (row[0], row[1], row[4]) == ("ok", moving, "geometry_msgs/msg/PoseStamped")
            table.move_cursor(row=list(table.rows).index(moving))
            await pilot.press("enter")
            await until(pilot, lambda: app.screen.query(Tree))
            screen = app.screen
            labels = lambda: {path: str(node.label) for path, node in nodes(screen).items()}  # noqa: E731
            await until(pilot, lambda: "2.5" in labels()["pose.position.z"])
            assert labels()["header.frame_id"].startswith("frame_id: '[red]x[/red]<img")
            assert "\x1b" not in labels()["header.frame_id"]
            node = nodes(screen)["pose.position.x"]
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


@pytest.mark.slow
def test_fields_on_the_command_line_are_plotted_at_once(moving, registry):
    async def walk():
        app = Viewer(registry, allow_write=False, topic=moving, fields=("pose.position.x", "header.frame_id"))
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(Tree))
            curves = app.screen._source.curves
            await until(pilot, lambda: len(curves.get("pose.position.x", ())) > 3)
            assert list(curves) == ["pose.position.x"]
            await until(pilot, lambda: len(app._notifications) > 0)
            assert [notice.message for notice in app._notifications] == [
                "header.frame_id is no longer plotted, or is not a number"
            ]

    asyncio.run(walk())


@pytest.mark.slow
def test_the_table_is_not_looked_after_where_nobody_sees_it_and_measures_only_what_is_wider(
    topic, registry, monkeypatch
):
    """Each narrower cell measures its whole column: with 200 regions that took most of a core."""

    async def walk():
        app = Viewer(registry, allow_write=False)
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(DataTable) and topic in app.screen.query_one(DataTable).rows)
            regions, looks, measured, update = app.screen, [], [], DataTable.update_cell
            mine = next(row for row in overview.look({}) if row.topic == topic)

            def updated(self, row, column, value, *, update_width):
                measured.append((column, str(value), update_width))
                update(self, row, column, value, update_width=update_width)

            monkeypatch.setattr(DataTable, "update_cell", updated)
            for missed, wider in ((0, None), (1, False), (12_345_678, True), (7, False)):
                row = dataclasses.replace(mine, missed=missed)
                monkeypatch.setattr(overview, "look", lambda past, row=row: looks.append(1) or [row])
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


@pytest.fixture
def joints(tmp_path):
    """Knows JointState with a sequence of up to 1,000 names, and a message of float32."""
    put(
        {
            "msgs/f_msgs/msg/F.msg": "float32 x\nfloat32[2] fixed\nfloat32[<=9] many\nCell[<=9] cells\n",
            "msgs/f_msgs/msg/Cell.msg": "float32[<=3] v\nstring<=9 name\n",
        },
        tmp_path,
    )
    bounds = Bounds({}, {}, 16, 1000)
    return ClassRegistry(Session(Config(tmp_path, path=(tmp_path / "msgs",), bounds=bounds)), None)


@pytest.mark.slow
def test_arrays_and_sequences_open_and_their_elements_are_plotted(topic, joints):
    """Six joints, then four, then a thousand; elements come a page at a time."""
    kind = joints.message("sensor_msgs/msg/JointState")

    async def walk(writer):
        app = Viewer(joints, allow_write=False, topic=topic)
        async with app.run_test(size=(120, 60)) as pilot:
            await until(pilot, lambda: app.screen.query(Tree) and "position" in nodes(app.screen))
            screen, tree = app.screen, app.screen.query_one(Tree)
            label = lambda path: str(nodes(screen)[path].label) if path in nodes(screen) else ""  # noqa: E731
            await until(pilot, lambda: label("position") == "position: 6 elements, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]")
            assert label("effort") == "effort: 0 elements"
            tree.move_cursor(nodes(screen)["position"])
            await pilot.press("enter")
            await until(pilot, lambda: label("position[5]") == "[5]: 0.5")
            for _ in range(3):
                await pilot.press("down", "enter")
            writer.publish(kind(position=[1.0] * 6))
            await until(pilot, lambda: all(screen._source.curves.get(f"position[{it}]") for it in range(3)))
            await until(pilot, lambda: label("position[0]") == "● [0]: 1.0")
            writer.publish(kind(position=[2.0] * 4))
            await until(pilot, lambda: "position[4]" not in nodes(screen))
            writer.publish(kind(position=[3.0] * 1000))
            await until(pilot, lambda: "position[99]" in nodes(screen))
            node = nodes(screen)["position"]
            assert "position[100]" not in nodes(screen)
            assert str(node.children[-1].label) == "… 900 more: Enter shows 100 of them"
            tree.move_cursor(node.children[-1])
            await pilot.press("enter")
            await until(pilot, lambda: label("position[199]") != "")
            assert str(node.children[-1].label) == "… 800 more: Enter shows 100 of them"

    with publisher(kind, topic, 1) as writer:
        writer.publish(kind(name=list("abcdef"), position=[it / 10 for it in range(6)]))
        asyncio.run(walk(writer))


@pytest.mark.slow
def test_messages_in_arrays_open_too_and_a_float32_has_its_own_digits(topic, joints):
    kind = joints.message("f_msgs/msg/F")

    async def walk():
        app = Viewer(joints, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 60)) as pilot:
            await until(pilot, lambda: app.screen.query(Tree) and "x" in nodes(app.screen))
            screen = app.screen
            label = lambda path: str(nodes(screen)[path].label) if path in nodes(screen) else ""  # noqa: E731
            await until(pilot, lambda: label("x") == "x: 0.01")
            assert label("fixed") == "fixed: 2 elements, [0.1, 3.4028235e+38]"
            for path in ("cells", "cells[1]", "cells[1].v"):
                await until(pilot, lambda path=path: path in nodes(screen))
                nodes(screen)[path].expand()
            await until(pilot, lambda: label("cells[1].v[2]") == "[2]: 0.7")
            assert "x: 0.01\n" in screen.query_one(TextArea).text

    cell = joints.message("f_msgs/msg/Cell")
    with publisher(kind, topic, 1) as writer:
        cells = [cell(), cell(v=[0.5, 0.6, 0.7], name="b")]
        writer.publish(kind(x=0.01, fixed=[0.1, 3.4028234e38], many=[0.1], cells=cells))
        asyncio.run(walk())


def test_a_damaged_count_is_shown_and_ends_nothing(topic, joints):
    kind, cell = joints.message("f_msgs/msg/F"), joints.message("f_msgs/msg/Cell")

    async def walk():
        app = Viewer(joints, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 60)) as pilot:
            for path in ("cells", "cells[0]"):
                await until(pilot, lambda path=path: app.screen.query(Tree) and path in nodes(app.screen))
                nodes(app.screen)[path].expand()
            line = lambda: str(nodes(app.screen)["cells[0].v"].label)  # noqa: E731
            await until(pilot, lambda: line().startswith("v: damaged: ") and "4,294,967,295" in line())
            assert "x: 0.0\n" in app.screen.query_one(TextArea).text

    with publisher(kind, topic, 1) as writer:
        writer.publish(kind(x=0.01, cells=[cell(v=[0.5, 0.6, 0.7])]))
        file = Path(region_file(region_name(topic)))
        data, sample = file.read_bytes(), struct.pack("<I3f", 3, 0.5, 0.6, 0.7)
        assert data.count(sample) == 1
        with file.open("r+b") as region:
            region.seek(data.index(sample))
            region.write(b"\xff" * 4)
        asyncio.run(walk())


@pytest.mark.slow
def test_select_all_and_type_replaces_the_draft(topic, registry):
    kind = registry.message("std_msgs/msg/Bool")

    async def walk():
        app = Viewer(registry, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(TextArea))
            screen = app.screen
            screen.query_one(TabbedContent).active = "publish"
            offered = lambda: {it.binding.action for it in screen.active_bindings.values() if it.enabled}  # noqa: E731
            assert {"pause", "leave"} <= offered()
            screen.query_one(TextArea).focus()
            await until(pilot, lambda: screen.focused is screen.query_one(TextArea))
            assert not {"pause", "leave", "zoom(2)"} & offered()
            assert "select_all" in offered()
            await pilot.press("ctrl+a", *"data: true")
            assert screen.query_one(TextArea).text == "data: true"
            screen.query_one(Tree).focus()
            await until(pilot, lambda: "pause" in offered())

    with subscriber(kind, topic, 1):
        asyncio.run(walk())


def test_a_long_name_leaves_the_other_columns_in_the_window(topic, registry):
    name = f"{topic}/{'long/' * 16}end"

    async def walk():
        app = Viewer(registry, allow_write=False)
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(DataTable) and name in app.screen.query_one(DataTable).rows)
            table = app.screen.query_one(DataTable)
            row = [str(cell) for cell in table.get_row(name)]
            assert row[1].startswith("…")
            assert row[1].endswith("/long/end")
            assert max(len(cell) for cell in row) <= 48
            table.move_cursor(row=list(table.rows).index(name))
            await until(pilot, lambda: name in str(app.screen.query_one("#note").render()))

    with publisher(registry.message("std_msgs/msg/Int32"), name, 1):
        asyncio.run(walk())


def test_a_sample_by_hand_only_where_it_is_allowed(topic, registry):
    kind = registry.message("std_msgs/msg/Int32")

    async def walk():
        app = Viewer(registry, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(TextArea))
            said = app.screen.query_one("#result")
            app.screen.query_one(TabbedContent).active = "publish"
            for text, answer in (
                ("data: 7", "published sample 1"),
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


class Server:
    """`shmgen view` in a folder without shmgen.toml, and what it has printed."""

    def __init__(self, folder, *options, **environment):
        command = [sys.executable, "-m", "shmgen", "view", "--port", "0", *options]
        environment = {**os.environ, **environment}
        self.process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().strip()
        self.address, _, self.token = self.url.partition("/?token=")
        assert self.process.stdout.readline() == "Ctrl-C ends it\n"

    def next(self):
        """The address that opens after one has been used."""
        return self.process.stdout.readline().removeprefix("opened; for another browser: ").strip()

    def close(self):
        self.process.terminate()
        rest, _ = self.process.communicate(timeout=10)
        assert self.process.returncode == 0
        assert self.token not in rest


@pytest.fixture
def server(tmp_path):
    """Starts one with options."""
    servers = []

    def start(*options, **environment):
        servers.append(Server(tmp_path, *options, **environment))
        return servers[-1]

    yield start
    for each in servers:
        each.close()


def test_nobody_else_gets_in(server):
    page = server()
    address = page.address

    async def status(session, path, headers):
        if path.endswith("/ws"):
            upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
            headers = headers | upgrade | {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
        async with session.get(address + path, headers=headers, allow_redirects=False) as answer:
            if answer.status != 101:
                assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
                assert "Access-Control-Allow-Origin" not in answer.headers
                return answer.status, answer.headers, await answer.text()
            answer.close()
            return 101, answer.headers, ""

    async def knock():
        async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar()) as session:
            for guess in ("", "?token=guessed", "?token=%C3%A9", "?token=%ff"):
                assert (await status(session, f"/{guess}", {}))[0] == 403
            entered, headers, _ = await status(session, f"/?token={page.token}", {})
            cookie, folder = headers["Set-Cookie"], headers["Refresh"].removeprefix("0; url=")
            assert entered == 200
            assert {"HttpOnly", "SameSite=Strict", f"Path={folder}"} <= set(cookie.split("; "))
            own = {"Cookie": cookie.partition(";")[0]}
            for path, headers, wanted in (
                (f"/?token={page.token}", {}, 403),
                ("/", own, 404),
                (folder, {}, 403),
                (folder, {"Cookie": f"shmgen-view={page.token}"}, 403),
                (folder, {"Cookie": "shmgen-view=\u00e9"}, 403),
                (folder, own | {"Host": "evil.example"}, 403),
                (folder, own | {"Origin": "http://evil.example"}, 403),
                (folder, own | {"Origin": "null"}, 403),
                (f"{folder}static/js/textual.js", {}, 403),
                (f"{folder}ws", own, 403),
                (f"{folder}ws", own | {"Origin": "http://evil.example"}, 403),
                (f"{folder}ws", {"Origin": address}, 403),
                (f"{folder}ws", own | {"Origin": address}, 101),
            ):
                assert (await status(session, path, headers))[0] == wanted, (path, headers)
            found, _, text = await status(session, folder, own)
            assert found == 200
            assert not re.findall(r"https?://(?!127\.0\.0\.1)", text.replace("http://www.w3.org/2000/svg", ""))
            assert (await status(session, page.next().removeprefix(address), {}))[0] == 200

    asyncio.run(knock())


@contextmanager
def talking(topics):
    """Those topics, std_msgs/Int32, 20 times a second; ends and removes them."""
    command = [sys.executable, "-m", "shmgen", "pub"]
    with ExitStack() as stack:
        for number, topic in enumerate(topics):
            words = [*command, topic, "std_msgs/Int32", f"{{data: {number}}}", "-r", "20"]
            process = stack.enter_context(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
            stack.callback(process.kill)
            assert process.stdout.readline()
        yield


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 800), (800, 600)])
def test_a_click_opens_the_row_under_it(first, server, size):
    """What a person sees in the window is where the mouse finds it, and all of it is in the window."""
    topics = [f"{first}/{name}" for name in "abc"]

    async def walk():
        async with Page() as browser:
            await browser.resize(*size)
            await browser.open(server().url)
            for name in (topics[2], topics[0]):
                await browser.until("Sort by the next column")
                await browser.click_on(name)
                await browser.until(f"shmgen view — {name}")
                await browser.until(f"data: {topics.index(name)}")
                assert (await browser.until("esc All regions"))[0] == browser.screen.lines - 1
                drawn = await browser.canvas()
                assert drawn["left"] == drawn["top"] == 0
                assert size[0] - 20 < drawn["right"] <= size[0]
                assert size[1] - 40 < drawn["bottom"] <= size[1]
                await browser.press("Escape")
            hidden = "document.querySelector('textarea').getBoundingClientRect().right <= 0"
            assert await browser.run(hidden) is True
            overflow = "document.documentElement.scrollHeight > innerHeight || document.body.scrollWidth > innerWidth"
            assert await browser.run(overflow) is False

    with talking(topics):
        asyncio.run(walk())


@pytest.mark.slow
def test_a_sample_by_hand_in_a_real_browser(first, server, registry):
    """On the topic that was clicked, and only with --allow-write."""
    kind = registry.message("std_msgs/msg/Int32")

    async def walk(page, name):
        async with Page() as browser:
            await browser.open(page.url)
            await browser.click_on(name)
            await browser.until("Plot")
            if page is looking:
                assert not any("Publish" in line for line in browser.screen.display)
                return
            await browser.click_on("Publish")
            await browser.until("data: 0")
            await browser.click_on("Publish one sample")
            await browser.until("published sample 1")

    looking, writing = server(), server("--allow-write")
    with subscriber(kind, f"{first}/a", 1) as above, subscriber(kind, f"{first}/b", 1) as reader:
        asyncio.run(walk(looking, f"{first}/b"))
        asyncio.run(walk(writing, f"{first}/b"))
        assert reader.read().data == 0
        assert above.read() is None


@pytest.mark.slow
def test_in_a_real_browser(moving, server):
    """All comes from this machine; a page of another origin gets nothing, and another port no cookie."""
    page = server()
    address, got = page.address, []

    async def other(request):
        got.append(request.headers.get("Cookie"))
        return web.Response(text="another port")

    async def walk():
        elsewhere = web.Application()
        elsewhere.add_routes([web.get("/{path:.*}", other)])
        runner = web.AppRunner(elsewhere)
        async with AsyncExitStack() as stack:
            stack.push_async_callback(runner.cleanup)
            await runner.setup()
            site = web.TCPSite(runner, "127.0.0.1", 0)
            await site.start()
            browser = await stack.enter_async_context(Page())
            await browser.open(page.url)
            await browser.until(moving)
            inside = await browser.run("location.href")
            assert re.fullmatch(rf"{address}/[\w-]{{16}}/", inside)
            assert all(asked.startswith((address, address.replace("http", "ws"))) for asked in browser.asked), (
                browser.asked
            )
            assert any("/ws?" in asked for asked in browser.asked)
            await browser.open(f"http://127.0.0.1:{site._server.sockets[0].getsockname()[1]}/")
            await asyncio.sleep(0.5)
            assert got
            assert set(got) == {None}
            await browser.open("data:text/html,<p>elsewhere")
            await asyncio.sleep(0.5)
            stolen = f"fetch('{inside}').then(a => a.text(), e => 'refused')"
            assert await browser.run(stolen) == "refused"
            socket = (
                f"new Promise(done => {{ const s = new WebSocket('{inside.replace('http', 'ws')}ws');"
                "s.onopen = () => done('open'); s.onerror = () => done('refused'); })"
            )
            assert await browser.run(socket) == "refused"

    asyncio.run(walk())


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("xdg-open") is None, reason="no xdg-open: apt-get install xdg-utils")
def test_the_browser_is_started_with_no_secret(topic, server, tmp_path):
    """What `--open` gives it everybody reads in /proc; the file it names only this user, until it has been opened."""
    home = tmp_path / "home"
    home.mkdir()
    starter, asked = tmp_path / "browser", tmp_path / "asked"
    starter.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > {asked}.part && mv {asked}.part {asked}\n')
    starter.chmod(0o755)

    async def walk():
        page = server("--open", HOME=str(home), BROWSER=str(starter))
        for _ in range(200):
            if asked.exists():
                break
            await asyncio.sleep(0.05)
        (door,) = home.iterdir()
        assert asked.read_text().strip().removeprefix("file://") == str(door)
        assert page.token not in asked.read_text()
        assert stat.S_IMODE(door.stat().st_mode) == 0o600
        async with Page() as browser:
            await browser.open(door.as_uri())
            await browser.until(topic)
            assert await browser.run("location.origin") == page.address
        assert list(home.iterdir()) == []

    with talking([topic]):
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
