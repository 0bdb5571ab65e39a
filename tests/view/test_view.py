"""Tests of `shmgen view`: its screens, the access control of its page, and the page in a real browser."""

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
from shmgen.runtime import RegionMissing, region_name  # noqa: E402
from shmgen.runtime.region.names import region_file  # noqa: E402
from shmgen.show.table import leaves  # noqa: E402
from shmgen.tools.messages import parse  # noqa: E402
from shmgen.tools.watch import overview  # noqa: E402
from shmgen.view.app import Viewer  # noqa: E402
from shmgen.view.curves import _reduce_points  # noqa: E402
from shmgen.view.memory import Memory  # noqa: E402
from shmgen.view.source import Source  # noqa: E402

from .browser import Page  # noqa: E402

HOSTILE = "[red]x[/red]<img src=x onerror=alert(1)>\x1b]0;hi\x07"


@pytest.fixture
def registry(tmp_path):
    return ClassRegistry(Session(Config(tmp_path)), None)


@pytest.fixture
def top_topic(topic):
    """A topic that sorts above the topics of other tests, so that no row moves between a look and a click."""
    name = topic.replace("/shmgen_test/", "/a_click/")
    yield name
    for file in Path("/dev/shm").glob(f"*{name[1:].replace('/', '.')}*"):
        file.unlink()


@pytest.fixture
def pose(top_topic, registry):
    """A pose that circles at 100 Hz, with a frame name that contains markup and control characters."""
    kind, stopping = registry.message("geometry_msgs/msg/PoseStamped"), threading.Event()

    def publish():
        angle = 0.0
        while not stopping.wait(0.01):
            angle += 0.05
            position = {"x": math.sin(angle), "y": math.cos(angle), "z": 2.5}
            writer.publish(parse.build(kind, {"header": {"frame_id": HOSTILE}, "pose": {"position": position}}))

    with publisher(kind, top_topic, 3) as writer:
        thread = threading.Thread(target=publish)
        thread.start()
        yield top_topic
        stopping.set()
        thread.join()


async def until(pilot, condition):
    for _ in range(600):
        await pilot.pause(0.05)
        if condition():
            return
    raise AssertionError


def find_nodes(screen):
    """Return the lines of the tree by path, including lines of closed arrays."""
    pending, find_nodes = [screen.query_one(Tree).root], {}
    while pending:
        node = pending.pop()
        pending += node.children
        find_nodes |= {node.data.path: node} if node.data and not node.data.is_more else {}
    return find_nodes


def test_screens_show_regions_fields_curves_and_memory(pose, registry):
    async def walk():
        app = Viewer(registry, allow_write=False)
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(DataTable) and pose in app.screen.query_one(DataTable).rows)
            table = app.screen.query_one(DataTable)
            row = [str(cell) for cell in table.get_row(pose)]
            assert (row[0], row[1], row[4]) == ("ok", pose, "geometry_msgs/msg/PoseStamped")
            table.move_cursor(row=list(table.rows).index(pose))
            await pilot.press("enter")
            await until(pilot, lambda: app.screen.query(Tree))
            screen = app.screen
            labels = lambda: {path: str(node.label) for path, node in find_nodes(screen).items()}  # noqa: E731
            await until(pilot, lambda: "2.5" in labels()["pose.position.z"])
            assert labels()["header.frame_id"].startswith("frame_id: '[red]x[/red]<img")
            assert "\x1b" not in labels()["header.frame_id"]
            node = find_nodes(screen)["pose.position.x"]
            screen.query_one(Tree).move_cursor(node)
            await pilot.press("enter")
            await until(pilot, lambda: len(screen._source.curves.get("pose.position.x", ())) > 10)
            await pilot.press("p", "+", "[")
            paused_labels = labels()
            await pilot.pause(0.5)
            assert labels() == paused_labels
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
def test_fields_of_the_command_line_are_plotted(pose, registry):
    async def walk():
        app = Viewer(registry, allow_write=False, topic=pose, fields=("pose.position.x", "header.frame_id"))
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
def test_table_measures_only_wider_cells_and_rests_while_hidden(topic, registry, monkeypatch):
    """Measure a column only for a wider cell. With 200 regions, measuring took most of a CPU core."""

    async def walk():
        app = Viewer(registry, allow_write=False)
        async with app.run_test(size=(150, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(DataTable) and topic in app.screen.query_one(DataTable).rows)
            regions, polls, updates, update = app.screen, [], [], DataTable.update_cell
            own_row = next(row for row in overview.look({}) if row.topic == topic)

            def record_update(self, row, column, value, *, update_width):
                updates.append((column, str(value), update_width))
                update(self, row, column, value, update_width=update_width)

            monkeypatch.setattr(DataTable, "update_cell", record_update)
            for missed, is_wider in ((0, None), (1, False), (12_345_678, True), (7, False)):
                row = dataclasses.replace(own_row, missed=missed)
                monkeypatch.setattr(overview, "look", lambda past, row=row: polls.append(1) or [row])
                regions.look()
                assert is_wider is None or updates[-1] == ("MISSED", f"{missed:,}", is_wider)
                await pilot.pause()
            app.open(topic)
            await until(pilot, lambda: app.screen.query(Tree))
            polls.clear()
            regions.look()
            assert polls == []

    with publisher(registry.message("std_msgs/msg/Int32"), topic, 1):
        asyncio.run(walk())


@pytest.fixture
def joints(tmp_path):
    """A registry for JointState with sequences of at most 1,000 elements, and for a message with float32 fields."""
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
def test_elements_of_arrays_are_shown_in_pages_and_plotted(topic, joints):
    """Show six joints, then four, then a thousand in pages of 100 elements."""
    kind = joints.message("sensor_msgs/msg/JointState")

    async def walk(writer):
        app = Viewer(joints, allow_write=False, topic=topic)
        async with app.run_test(size=(120, 60)) as pilot:
            await until(pilot, lambda: app.screen.query(Tree) and "position" in find_nodes(app.screen))
            screen, tree = app.screen, app.screen.query_one(Tree)
            label = lambda path: str(find_nodes(screen)[path].label) if path in find_nodes(screen) else ""  # noqa: E731
            await until(pilot, lambda: label("position") == "position: 6 elements, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]")
            assert label("effort") == "effort: 0 elements"
            tree.move_cursor(find_nodes(screen)["position"])
            await pilot.press("enter")
            await until(pilot, lambda: label("position[5]") == "[5]: 0.5")
            for _ in range(3):
                await pilot.press("down", "enter")
            writer.publish(kind(position=[1.0] * 6))
            await until(pilot, lambda: all(screen._source.curves.get(f"position[{it}]") for it in range(3)))
            await until(pilot, lambda: label("position[0]") == "● [0]: 1.0")
            writer.publish(kind(position=[2.0] * 4))
            await until(pilot, lambda: "position[4]" not in find_nodes(screen))
            writer.publish(kind(position=[3.0] * 1000))
            await until(pilot, lambda: "position[99]" in find_nodes(screen))
            node = find_nodes(screen)["position"]
            assert "position[100]" not in find_nodes(screen)
            assert str(node.children[-1].label) == "… 900 more: Enter shows 100 of them"
            tree.move_cursor(node.children[-1])
            await pilot.press("enter")
            await until(pilot, lambda: label("position[199]") != "")
            assert str(node.children[-1].label) == "… 800 more: Enter shows 100 of them"

    with publisher(kind, topic, 1) as writer:
        writer.publish(kind(name=list("abcdef"), position=[it / 10 for it in range(6)]))
        asyncio.run(walk(writer))


@pytest.mark.slow
def test_nested_arrays_expand_and_float32_prints_short(topic, joints):
    kind = joints.message("f_msgs/msg/F")

    async def walk():
        app = Viewer(joints, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 60)) as pilot:
            await until(pilot, lambda: app.screen.query(Tree) and "x" in find_nodes(app.screen))
            screen = app.screen
            label = lambda path: str(find_nodes(screen)[path].label) if path in find_nodes(screen) else ""  # noqa: E731
            await until(pilot, lambda: label("x") == "x: 0.01")
            assert label("fixed") == "fixed: 2 elements, [0.1, 3.4028235e+38]"
            for path in ("cells", "cells[1]", "cells[1].v"):
                await until(pilot, lambda path=path: path in find_nodes(screen))
                find_nodes(screen)[path].expand()
            await until(pilot, lambda: label("cells[1].v[2]") == "[2]: 0.7")
            assert "x: 0.01\n" in screen.query_one(TextArea).text

    cell = joints.message("f_msgs/msg/Cell")
    with publisher(kind, topic, 1) as writer:
        cells = [cell(), cell(v=[0.5, 0.6, 0.7], name="b")]
        writer.publish(kind(x=0.01, fixed=[0.1, 3.4028234e38], many=[0.1], cells=cells))
        asyncio.run(walk())


def test_damaged_count_is_shown(topic, joints):
    kind, cell = joints.message("f_msgs/msg/F"), joints.message("f_msgs/msg/Cell")

    async def walk():
        app = Viewer(joints, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 60)) as pilot:
            for path in ("cells", "cells[0]"):
                await until(pilot, lambda path=path: app.screen.query(Tree) and path in find_nodes(app.screen))
                find_nodes(app.screen)[path].expand()
            line = lambda: str(find_nodes(app.screen)["cells[0].v"].label)  # noqa: E731
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
def test_select_all_and_typing_replaces_the_draft(topic, registry):
    kind = registry.message("std_msgs/msg/Bool")

    async def walk():
        app = Viewer(registry, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(TextArea))
            screen = app.screen
            screen.query_one(TabbedContent).active = "publish"
            actions = lambda: {it.binding.action for it in screen.active_bindings.values() if it.enabled}  # noqa: E731
            assert {"pause", "leave"} <= actions()
            screen.query_one(TextArea).focus()
            await until(pilot, lambda: screen.focused is screen.query_one(TextArea))
            assert not {"pause", "leave", "zoom(2)"} & actions()
            assert "select_all" in actions()
            await pilot.press("ctrl+a", *"data: true")
            assert screen.query_one(TextArea).text == "data: true"
            screen.query_one(Tree).focus()
            await until(pilot, lambda: "pause" in actions())

    with subscriber(kind, topic, 1):
        asyncio.run(walk())


def test_long_topic_name_is_shortened_in_the_table(topic, registry):
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


def test_publish_tab_sends_a_sample_or_shows_the_error(topic, registry):
    kind = registry.message("std_msgs/msg/Int32")

    async def walk():
        app = Viewer(registry, allow_write=True, topic=topic)
        async with app.run_test(size=(120, 40)) as pilot:
            await until(pilot, lambda: app.screen.query(TextArea))
            result = app.screen.query_one("#result")
            app.screen.query_one(TabbedContent).active = "publish"
            for text, expected in (
                ("data: 7", "published sample 1"),
                ("data: x", "error: data: 'x' is str, not int32"),
            ):
                app.screen.query_one(TextArea).text = text
                await until(pilot, lambda: app.screen.query_one("#send").region.height > 0)
                await pilot.click("#send")
                await until(pilot, lambda expected=expected: str(result.render()).startswith(expected))

    with subscriber(kind, topic, 1) as reader:
        asyncio.run(walk())
        assert reader.read().data == 7


def test_source_reopens_a_replaced_region(topic, registry, tmp_path):
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
        with pytest.raises(RegionMissing):
            source.look()
    assert [row.path for row in leaves(source.layout, source.layouts)] == ["data"]
    source.close()
    points = [(float(x), float(x == 500)) for x in range(1000)]
    assert (500.0, 1.0) in _reduce_points(points, 40)
    assert len(_reduce_points(points, 40)) <= 40


class Server:
    """`shmgen view` in a folder without shmgen.toml, with the address that it printed."""

    def __init__(self, folder, *options, **environment):
        command = [sys.executable, "-m", "shmgen", "view", "--port", "0", *options]
        environment = {**os.environ, **environment}
        self.process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().strip()
        self.address, _, self.token = self.url.partition("/?token=")
        assert self.process.stdout.readline() == "Ctrl-C stops the server\n"

    def next_url(self):
        """Return the address for another browser, which the server prints after the former address was used."""
        return self.process.stdout.readline().removeprefix("the page was opened; address for another browser: ").strip()

    def close(self):
        self.process.terminate()
        rest, _ = self.process.communicate(timeout=10)
        assert self.process.returncode == 0
        assert self.token not in rest


@pytest.fixture
def server(tmp_path):
    """A function that starts `shmgen view` with options."""
    servers = []

    def start(*options, **environment):
        servers.append(Server(tmp_path, *options, **environment))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


def test_page_rejects_requests_without_token_cookie_or_origin(server):
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

    async def send_requests():
        async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar()) as session:
            for guess in ("", "?token=guessed", "?token=%C3%A9", "?token=%ff"):
                assert (await status(session, f"/{guess}", {}))[0] == 403
            first_status, headers, _ = await status(session, f"/?token={page.token}", {})
            cookie, folder = headers["Set-Cookie"], headers["Refresh"].removeprefix("0; url=")
            assert first_status == 200
            assert {"HttpOnly", "SameSite=Strict", f"Path={folder}"} <= set(cookie.split("; "))
            own = {"Cookie": cookie.partition(";")[0]}
            for path, headers, expected in (
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
                assert (await status(session, path, headers))[0] == expected, (path, headers)
            page_status, _, text = await status(session, folder, own)
            assert page_status == 200
            assert not re.findall(r"https?://(?!127\.0\.0\.1)", text.replace("http://www.w3.org/2000/svg", ""))
            assert (await status(session, page.next_url().removeprefix(address), {}))[0] == 200

    asyncio.run(send_requests())


@contextmanager
def publish_numbers(topics):
    """Publish std_msgs/Int32 on the topics 20 times a second, until the context ends."""
    command = [sys.executable, "-m", "shmgen", "pub"]
    with ExitStack() as stack:
        for number, topic in enumerate(topics):
            arguments = [*command, topic, "std_msgs/Int32", f"{{data: {number}}}", "-r", "20"]
            process = stack.enter_context(subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True))
            stack.callback(process.kill)
            assert process.stdout.readline()
        yield


@pytest.mark.sample("[size0]")
@pytest.mark.parametrize("size", [(1280, 800), (800, 600)])
def test_click_opens_the_row_under_the_pointer(top_topic, server, size):
    """Map the mouse position to the visible row, and keep the whole canvas inside the window."""
    topics = [f"{top_topic}/{name}" for name in "abc"]

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
                canvas = await browser.canvas()
                assert canvas["left"] == canvas["top"] == 0
                assert size[0] - 20 < canvas["right"] <= size[0]
                assert size[1] - 40 < canvas["bottom"] <= size[1]
                await browser.press("Escape")
            hidden = "document.querySelector('textarea').getBoundingClientRect().right <= 0"
            assert await browser.run(hidden) is True
            overflow = "document.documentElement.scrollHeight > innerHeight || document.body.scrollWidth > innerWidth"
            assert await browser.run(overflow) is False

    with publish_numbers(topics):
        asyncio.run(walk())


@pytest.mark.slow
def test_browser_publishes_only_with_allow_write(top_topic, server, registry):
    """Publish on the clicked topic, and only with --allow-write."""
    kind = registry.message("std_msgs/msg/Int32")

    async def walk(page, name):
        async with Page() as browser:
            await browser.open(page.url)
            await browser.click_on(name)
            await browser.until("Plot")
            if page is read_only:
                assert not any("Publish" in line for line in browser.screen.display)
                return
            await browser.click_on("Publish")
            await browser.until("data: 0")
            await browser.click_on("Publish one sample")
            await browser.until("published sample 1")

    read_only, writable = server(), server("--allow-write")
    with subscriber(kind, f"{top_topic}/a", 1) as other_reader, subscriber(kind, f"{top_topic}/b", 1) as reader:
        asyncio.run(walk(read_only, f"{top_topic}/b"))
        asyncio.run(walk(writable, f"{top_topic}/b"))
        assert reader.read().data == 0
        assert other_reader.read() is None


@pytest.mark.slow
def test_browser_page_is_isolated_from_other_origins(pose, server):
    """Load everything from this machine. A page of another origin gets nothing, and another port gets no cookie."""
    page = server()
    address, cookies = page.address, []

    async def answer_other_port(request):
        cookies.append(request.headers.get("Cookie"))
        return web.Response(text="another port")

    async def walk():
        other_server = web.Application()
        other_server.add_routes([web.get("/{path:.*}", answer_other_port)])
        runner = web.AppRunner(other_server)
        async with AsyncExitStack() as stack:
            stack.push_async_callback(runner.cleanup)
            await runner.setup()
            site = web.TCPSite(runner, "127.0.0.1", 0)
            await site.start()
            browser = await stack.enter_async_context(Page())
            await browser.open(page.url)
            await browser.until(pose)
            page_url = await browser.run("location.href")
            assert re.fullmatch(rf"{address}/[\w-]{{16}}/", page_url)
            assert all(url.startswith((address, address.replace("http", "ws"))) for url in browser.asked), browser.asked
            assert any("/ws?" in url for url in browser.asked)
            await browser.open(f"http://127.0.0.1:{site._server.sockets[0].getsockname()[1]}/")
            await asyncio.sleep(0.5)
            assert cookies
            assert set(cookies) == {None}
            await browser.open("data:text/html,<p>elsewhere")
            await asyncio.sleep(0.5)
            fetch_script = f"fetch('{page_url}').then(a => a.text(), e => 'refused')"
            assert await browser.run(fetch_script) == "refused"
            socket_script = (
                f"new Promise(done => {{ const s = new WebSocket('{page_url.replace('http', 'ws')}ws');"
                "s.onopen = () => done('open'); s.onerror = () => done('refused'); })"
            )
            assert await browser.run(socket_script) == "refused"

    asyncio.run(walk())


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("xdg-open") is None, reason="no xdg-open: apt-get install xdg-utils")
def test_option_open_keeps_the_token_off_the_command_line(topic, server, tmp_path):
    """Pass the token in a file of mode 0600, because /proc shows command lines. Delete the file once opened."""
    home = tmp_path / "home"
    home.mkdir()
    fake_browser, arguments_file = tmp_path / "browser", tmp_path / "asked"
    fake_browser.write_text(
        f'#!/bin/sh\nprintf "%s\\n" "$@" > {arguments_file}.part && mv {arguments_file}.part {arguments_file}\n'
    )
    fake_browser.chmod(0o755)

    async def walk():
        page = server("--open", HOME=str(home), BROWSER=str(fake_browser))
        for _ in range(200):
            if arguments_file.exists():
                break
            await asyncio.sleep(0.05)
        (token_file,) = home.iterdir()
        assert arguments_file.read_text().strip().removeprefix("file://") == str(token_file)
        assert page.token not in arguments_file.read_text()
        assert stat.S_IMODE(token_file.stat().st_mode) == 0o600
        async with Page() as browser:
            await browser.open(token_file.as_uri())
            await browser.until(topic)
            assert await browser.run("location.origin") == page.address
        assert list(home.iterdir()) == []

    with publish_numbers([topic]):
        asyncio.run(walk())


def test_missing_textual_is_reported_with_the_pip_command(tmp_path, monkeypatch):
    from ..support.command import run

    monkeypatch.setitem(sys.modules, "textual", None)
    result = run(["view"], tmp_path)
    assert (result.code, result.stdout) == (1, "")
    assert "pip install '.[view]'" in result.stderr


def test_latency_picture_matches_the_table_of_the_page():
    """Update the pictures of the screens by hand, with `make pictures`."""
    from ..rigs.pictures import DOCS, latency

    assert latency((DOCS / "performance.md").read_text()) == (DOCS / "latency.svg").read_text()
    assert "url(" not in re.sub(r"url\(#[\w-]+\)", "", (DOCS / "top.svg").read_text())
    assert (DOCS / "view.gif").stat().st_size < 300_000
