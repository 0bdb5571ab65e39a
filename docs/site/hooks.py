"""Build the site from plain Markdown: add pages from other folders, adapt links, and name the release."""

from __future__ import annotations

import os
import posixpath
import re
from pathlib import Path
from typing import Any

import click
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#:\s]+)((?:#[^)]*)?)\)")


def on_config(config: Any) -> Any:
    """Show on every page which release the pages describe, and where its sources are."""
    release = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[0]
    repository = os.environ.get("SHMGEN_REPOSITORY", "").rstrip("/")
    config.site_name = f"shmgen {release.split()[0]}"
    sources = f'<a href="{repository}">Sources</a> · ' if repository else ""
    config.copyright = f"{sources}These pages describe shmgen {release}. Apache-2.0; generated code is 0BSD."
    return config


def on_page_context(context: Any, page: Any, **_: Any) -> Any:
    """Add the edit link, if SHMGEN_REPOSITORY names the repository and the page is a file of it."""
    repository, name = os.environ.get("SHMGEN_REPOSITORY", "").rstrip("/"), page.file.src_uri
    place = {name: place for place, name in _elsewhere().items()}.get(name, f"docs/{name}")
    if repository and (ROOT / place).is_file():
        page.edit_url = f"{repository}/edit/main/{place}"
    return context


def on_files(files: Files, config: Any) -> Files:
    for place, name in _elsewhere().items():
        files.append(File.generated(config, name, content=(ROOT / place).read_text()))
    files.append(File.generated(config, "commands.md", content=_commands()))
    files.append(File.generated(config, "api.md", content=_api()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn links between files into links between pages, and links to sources into links to SHMGEN_REPOSITORY."""
    here = page.file.src_uri
    inside = {name: place for place, name in _elsewhere().items()}
    folder = posixpath.dirname(inside.get(here, f"docs/{here}"))
    elsewhere = _elsewhere()

    def moved(link: re.Match[str]) -> str:
        picture, text, target, anchor = link.groups()
        target = posixpath.normpath(posixpath.join(folder, target))
        if target.startswith("examples/") and not target.endswith(".md"):
            target = f"{target}/README.md"
        name = elsewhere.get(target, target.removeprefix("docs/"))
        if not (ROOT / "docs" / name).is_file() and name not in inside:
            repository = os.environ.get("SHMGEN_REPOSITORY", "").rstrip("/")
            return f"[{text}]({repository}/blob/main/{target})" if repository else text
        return f"{picture}[{text}]({posixpath.relpath(name, posixpath.dirname(here) or '.')}{anchor})"

    return _LINK.sub(moved, markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Append the form to the page that generates in the browser."""
    return html + (ROOT / "docs" / "try" / "form.html").read_text() if page.file.src_uri == "try/index.md" else html


def _elsewhere() -> dict[str, str]:
    """Map the path of each page outside docs/ to its name on the site."""
    pages = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "SECURITY.md": "security.md"}
    pages |= {"tests/softplc/README.md": "softplc.md"}
    pages |= {"examples/README.md": "examples.md", "src/shmgen/diagnostics.md": "diagnostics.md"}
    for readme in sorted((ROOT / "examples").glob("*/README.md")):
        pages[readme.relative_to(ROOT).as_posix()] = f"example-{readme.parent.name}.md"
    return pages


def _api() -> str:
    """Return a page with every public name of the runtime, grouped by task."""
    from shmgen import runtime

    errors = [
        name
        for name in runtime.__all__
        if isinstance(value := getattr(runtime, name), type) and issubclass(value, Exception)
    ]
    groups = {**_API, "Errors": " ".join(errors)}
    missing = set(runtime.__all__) - set(" ".join(groups.values()).split())
    assert not missing, f"docs/site/hooks.py: add {sorted(missing)} to _API"
    parts = [
        "# Python: every name\n\nAll names are in `shmgen.runtime`. [Python](python.md) explains how to use them.\n"
    ]
    for title, names in groups.items():
        parts += [f"## {title}\n", *(f"::: shmgen.runtime.{name}\n" for name in names.split())]
    return "\n".join(parts)


_API = {
    "Topics": "Publisher Subscriber Sample RegionOptions",
    "Several topics": "Notifier open_all ready_any can_wait_for_many",
    "Services": "ServiceClient ServiceServer Call",
    "Actions": "ActionClient ActionServer ServedGoal",
    "Messages": "Message Time Duration",
    "Regions": "read_header region_name Header",
}
"""The names on the page of the Python runtime. Errors follow."""


def _commands() -> str:
    """Return a page with the `--help` text of each command, in the groups of `shmgen --help`."""
    from shmgen.cli.main import GROUPS, cli

    context = click.Context(cli, info_name="shmgen", max_content_width=100, terminal_width=100)
    parts = ["# Commands\n", f"```text\n{cli.get_help(context)}\n```\n"]
    for name in cli.list_commands(context):
        parts += [f"## {group}\n" for group, names in GROUPS.items() if next(iter(names)) == name]
        command = cli.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context, max_content_width=80, terminal_width=80)
        parts.append(f"### shmgen {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "\n".join(parts)
