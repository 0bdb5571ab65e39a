"""The page docs/try generates the same files in the browser as `shmgen generate` on the command line."""

from __future__ import annotations

import asyncio
import io
import json
import random
import shutil
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from .conftest import REPOSITORY
from .support.definitions import from_grammar

PAGE = REPOSITORY / "docs" / "try"
SCRIPT = 600
"""The largest number of lines of HTML, CSS and JavaScript."""


def state(**values: Any) -> dict[str, Any]:
    return {"source": "jazzy", "files": {}, "messages": [], "topics": [], "bounds": {}} | values


POINTS = state(
    files={"cell_msgs/msg/Job.msg": "string<=20 name\nfloat64[] points  # [m]\nbuiltin_interfaces/Time due\n"},
    messages=["geometry_msgs/Pose"],
    topics=[{"topic": "/cell/job", "type": "cell_msgs/Job", "direction": "to_plc", "depth": 2}],
    bounds={"cell_msgs/Job.points": 8},
)


@pytest.fixture
def generator(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """The module that the page runs; it changes the working directory."""
    monkeypatch.syspath_prepend(str(PAGE))
    monkeypatch.chdir(tmp_path)
    import generator

    return generator


def generate_with_command(files: dict[str, str], folder: Path) -> dict[str, str]:
    """Run `shmgen generate` on the files, which include shmgen.toml. Return the generated files."""
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(text.encode())
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], cwd=folder, check=True)
    output = folder / "generated"
    return {str(file.relative_to(output)): file.read_text() for file in output.rglob("*") if file.is_file()}


def test_page_module_generates_the_files_of_the_command(generator: Any, tmp_path: Path) -> None:
    result = generator.run(POINTS, str(tmp_path / "page"))
    assert result["diagnostics"] == []
    assert [message["type"] for message in result["messages"]] == ["geometry_msgs/Pose", "cell_msgs/Job"]
    assert result["files"] == generate_with_command(
        {**POINTS["files"], "shmgen.toml": result["toml"]}, tmp_path / "shell"
    )


def test_page_module_asks_for_missing_bounds(generator: Any, tmp_path: Path) -> None:
    result = generator.run({**POINTS, "bounds": {}}, str(tmp_path / "page"))
    place = {"path": "cell_msgs/msg/Job.msg", "line": 2, "column": 1, "width": 9}
    assert result["missing"] == [{"key": "cell_msgs/Job.points", "proposed": 32, "type": "float64[]", **place}]
    assert result["files"] == {}


def test_page_module_reports_the_position_of_an_error(generator: Any, tmp_path: Path) -> None:
    broken = state(files={"cell_msgs/msg/Job.msg": "float64 x\nfloat65 y\n"})
    [error] = generator.run(broken, str(tmp_path / "page"))["diagnostics"]
    assert (error["path"], error["line"], error["column"]) == ("cell_msgs/msg/Job.msg", 2, 1)
    assert "float65" in error["text"]


def test_page_module_accepts_an_empty_selection(generator: Any, tmp_path: Path) -> None:
    result = generator.run(state(), str(tmp_path / "page"))
    assert (result["diagnostics"], result["files"]) == ([], {})


def test_page_module_lists_the_types_of_a_distribution(generator: Any) -> None:
    types = generator.stored_types("jazzy")
    assert {"geometry_msgs/Pose", "std_srvs/SetBool"} <= set(types)
    assert not [name for name in types if name.endswith(("_Request", "_Response", "_Reply"))]


@pytest.mark.parametrize(
    ("above", "package"), [("cell_msgs/", "cell_msgs"), ("src/a/cell_msgs/", "cell_msgs"), ("", "upload")]
)
def test_uploaded_zip_is_unpacked_by_packages(generator: Any, above: str, package: str) -> None:
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w") as archive:
        for path in ("msg/Job.msg", "srv/Stop.srv", "package.xml", "CMakeLists.txt"):
            archive.writestr(f"{above}{path}", "# text\n")
    files = generator.unpack_zip("upload.zip", target.getvalue())
    assert sorted(files) == [f"{package}/{path}" for path in ("msg/Job.msg", "package.xml", "srv/Stop.srv")]


def test_page_stays_below_its_limit_of_lines() -> None:
    files = [file for file in PAGE.iterdir() if file.suffix in (".md", ".css", ".js")]
    assert sum(len(file.read_text().splitlines()) for file in files) <= SCRIPT


# --- in a browser -----------------------------------------------------------------------------------------


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a local server with the page and all its files, without the theme of the site."""
    if shutil.which("npm") is None:
        pytest.skip("no npm: apt-get install npm")
    site = tmp_path_factory.mktemp("site")
    shutil.copytree(PAGE, site / "try")
    body = (PAGE / "form.html").read_text()
    (site / "try" / "index.html").write_text(f"<!doctype html><meta charset=utf-8><title>Try</title>{body}")
    subprocess.run([sys.executable, REPOSITORY / "docs" / "site" / "try_files.py", site], check=True)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(QuietHandler, directory=site)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/try/"
        server.shutdown()


class User:
    """Clicks, types and reads in a page, by CSS selectors."""

    def __init__(self, page: Any) -> None:
        self.page = page

    async def text(self, selector: str) -> str:
        return str(await self.page.run(f"document.querySelector({json.dumps(selector)})?.textContent ?? ''"))

    async def wait_for_text(self, selector: str, part: str) -> str:
        for _ in range(600):
            if part in (text := await self.text(selector)):
                return text
            await asyncio.sleep(0.1)
        raise AssertionError(f"no {part!r} in {selector}: {text!r}; status: {await self.text('#status')}")

    async def click(self, selector: str) -> None:
        script = f"""(() => {{
            const element = document.querySelector({json.dumps(selector)});
            element.scrollIntoView({{block: "center"}});
            const {{left, top, width, height}} = element.getBoundingClientRect();
            return [left + width / 2, top + height / 2];
        }})()"""
        await self.page.click(*map(int, await self.page.run(script)))

    async def type(self, selector: str, text: str) -> None:
        """Replace the content of an input by text. Select the old content first, as a user does."""
        await self.click(selector)
        await self.page.run("document.activeElement.select()")
        await self.page.call("Input.insertText", text=text)

    async def open_file(self, selector: str, file: Path) -> None:
        root = (await self.page.call("DOM.getDocument"))["root"]["nodeId"]
        node = (await self.page.call("DOM.querySelector", nodeId=root, selector=selector))["nodeId"]
        await self.page.call("DOM.setFileInputFiles", nodeId=node, files=[str(file)])

    async def download(self, selector: str, file: Path) -> bytes:
        parameters = {"behavior": "allow", "downloadPath": str(file.parent)}
        await self.page.call("Browser.setDownloadBehavior", **parameters)
        await self.click(selector)
        for _ in range(300):
            if file.exists():
                return file.read_bytes()
            await asyncio.sleep(0.1)
        raise AssertionError(f"{file.name} was not downloaded")


@pytest.mark.slow
def test_user_generates_in_the_browser(address: str, tmp_path: Path) -> None:
    """Choose Pose, type a message and a service, correct an error, give a bound, download, and pass on the link."""
    from .view.browser import Page

    async def visit() -> dict[str, str]:
        async with Page() as page:
            user = User(page)
            await page.open(address)
            await user.wait_for_text("#status", "Choose a message")
            await user.type("#search", "geometry_msgs/Pose")
            await page.press("Enter")
            await user.wait_for_text("#status", "Ready: 1 message")

            await user.type("#path", "cell_msgs/msg/Job.msg")
            await page.press("Enter")
            await page.call("Input.insertText", text="float64[] points\nflaot32 speed\n")
            await user.wait_for_text("#diagnostics", "cell_msgs/msg/Job.msg:2:1: error[SHM004]")
            await user.click("#diagnostics button")
            assert await page.run("getSelection().toString()") == "flaot32"
            await page.call("Input.insertText", text="float32")
            await user.wait_for_text("#bounds", "cell_msgs/Job.points (float64[]) has no bound.")
            await user.type("#bounds input", "12")
            await user.click("#bounds button")
            await user.wait_for_text("#status", "Ready: 2 messages")

            await user.type("#path", "cell_msgs/srv/Stop.srv")
            await page.press("Enter")
            await page.call("Input.insertText", text="bool now\n---\nbool done\n")
            await user.wait_for_text("#status", "Ready: 5 messages")
            upload = tmp_path / "plant_msgs.zip"
            with zipfile.ZipFile(upload, "w") as archive:
                archive.writestr("plant_msgs/msg/Valve.msg", "float32 opening  # [%]\n")
            await user.open_file("#open", upload)
            await user.wait_for_text("#status", "Ready: 6 messages")
            await user.click("#add-topic")
            await user.type("#topics input", "/cell/job")
            toml = await user.wait_for_text("#toml", "/cell/job")
            await user.wait_for_text("#status", "Ready")
            assert "STRUCT" in await user.wait_for_text("#text", "ST_plant_msgs_Valve")
            assert await page.run("document.querySelectorAll('#picture > svg').length") == 1

            content = await user.download("#zip", tmp_path / "shmgen.zip")
            xml = await user.download("#xml", tmp_path / "shmgen.xml")
            files = {}
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                files = {name: archive.read(name).decode() for name in archive.namelist()}
            assert files["shmgen.toml"] == toml
            assert files["generated/plcopen/shmgen.xml"] == xml.decode()

            await user.click("#link")
            await user.wait_for_text("#link", "Copied")
            colleague = await page.run("location.href")
        async with Page() as page:  # a new profile has no cache and no local storage
            await page.open(colleague)
            await User(page).wait_for_text("#status", "Ready: 6 messages")
            assert await User(page).text("#toml") == toml
            assert all(url.startswith((address.removesuffix("/try/"), "blob:")) for url in page.asked)
        return files

    files = asyncio.run(visit())
    own = {path: text for path, text in files.items() if not path.startswith("generated/")}
    assert sorted(own) == [
        *("cell_msgs/msg/Job.msg", "cell_msgs/srv/Stop.srv"),
        *("plant_msgs/msg/Valve.msg", "shmgen.toml"),
    ]
    expected = generate_with_command(own, tmp_path / "shell")
    assert {path.partition("/")[2]: text for path, text in files.items() if path not in own} == expected


@pytest.mark.exhaustive
def test_second_visit_needs_no_network(address: str, record_testsuite_property: Callable[[str, object], None]) -> None:
    """Write the seconds of both visits, and the bytes that the first visit loads, into the report (--junit-xml)."""
    from .view.browser import Page

    async def visit() -> None:
        async with Page() as page:
            for number in ("first", "second"):
                begin = time.monotonic()
                await page.open(address)
                await User(page).wait_for_text("#status", "Choose a message")
                record_testsuite_property(f"{number}_visit_seconds", round(time.monotonic() - begin, 1))
                if number == "first":
                    sizes = "performance.getEntriesByType('resource').reduce((sum, it) => sum + it.encodedBodySize, 0)"
                    record_testsuite_property("first_visit_bytes", await page.run(sizes))
                unlimited = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
                await page.call("Network.emulateNetworkConditions", offline=True, **unlimited)

    asyncio.run(visit())


@pytest.mark.exhaustive
def test_worker_generates_twenty_random_packages(address: str, generator: Any, tmp_path: Path) -> None:
    """Return the same files and errors from Python in WebAssembly as from Python on this machine."""
    from .view.browser import Page

    states, complete, seed = [], 0, 0
    while complete < 20:
        fuzzed = from_grammar(random.Random(seed := seed + 1))
        files = {
            f"demo_msgs/{fuzzed.kind}/Foo.{fuzzed.kind}": fuzzed.data.decode(),
            "demo_msgs/msg/Bar.msg": "int8 b\n",
        }
        states.append(state(files=files, bounds={"demo_msgs": 2, "geometry_msgs": 2}, source=fuzzed.source))
        complete += bool(generator.run(states[-1], str(tmp_path / "page"))["files"])
    expected = [generator.run(request, str(tmp_path / "page")) for request in states]

    async def visit() -> list[Any]:
        async with Page() as page:
            await page.open(address)
            await User(page).wait_for_text("#status", "Choose a message")
            await page.run("""
                window.worker = new Worker("worker.js", { type: "module" });
                window.ask = (call, ...args) => new Promise((resolve) => {
                    worker.onmessage = ({ data }) => resolve(data.result ?? data.error);
                    worker.postMessage({ id: 1, call, args });
                });
                undefined""")
            manifest = json.loads(await page.run("fetch('manifest.json').then((response) => response.text())"))
            await page.run(f"ask('start', {json.dumps(address + manifest['folder'])})")
            return [await page.run(f"ask('run', {json.dumps(request)})") for request in states]

    for request, result, expected_result in zip(states, asyncio.run(visit()), expected, strict=True):
        assert result == expected_result, request
