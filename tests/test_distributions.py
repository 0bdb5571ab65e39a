"""shmgen-runtime contains all modules that generated code loads. Wheels contain compiled templates."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import posix_ipc
import pytest

from shmgen.config import Config
from shmgen.generator import pipeline, render
from shmgen.generator.templates import compile_templates

from .conftest import REPOSITORY
from .support.sanitizers import build_hook

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LOADED = (
    "import sys, shmgen.runtime; print(*(m.__file__ for n, m in sys.modules.items() if n.split('.')[0] == 'shmgen'))"
)


PROJECT = tomllib.loads((REPOSITORY / "packaging/shmgen-runtime/pyproject.toml").read_text())
PACKAGED = tuple(
    (REPOSITORY / "packaging/shmgen-runtime" / path).resolve()
    for path in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
)


def test_runtime_package_contains_all_loaded_modules() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    for file in map(Path, done.stdout.split()):
        if file.suffix == ".so":  # hatch_build.py adds it
            continue
        assert any(file == path or path in file.parents for path in PACKAGED), file
    dependencies = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["dependencies"]
    assert set(PROJECT["project"]["dependencies"]) <= {line.partition(";")[0] for line in dependencies}


def test_runtime_beside_generated_code_needs_only_posix_ipc(tmp_path: Path, topic: str) -> None:
    """Use the copy in a Python without shmgen. A Python with shmgen uses its own runtime, which may be compiled."""
    (tmp_path / "shmgen.toml").write_text('messages = ["std_msgs/Int32"]\nruntime = "beside"\ntargets = ["python"]\n')
    subprocess.run([sys.executable, "-m", "shmgen", "generate", "--quiet"], check=True, cwd=tmp_path)
    generated = tmp_path / "generated" / "python"
    other = tmp_path / "other"
    other.mkdir()
    (other / Path(posix_ipc.__file__).name).symlink_to(posix_ipc.__file__)
    code = f"""
from shm_msgs.std_msgs.msg import Int32, Int32Publisher, Int32Subscriber
with Int32Publisher({topic!r}) as publisher, Int32Subscriber({topic!r}) as subscriber:
    publisher.publish(Int32(data=7))
    print(subscriber.read().data)
import shmgen.runtime
print(shmgen.runtime.__file__)
"""
    paths = f"import sys; sys.path[:0] = [{str(generated)!r}, {str(other)!r}]\n"
    bare = subprocess.run([sys.executable, "-I", "-S", "-c", paths + code], capture_output=True, text=True)
    assert bare.stdout.split() == ["7", f"{generated}/shm_msgs/_beside/shmgen/runtime/__init__.py"], bare.stderr
    installed = subprocess.run([sys.executable, "-c", paths + code], capture_output=True, text=True)
    assert installed.stdout.split() == ["7", f"{REPOSITORY}/src/shmgen/runtime/__init__.py"], installed.stderr
    files = {file for path in PACKAGED for file in ([path] if path.suffix == ".py" else path.rglob("*.py"))}
    beside = generated / "shm_msgs" / "_beside"
    assert {path.relative_to(beside) for path in beside.rglob("*.py")} == {
        path.relative_to(REPOSITORY / "src") for path in files
    }


def test_links_of_the_readme_on_pypi_are_absolute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reject relative links. Each link to the repository names an existing file or folder, or a picture's bytes."""
    monkeypatch.setenv("SHMGEN_REPOSITORY", "https://example.org/shmgen/")
    metadata = {"version": "1.2.3"}
    build_hook().ReadmeHook(str(REPOSITORY), {}).update(metadata)
    links = re.findall(r"\]\(([^)\s]+)\)", metadata["readme"]["text"])
    ours = [link.removeprefix("https://example.org/shmgen/") for link in links if "example.org" in link]
    assert len(ours) > 20
    assert not [link for link in links if "://" not in link and not link.startswith("#")]
    for link in ours:
        kind, path = re.fullmatch(r"(raw|blob|tree)/v1\.2\.3/([^#]+).*", link).groups()
        assert (REPOSITORY / path).is_dir() == (kind == "tree"), link
        assert (kind == "raw") == path.endswith((".svg", ".gif")), link
    assert metadata["urls"]["Changelog"] == "https://example.org/shmgen/blob/v1.2.3/CHANGELOG.md"


@pytest.mark.parametrize(
    ("of", "name", "value"),
    [
        (sysconfig, "get_config_var", {"Py_GIL_DISABLED": 1}.get),  # a free-threaded Python
        (sys, "implementation", SimpleNamespace(name="pypy")),
        (sys, "platform", "darwin"),
    ],
)
def test_extension_is_compiled_only_for_cpython_on_linux(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of: object, name: str, value: object
) -> None:
    compiled = build_hook().build_extension
    monkeypatch.delenv("SHMGEN_PURE", raising=False)
    with monkeypatch.context() as other_python:
        other_python.setattr(of, name, value)
        note = compiled(tmp_path / "_core.abi3.so")
    assert (note, [*tmp_path.iterdir()]) == ("the extensions require Linux and CPython with the GIL", [])


def test_wheel_generates_without_jinja(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Render with the templates that the build compiled into Python. The output is the same."""
    pose = Config(tmp_path, messages=("geometry_msgs/Pose",))
    texts = pipeline.generate(pose, pose.messages)
    ((module, place),) = build_hook().compiled_templates(tmp_path).items()
    assert place == "shmgen/generator/renderers.py"
    templates = tmp_path / "templates"
    shutil.copytree(render.template_folder(), templates, ignore=shutil.ignore_patterns("*.j2"))
    monkeypatch.setattr(render, "template_folder", lambda: templates)
    monkeypatch.setattr(render, "_renderers", render._renderers.__wrapped__)
    monkeypatch.setenv("SHMGEN_NO_CACHE", "1")
    monkeypatch.setitem(sys.modules, "jinja2", None)
    monkeypatch.delitem(sys.modules, "shmgen.generator.templates", raising=False)
    with pytest.raises((ImportError, KeyError)):
        pipeline.generate(pose, pose.messages)
    renderers = ModuleType(render.RENDERERS_MODULE)
    exec(Path(module).read_text(), vars(renderers))
    monkeypatch.setitem(sys.modules, render.RENDERERS_MODULE, renderers)
    assert pipeline.generate(pose, pose.messages) == texts


@pytest.mark.parametrize(
    "text", ["{{ view.a | upper }}", "{% for a, b in view %}{% endfor %}", "{% if view == 1 %}{% endif %}"]
)
def test_template_with_logic_is_rejected(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.j2").write_text(text)
    with pytest.raises(ValueError, match="a template holds "):
        compile_templates(tmp_path)


def test_compiled_template_prints_its_text_unchanged(tmp_path: Path) -> None:
    """Copy quotes, braces and special characters. A nested loop may use the variable name of the outer loop."""
    loops = "{% for x in view.a %}{% for x in x.b %}{{ x }}{% endfor %}{{ x.c }}{% endfor %}\n"
    text = "'\"\"\"{ñ}\\n\t{{ '{{' }}{% if view.no %}no{% else %}yes{% endif %}" + loops
    (tmp_path / "a.j2").write_text(text)
    scope: dict[str, Any] = {}
    exec(compile_templates(tmp_path), scope)
    view = SimpleNamespace(no="", a=[SimpleNamespace(b=[1, 2], c="c"), SimpleNamespace(b=[], c="d")])
    assert scope["PRINTERS"]["a.j2"](view) == '\'"""{ñ}\\n\t{{yes12cd'


def test_generated_code_names_the_missing_runtime(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "shmgen", "generate", "-q", "-t", "python", "std_msgs/Bool"]
    subprocess.run(command, cwd=tmp_path, check=True)
    code = "import sys; sys.path[:0] = ['generated/python']; import shm_msgs.std_msgs.msg"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, cwd=tmp_path)
    message = "shm_msgs needs shmgen: install shmgen, or shmgen-runtime alone, into this Python"
    assert done.stderr.splitlines()[-1] == f"ModuleNotFoundError: {message}"
