"""Makes a site of the plain Markdown: README is the home page, pages from other folders come in, links follow."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import click
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#:\s]+)((?:#[^)]*)?)\)")


def on_files(files: Files, config: Any) -> Files:
    for place, name in _elsewhere().items():
        files.append(File.generated(config, name, content=(ROOT / place).read_text()))
    files.append(File.generated(config, "commands.md", content=_commands()))
    files.append(File.generated(config, "api.md", content="# Python runtime\n\n::: shmgen.runtime\n"))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links between files of the repository become links between pages; to source files, words without a link."""
    here = page.file.src_uri
    inside = {name: place for place, name in _elsewhere().items()}
    folder = posixpath.dirname(inside.get(here, f"docs/{here}"))
    elsewhere = _elsewhere()

    def moved(link: re.Match[str]) -> str:
        picture, text, target, anchor = link.groups()
        target = posixpath.normpath(posixpath.join(folder, target))
        if target.startswith("examples/") and not target.endswith(".md"):
            target = f"{target}/README.md"
        target = target.removeprefix("docs/")
        name = elsewhere.get(target, target)
        if not (ROOT / "docs" / name).is_file() and name not in inside:
            return text  # only the repository has it
        return f"{picture}[{text}]({posixpath.relpath(name, posixpath.dirname(here) or '.')}{anchor})"

    return _LINK.sub(moved, markdown)


def _elsewhere() -> dict[str, str]:
    """Pages by their place in the repository."""
    pages = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
    pages |= {"SECURITY.md": "security.md", "tests/softplc/README.md": "softplc.md"}
    pages |= {"examples/README.md": "examples.md"}
    for readme in sorted((ROOT / "examples").glob("*/README.md")):
        pages[readme.relative_to(ROOT).as_posix()] = f"example-{readme.parent.name}.md"
    return pages


def _commands() -> str:
    """What `--help` says of each command."""
    from shmgen.cli.main import cli

    context = click.Context(cli, info_name="shmgen", max_content_width=100, terminal_width=100)
    parts = ["# Commands\n", f"```text\n{cli.get_help(context)}\n```\n"]
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context, max_content_width=80, terminal_width=80)
        parts.append(f"## shmgen {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "\n".join(parts)
