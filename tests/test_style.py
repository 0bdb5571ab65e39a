"""Docstrings, comments and names read plainly: no forbidden opening, word or name, and no sentence that is too long.

The rules are those of CONTRIBUTING.md, section "Words". Each count below may only go down.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from .conftest import REPOSITORY

MOST = {"opening": 0, "word": 0, "long sentence": 0, "no verb": 0, "name": 0}
"""The number of findings of each kind. A commit that lowers a number writes the lower number here."""

OPENINGS = ("Of ", "As ", "What ", "Who ", "So many ", "The same ", "That ", "Where ")
"""A sentence with one of these openings points at something that the reader does not know yet."""
LONGEST = 30
"""The largest number of words in a sentence."""
WORDS = re.compile(
    r"(?<!`)\b(heals?|healed|mends?|mended|complains?|complained|patience|awhile|stranger|"
    r"anew|again and again|all the same|as ever|but for|tells?|told|is said|are said|lets go of|let go of|room|"
    r"come and go|by itself|turns? round|counts? up|send out|stands? still|stood still|at hand)\b(?!`)"
)
"""Words that the field does not use. The table of CONTRIBUTING.md contains a better word for each."""
NAMES = frozenset(
    "said made came told kept taken given found held met heard meant gone sought shown wanted asked".split()  # noqa: SIM905
)
"""Past participles that say nothing alone: a value is a noun phrase, a function a verb phrase."""
ENDINGS = re.compile(r"(?<=[.:;])\s+(?=[A-Z`])|\n\s*\n|\n\s*\* ")


class Finding(NamedTuple):
    """One thing to rewrite."""

    kind: str
    place: str
    text: str


def test_number_of_findings_does_not_grow() -> None:
    findings = list(all_findings())
    counts = Counter(finding.kind for finding in findings)
    worse = [kind for kind in MOST if counts[kind] > MOST[kind]]
    lines = [f"{finding.place}: {finding.kind}: {finding.text}" for finding in findings if finding.kind in worse]
    assert not worse, f"{worse}: {counts}\n" + "\n".join(lines[-40:])
    assert {kind: counts[kind] for kind in MOST} == MOST, "fewer than before: write the lower numbers into MOST"


FOLDERS = ("src", "templates", "packaging", "benchmarks", "docs", "tests", "examples", "contrib", ".ci", ".github")
OTHERS = {"cases", "added", "build", "errors", "expected"}
"""Folders with generated files, with faulty input for tests, or with files that tests add."""
C_LIKE = (".h", ".hpp", ".st", ".c", ".cpp", ".j2", ".pml", ".js", ".css")
WITH_HASH = (".toml", ".yml", ".yaml", ".cmake", ".sh", "Makefile", "Dockerfile", "run")
"""Endings of files whose comments begin with `#`."""


def all_findings() -> Iterator[Finding]:
    files = (file for folder in FOLDERS for file in (REPOSITORY / folder).rglob("*"))
    for file in sorted([*REPOSITORY.glob("*"), *files]):
        if OTHERS & set(file.parts) or not file.is_file():
            continue
        if file.suffix == ".py":
            yield from python_findings(file)
        elif file.suffix in C_LIKE:
            yield from comment_findings(file)
        elif file.name.endswith(WITH_HASH):
            yield from hash_findings(file)


def hash_findings(file: Path) -> Iterator[Finding]:
    """Yield the findings in comments that begin with `#`. Comments in lines that follow each other are one comment."""
    text = re.sub(r"\n[ \t]*#[ \t]*(?=[a-z`(])", " ", file.read_text())
    for match in re.finditer(r"(?:^|\s)#+ ([^\n]*)", text):
        yield from prose_findings(
            f"{file.relative_to(REPOSITORY)}:{text.count(chr(10), 0, match.start()) + 1}", match[1]
        )


STRING_OR_COMMENT = re.compile(
    r""""{3}.*?"{3}|'{3}.*?'{3}|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'|(#[^\n]*)""", re.DOTALL
)


def python_findings(file: Path) -> Iterator[Finding]:
    """Yield the findings in docstrings, comments, and names of one module."""
    text, place = file.read_text(), str(file.relative_to(REPOSITORY))
    nodes = list(ast.walk(ast.parse(text)))
    for node in nodes:
        is_documented = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module)
        if is_documented and (doc := ast.get_docstring(node)):
            yield from prose_findings(
                f"{place}:{getattr(node, 'lineno', 1)}", re.sub(r"\x08.*?(\n\n|$)", "", doc, flags=re.DOTALL)
            )
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not is_property(node):
                yield from verb_findings(f"{place}:{node.lineno}", doc)
        for name in bound_names(node):
            if name.strip("_") in NAMES:
                yield Finding("name", f"{place}:{getattr(node, 'lineno', 0)}", name)
    for body in (node.body for node in nodes if isinstance(node, ast.ClassDef | ast.Module)):
        for before, after in pairwise(body):
            is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if isinstance(before, ast.Assign | ast.AnnAssign) and is_text and isinstance(after.value.value, str):
                yield from prose_findings(f"{place}:{after.lineno}", after.value.value)
    for match in STRING_OR_COMMENT.finditer(text):
        if (comment := match[1]) and not re.match(r"# (noqa|type:|fmt|ruff|pragma)", comment):
            yield from prose_findings(f"{place}:{text.count(chr(10), 0, match.start()) + 1}", comment.lstrip("# "))


def bound_names(node: ast.AST) -> Iterator[str]:
    """Yield the names that a function, a class, a parameter or an assignment introduces."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.arg):
        yield node.arg
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        yield node.id


def is_property(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return True for a property and a fixture of pytest: a noun phrase documents both."""
    return any(re.search("property|fixture", ast.unparse(decorator)) for decorator in node.decorator_list)


def prose_findings(place: str, text: str) -> Iterator[Finding]:
    for sentence in ENDINGS.split(text):
        words = sentence.split()
        if sentence.lstrip().startswith(OPENINGS):
            yield Finding("opening", place, " ".join(words[:12]))
        if len(words) > LONGEST:
            yield Finding("long sentence", place, " ".join(words[:12]))
        yield from (Finding("word", place, word.group()) for word in WORDS.finditer(sentence))


VERBS = frozenset(
    """
    abandon acknowledge advance share advertise announce configure correct diagnose disable redirect restrict support
    accept acquire add adopt allow answer append apply arm ask assert assign attach await begin bind block bound
    break bring build calculate call cancel carry change check choose claim clean clear close collect combine
    compare compile complete compress compute connect consume convert copy count create cut decide decode
    decompress define delete deliver derive describe detach determine discard discover disconnect display divide
    do double draw drop dump encode end enter erase escape estimate evaluate exit expand expect explain export
    extend extract fail fetch fill find finish flush fold follow force forget format forward free freeze
    generate get give group guard hand handle hold identify ignore import indent infer initialize insert inspect
    install invalidate iterate join keep know lay leave let limit link list listen load locate lock log look
    lower make map mark match measure merge migrate move name narrow need normalize note notify observe offer
    omit open order overwrite own pack parse pass patch pick place plan play point poll post prefer prepare
    prevent print process produce promise propose protect provide publish put query queue quote raise read
    rebuild receive record recover recreate redraw reduce refer refuse register reject release reload remember
    remove rename render reopen repair repeat replace reply report request require reserve reset resize resolve
    respond restart restore resume retire retry return reverse rewrite round run save scale scan search select
    send separate serve set shape shift shorten show shut skip sleep sort split spell start stay step stop store
    stream strip subscribe substitute subtract suggest suspend swap switch synchronize take tear tell terminate
    test time toggle track transform translate trim truncate try turn undo unmap unpack unregister update use
    execute pretend trace validate verify wait wake walk warn watch wrap write yield
    """.split()  # noqa: SIM905
)


def verb_findings(place: str, doc: str) -> Iterator[Finding]:
    """Yield a finding if a function's docstring does not begin with a verb in the imperative."""
    first = re.match(r"[A-Za-z]+", doc)
    if first is None or first.group().lower() not in VERBS:
        yield Finding("no verb", place, doc.splitlines()[0][:90])


C_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
ST_COMMENT = re.compile(r"\(\*.*?\*\)|//[^\n]*", re.DOTALL)


def comment_findings(file: Path) -> Iterator[Finding]:
    """Yield the findings in comments of C, C++ and Structured Text, and in the names of C and C++.

    Lines of `//` that follow each other are one comment.
    """
    text = file.read_text()
    joined = re.sub(r"\n[ \t]*//[ \t]*(?=[a-z`(])", " ", text)
    comment = ST_COMMENT if ".st" in file.suffixes else C_COMMENT
    if comment is C_COMMENT:
        code = re.sub(r'"(\\.|[^"\\\n])*"', "", C_COMMENT.sub("", text))
        for name in sorted(NAMES.intersection(word.strip("_") for word in re.findall(r"[A-Za-z_]\w*", code))):
            yield Finding("name", str(file.relative_to(REPOSITORY)), name)
    for match in comment.finditer(joined):
        prose = re.sub(r"\n\s*\*(?!/)", " ", match.group()).strip("/*() \n")
        yield from prose_findings(
            f"{file.relative_to(REPOSITORY)}:{joined.count(chr(10), 0, match.start()) + 1}", prose
        )
