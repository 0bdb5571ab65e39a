"""Test awkward names with real compilers and interpreters, and check the list in reserved_words.md."""

from __future__ import annotations

import ctypes
import keyword
import random
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.core.diagnostics import Rejected
from shmgen.core.model import Layouts, TypeName
from shmgen.generator import pipeline
from shmgen.targets.c import names as c_names
from shmgen.targets.python import names as python_names
from shmgen.targets.st import names as st_names

from ..support import plc_bytes
from ..support.build import MAX_REGION, put
from ..support.schemas import plain, random_message

BUILTINS = "bool bytes bytearray dict float int len list memoryview object print property self set str super tuple type"
GENERATED = "at cls ctypes data error into late message runtime staticmethod struct typing values"
ATTRIBUTES = (
    "cuts decode encode encode_counted names names_ objects fields fields_ pack_ digest_ regions_ set_defaults topic"
)
MACROS = "linux unix i386 errno stdin stdout stderr complex NAN INFINITY I EOF NULL BUFSIZ st_mtime sa_handler si_value"
WORDS = {
    "python": " ".join(["match", "case", BUILTINS, GENERATED, ATTRIBUTES, *keyword.kwlist]),
    "c": " ".join([MACROS, *sorted(c_names.C_RESERVED)]),
    "st": " ".join(sorted(word.lower() for word in st_names.ST_RESERVED if "_to_" not in word.lower())),
}
KINDS = {"numbers": "uint8 {}", "texts": "string {}", "arrays": "uint8[3] {}", "long": "string[50] {}"}
HEADERS = """assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg
    stdbool stddef stdint stdio stdlib string time uchar wchar wctype sys/types sys/stat sys/socket netinet/in
    unistd fcntl pthread semaphore sched poll dirent"""


def unique_words(text: str) -> list[str]:
    """Return the words of `text` without duplicates."""
    return list(dict.fromkeys(text.split()))


def generate(folder: Path, package: str, texts: dict[str, str], targets: tuple[str, ...]) -> Layouts:
    """Write generated files to `folder`, and return the layouts. ROS 1's dialect accepts any letters in names."""
    put({f"msgs/{name}.msg": text for name, text in texts.items()}, folder)
    config = Config(
        folder, source="noetic", path=(folder / "msgs",), package=package, targets=targets, max_region=MAX_REGION
    )
    names = sorted({name.partition("/")[0] for name in texts})
    put(pipeline.generate(config, names), folder)
    return pipeline.lay_out(config, names)


def messages_with(text: str, kinds: Iterable[str] = KINDS) -> dict[str, str]:
    """Return a message of each kind with all words as fields, and a message with all words as constants."""
    messages = {
        f"odd_msgs/msg/{kind.title()}": "".join(line.format(word) + "\n" for word in unique_words(text))
        for kind, line in KINDS.items()
        if kind in kinds
    }
    constants = "".join(f"uint8 {word}={number % 256}\n" for number, word in enumerate(unique_words(text)))
    return {**messages, "odd_msgs/msg/Constants": constants + "string text\n"}


def as_genpy_message(message: object) -> object:
    """Rename attributes as genpy does, which appends an underscore to keywords."""
    for name in list(vars(message)):
        if python_names.python_member(name) != name:
            setattr(message, python_names.python_member(name), vars(message).pop(name))
    return message


def test_reserved_words_work_as_names_in_python(tmp_path: Path) -> None:
    layouts = generate(tmp_path, "shm_odd_python", messages_with(WORDS["python"]), ("python",))
    for name, layout in layouts.items():
        kind, _, _ = plc_bytes.classes(tmp_path, "shm_odd_python", name)
        message = as_genpy_message(random_message(layout, layouts, random.Random(1)))
        own = kind._from_object(message)
        data = bytes(own)
        assert plain(own) == plain(message), name
        assert bytes(kind(**{field: getattr(own, field) for field in own._names_})) == data
        kind._decode(data, message)
        assert plain(own) == plain(message), name
        assert (own == kind.from_buffer_copy(data), "(" in repr(own)) == (True, True)
        for constant in layout.message.constants:
            assert getattr(kind, python_names.python_member(constant.name)) == constant.value


def test_keywords_are_reserved_and_ctypes_adds_no_names() -> None:
    """Reserve all keywords of Python. ctypes structures have no public attributes, so no other words are necessary."""
    assert set(keyword.kwlist) <= python_names.PYTHON_RESERVED
    assert not [name for name in dir(ctypes.Structure) if not name.startswith("_")]


@pytest.mark.parametrize("compiler", ["gcc -std=gnu11", "gcc -std=c11", "g++ -std=gnu++17", "gcc -std=gnu2x"])
def test_reserved_words_work_as_names_in_c(compiler: str, tmp_path: Path) -> None:
    """Put the headers of C and POSIX first to define their macros; generated headers assert all offsets."""
    generate(tmp_path, "shm_odd_c", messages_with(WORDS["c"]), ("c",))
    plus = compiler.startswith("g++")
    lines = [f"#include <{name}.h>\n" for name in HEADERS.split() if not (plus and name == "complex")]
    lines += [f'#include "shm_odd_c/odd_msgs/msg/{kind}.h"\n' for kind in (*KINDS, "constants")]
    command = [*compiler.split(), "-Wall", "-Werror", f"-I{tmp_path}/c", "-fsyntax-only", f"-xc{'++' * plus}", "-"]
    result = subprocess.run(command, input="".join(lines), capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr[:3000]


def test_lower_case_macros_are_reserved() -> None:
    """Compare macros in lower case only, because fields of ROS 2 are in lower case."""
    lines = "".join(f"#include <{name}.h>\n" for name in HEADERS.split())
    output = subprocess.run(["gcc", "-dM", "-E", "-"], input=lines, capture_output=True, text=True, check=True).stdout
    names = {line.split()[1] for line in output.splitlines()}
    assert {name for name in names if name.isidentifier() and name[0].islower()} <= c_names.C_RESERVED


@pytest.mark.slow
def test_reserved_words_work_as_names_in_structured_text(tmp_path: Path) -> None:
    layouts = generate(tmp_path, "shm_odd_st", messages_with(WORDS["st"], ["numbers"]), ("st",))
    texts = {str(path): path.read_text() for path in (tmp_path / "st").rglob("*.st")}
    plc = plc_bytes.compile_st(texts)
    for name, layout in layouts.items():
        plc_bytes.assert_compiled_as_laid_out(plc, name, layout)
    constants = plc.globals("GVL_odd_msgs_Constants")
    for constant in layouts[TypeName("odd_msgs", "msg", "Constants")].message.constants:
        assert getattr(constants, st_names.st_member(constant.name)) == constant.value


TYPES = (
    "int str struct values runtime ctypes typing memoryview staticmethod bool from None Message Publisher Time String"
)


@pytest.mark.slow
def test_reserved_words_work_as_types_and_packages(tmp_path: Path) -> None:
    messages = {f"lambda/msg/{name}": "uint8 x\nuint8[3] data\n" for name in TYPES.split()}
    inside = "".join(f"lambda/{name} {name}_1\nlambda/{name}[2] {name}_2\n" for name in TYPES.split())
    layouts = generate(tmp_path, "shm_types", {**messages, "async/msg/All": inside}, ("python", "c", "st"))
    name = TypeName("async", "msg", "All")
    kind = plc_bytes.classes.__globals__["module"](tmp_path, "shm_types", name._replace(package="async_")).All
    message = random_message(layouts[name], layouts, random.Random(2))
    assert plain(kind._from_object(message)) == plain(message)
    headers = "".join(f'#include "{path.relative_to(tmp_path / "c")}"\n' for path in (tmp_path / "c").rglob("*.h"))
    for language in ("c", "c++"):
        command = [
            {"c": "gcc", "c++": "g++"}[language],
            f"-x{language}",
            "-Wall",
            "-Werror",
            f"-I{tmp_path}/c",
            "-fsyntax-only",
            "-",
        ]
        result = subprocess.run(command, input=headers, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr[:3000]
    plc_bytes.compile_st({str(path): path.read_text() for path in (tmp_path / "st").rglob("*.st")})


CLASHES = {
    "escaped": ({"odd_msgs/msg/A": "uint8 type\nuint8 type_\n"}, ["SHM203"]),
    "case": ({"odd_msgs/msg/A": "uint8 gain\nuint8 Gain\n"}, ["SHM203"]),
    "underscores": ({"odd_msgs/msg/A": "uint8 a__b\nuint8 a_b\n"}, ["SHM203"]),
    "a keyword": ({"odd_msgs/msg/A": "uint8 class\nuint8 class_\n"}, ["SHM203"] * 3),
    "a macro": ({"odd_msgs/msg/A": "uint8 linux\nuint8 linux_\n"}, ["SHM203"]),
    "a type and a constant": (
        {"odd_msgs/msg/A": "uint8 B=1\nuint8 x\n", "odd_msgs/msg/A_B": "uint8 x\n"}, ["SHM203"]),
    "two packages": ({"a/msg/b_C": "uint8 x\n", "a_b/msg/C": "uint8 x\n"}, ["SHM203"] * 2),
    "classes": ({"odd_msgs/msg/A": "uint8 x\n", "odd_msgs/msg/APublisher": "uint8 x\n"}, ["SHM203"]),
    "a class with an underscore": ({"odd_msgs/msg/int": "uint8 x\n", "odd_msgs/msg/int_": "uint8 x\n"}, ["SHM203"] * 3),
    "added by shmgen": ({"odd_msgs/msg/A": "uint8 SHM_SIZE=1\nuint8 x\n"}, ["SHM204"]),
}  # fmt: skip


@pytest.mark.parametrize("clash", CLASHES)
def test_name_clashes_are_rejected(clash: str, tmp_path: Path) -> None:
    messages, codes = CLASHES[clash]
    with pytest.raises(Rejected) as rejected:
        generate(tmp_path, "shm_clash", messages, ("python", "st", "plcopen", "c"))
    assert [each.code for each in rejected.value.diagnostics] == codes


def test_similar_names_of_real_packages_compile(tmp_path: Path) -> None:
    """Compile messages `X` and `X_type`, as in kortex_driver, and a service and an action of one name."""
    put({
        "msgs/odd_msgs/msg/A.msg": "uint8 x\n", "msgs/odd_msgs/msg/A_type.msg": "uint8 x\n",
        "msgs/odd_msgs/msg/Go_interface.msg": "uint8 x\n",
        "msgs/odd_msgs/srv/Go.srv": "---\n", "msgs/odd_msgs/action/Go.action": "---\n---\n",
    }, tmp_path)  # fmt: skip
    config = Config(tmp_path, source="noetic", path=(tmp_path / "msgs",), package="shm_odd", targets=("c", "cpp"))
    put(pipeline.generate(config, ["odd_msgs"]), tmp_path)
    for folder, language, pattern in (("c", "c", "*.h"), ("cpp", "c++", "*.hpp")):
        headers = [path.relative_to(tmp_path / folder) for path in (tmp_path / folder).rglob(pattern)]
        including = "".join(f'#include "{header}"\n' for header in headers)
        command = ["g++" if language == "c++" else "gcc", f"-x{language}", "-Wall", "-Werror", "-fsyntax-only", "-"]
        command += [f"-I{tmp_path / each}" for each in ("c", "cpp")]
        result = subprocess.run(command, input=including, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr[:3000]


PAGE = Path(__file__).parent / "reserved_words.md"


def test_reserved_words_page_matches_the_corpus(corpus: Path, update_golden: bool) -> None:
    text = PAGE.read_text()
    before, mark, rest = text.partition("| name | what |")
    _, blank, after = rest.partition("\n\n")
    expected = before + "\n".join(table_lines(corpus)) + blank + after
    if update_golden:
        PAGE.write_text(expected)
    assert mark
    assert text == expected


def table_lines(corpus: Path) -> list[str]:
    """Return a Markdown table of the names in real packages that a target changes."""
    rows: dict[tuple[str, ...], set[str]] = {}
    for distribution in ("noetic", "jazzy"):
        config = Config(corpus, source=distribution, path=(corpus / distribution,))
        for message in pipeline.read(config, plc_bytes.corpus_names(config)).messages:
            typed_names = [("field", field.name) for field in message.fields]
            typed_names += [("constant", constant.name) for constant in message.constants]
            for what, name in typed_names:
                c = c_names.c_member(name) if what == "field" else name
                targets = st_names.st_member(name), python_names.python_member(name), c
                if set(targets) != {name}:
                    rows.setdefault((name, what, *targets), set()).add(message.name.short)
    lines = ["| name | what | met in | Structured Text | Python | C |", "|---|---|---|---|---|---|"]
    for (name, what, *targets), messages in sorted(rows.items(), key=lambda row: (row[0][0].lower(), row[0])):
        example = min(messages) + (f" and {len(messages) - 1} more" if len(messages) > 1 else "")
        lines.append(f"| `{name}` | {what} | {example} | " + " | ".join(f"`{target}`" for target in targets) + " |")
    return lines
