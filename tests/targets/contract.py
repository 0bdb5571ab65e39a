"""What every target must keep, whatever its language: checks that take a Target and raise AssertionError.

Nothing in them knows a language. A message with harmless names is compared with one whose words are hostile: what is
code must be the same, token by token, but for the names; each harmless name must have become one other name, no two the
same, and none a word of the language. Or the target has said SHM203 or SHM204.
"""

from __future__ import annotations

import functools
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

from shmgen import config
from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Rejected, Report, Span
from shmgen.core.model import Layout, Layouts, Role
from shmgen.generator import pipeline
from shmgen.targets import TARGETS, Job, Target
from shmgen.targets.naming import Names

from ..support.build import put
from ..support.languages import language

Check = Callable[[Target], None]

ASCII = r"""
*) (* */ /* // \""" ''' ]]> <!-- --> ?> </xhtml> <![CDATA[ &lt; {{ }} {% %} {# #} {attribute ${x} %s %(x)s {0}
$' $N $" $$ ' " ` \ \n \u0041 \N{DIGIT \x41 ??/ ??' *??/ *\ END_STRUCT END_TYPE #endif #include import os; exec(1)
[m] [m/s] [i] # ## === --- """
PIECES = [
    *ASCII.split(),
    "\N{LINE SEPARATOR}", "\x85", "\N{RIGHT-TO-LEFT OVERRIDE}", "\N{RIGHT-TO-LEFT ISOLATE}", "\N{ZERO WIDTH SPACE}",
    "\ufeff", "\N{SUPERSCRIPT TWO}", "\U0001f916", "\ue000", "a\u0301", "\N{FULLWIDTH QUOTATION MARK}",
    "\N{FULLWIDTH ASTERISK}\N{FULLWIDTH RIGHT PARENTHESIS}", "\N{FULLWIDTH REVERSE SOLIDUS}", "\N{MIDDLE DOT})",
    "(\N{BULLET}", "*\N{DIVISION SIGN}", "\N{DIVISION SIGN}*", "\N{RIGHT SINGLE QUOTATION MARK}", '"' * 3, '"' * 4,
]  # fmt: skip
"""Words that end, begin or escape something somewhere, and letters that become them when they are made ASCII."""


# --- making files -----------------------------------------------------------------------------------------


def printed(target: Target, files: Mapping[str, str], order: int = 1) -> dict[str, str]:
    """{path: text} for definitions by `package/msg/Name.msg`, each on a topic of its own. Raises Rejected.

    `order` -1 asks for them from the last to the first.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        put({f"msgs/{path}": text for path, text in files.items()}, folder)
        types = [path.removesuffix(".msg").replace("/msg/", "/") for path in files if path.endswith(".msg")]
        topics = [f'[[topics]]\ntopic = "/t{number}"\ntype = "{type_}"\n' for number, type_ in enumerate(types)]
        bounds = sorted({f"{path.partition('/')[0]} = 4\n" for path in files})
        lines = ['source = "noetic"\npath = ["msgs"]\n[strings]\ndefault = 100\n[bounds]\n', *bounds, *topics]
        (folder / "shmgen.toml").write_text("".join(lines))
        settings = config.load(folder / "shmgen.toml", "shmgen.toml", Report())
        requests = [path.rpartition(".")[0] for path in files]
        return planned(target, settings, pipeline.lay_out(settings, requests[::order]))


def planned(target: Target, settings: Config, layouts: Layouts) -> dict[str, str]:
    others = [other for other in TARGETS if other.key != target.key]
    report = Report()
    job = pipeline.job_of(settings, pipeline.lay_out(settings, [*map(str, layouts), *settings.types_used]), report)
    return pipeline.render_targets([*others, target], [target.key], job, report)


def tokens(texts: Mapping[str, str]) -> list[list[str]]:
    """Of each file, as it was planned."""
    return [language(path).tokens(text) for path, text in texts.items()]


def accepted(texts: Mapping[str, str]) -> None:
    """By whatever reads them."""
    kinds = {id(language(path)): language(path) for path in texts}
    for number, kind in kinds.items():
        kind.accepts({path: text for path, text in texts.items() if id(language(path)) == number})


def same_but_for_names(harmless: Mapping[str, str], hostile: Mapping[str, str], why: str) -> None:
    """Token by token; each name became one other, no two the same, all names still, and none a word of the language."""
    assert len(harmless) == len(hostile), f"{why}: other files"
    became: dict[tuple[int, str], str] = {}
    came_from: dict[tuple[int, str], str] = {}
    for (path, one), (other_path, other) in zip(harmless.items(), hostile.items(), strict=True):
        kind = language(path)
        for before, after in zip_longest(kind.tokens(one), kind.tokens(other)):
            place = f"{why}, in {other_path}: `{before}` became `{after}`"
            assert before is not None, place
            assert after is not None, place
            if _TEXT.match(before) and _TEXT.match(after):
                continue  # in quotes nothing meets
            known = became.setdefault((id(kind), before), after)
            assert known == after, f"{place} and `{known}`"
            first = came_from.setdefault((id(kind), kind.folded(after)), before)
            assert kind.folded(first) == kind.folded(before), f"{place}, and so did `{first}`"
            assert before == after or kind.folded(after) not in kind.keywords, place
            assert "zq" not in before or not kind.is_name(before) or kind.is_name(after), f"{place}, which is no name"


_TEXT = re.compile(r"\w?['\"]")


# --- the checks --------------------------------------------------------------------------------------------


def comments_stay_comments(target: Target) -> None:
    """Each piece in a comment of its own, as its end, its beginning and all of it; and in the message's."""

    def definition(pieces: Sequence[str], unit: str) -> str:
        top = "".join(f"# {piece}\n#x{piece}\n" for piece in pieces)
        fields = "".join(
            f"uint8 a{number}  # {piece}\nuint8[2] b{number}  # x{piece} y\n# {piece}x\nstring c{number}\n"
            for number, piece in enumerate(pieces)
        )
        constants = "".join(f"uint8 C{number}=1  # {piece}\n" for number, piece in enumerate(pieces))
        units = "".join(f"float64 u{number}  # [m{piece if unit else unit}]\n" for number, piece in enumerate(pieces))
        return f"{top}\n{constants}\n{fields}{units}uint8 last  # {pieces[-1]}\\\n"

    clean = ["c"] * len(PIECES)
    harmless = printed(target, {"zq_msgs/msg/Foo.msg": definition(clean, "")})
    hostile = printed(target, {"zq_msgs/msg/Foo.msg": definition(PIECES, "m")})
    assert list(harmless) == list(hostile)
    for path, one in zip(harmless, tokens(harmless), strict=True):
        assert one == language(path).tokens(hostile[path]), f"a comment left its place in {path}"
    accepted(hostile)


def texts_stay_texts(target: Target) -> None:
    """Constants of text, one piece each, beside one of the same length that is harmless."""
    ascii_pieces = [piece.replace("#", "") for piece in PIECES if piece.isascii() and piece.replace("#", "")]

    def definition(pieces: Iterable[str]) -> str:
        return "".join(f"string S{number}={piece}\n" for number, piece in enumerate(pieces)) + "uint8 x\n"

    hostile = printed(target, {"zq_msgs/msg/Foo.msg": definition(ascii_pieces)})
    harmless = printed(target, {"zq_msgs/msg/Foo.msg": definition("z" * len(piece) for piece in ascii_pieces)})
    assert list(harmless) == list(hostile)
    for path, one in zip(harmless, tokens(harmless), strict=True):
        for before, after in zip_longest(one, language(path).tokens(hostile[path])):
            both = before and after and _TEXT.match(before) and _TEXT.match(after)
            assert before == after or both, f"in {path}, {before} became {after}"
    accepted(hostile)


def words_are_escaped(target: Target) -> None:
    """Each word of its languages as a field, as a constant, as a message and as a package."""
    words = _words(target)
    clean = [f"zq{number}z" for number in range(len(words))]
    for form in ("uint8 {}\n", "string {}\n", "uint8[3] {}\n", "uint8 {}=1\n", "zq_msgs/Part {}\n"):
        files = [
            {"zq_msgs/msg/Foo.msg": "".join(map(form.format, names)) + "uint8 x\n", "zq_msgs/msg/Part.msg": "uint8 x\n"}
            for names in (clean, words)
        ]
        one, other = (printed(target, made) for made in files)
        same_but_for_names(one, other, form.strip())
        accepted(other)
    for word in [*filter(str.istitle, words), "Array", "Step", "Type", "String", "Time"]:
        one, other = (printed(target, {f"zq_msgs/msg/{name}.msg": "uint8 x\n"}) for name in (_alike(word), word))
        same_but_for_names(one, other, f"a message {word}")
        accepted(other)
    packages = [word for word in words if re.fullmatch("[a-z][a-z]+", word)]
    for word in packages[::6]:
        same_but_for_names(*(printed(target, _packages([name])) for name in (_alike(word), word)), f"a package {word}")
    accepted(printed(target, _packages(packages)))


def _packages(names: Iterable[str]) -> dict[str, str]:
    """And a message that holds one of each."""
    files = {f"{name}/msg/Bar.msg": "uint8 x\n" for name in names}
    return {**files, "zz_msgs/msg/Foo.msg": "".join(f"{name}/Bar {name}_1\n" for name in names)}


def _words(target: Target) -> list[str]:
    """Those of the languages that it writes, small where one of them ignores case."""
    kinds = [language(path) for path in printed(target, {"zq_msgs/msg/Foo.msg": "uint8 x\n"})]
    small = any(kind.ignores_case for kind in kinds)
    return sorted({word.lower() if small else word for kind in kinds for word in kind.keywords})


def _alike(word: str) -> str:
    """As long, and in the same place of a sorted list."""
    return word[0] + "q" * (len(word) - 1)


def clashes_are_told(target: Target) -> None:
    """Two names that a language might take for one: either both are there, or the user hears SHM203 or SHM204."""
    words = _words(target)[::6]
    fields = [(word, f"{word}_") for word in words]
    fields += [("gain", "Gain"), ("a_b", "a__b"), ("a_b", "aB"), ("x", "x_"), ("aB", "AB")]
    for form in ("uint8 {}\nuint8 {}\n", "uint8 {}=1\nuint8 {}=2\nuint8 x9\n", "uint8[3] {}\nuint8 {}\n"):
        for pair in fields:
            _told_or_apart(target, [{"zq_msgs/msg/Foo.msg": form.format(*names)} for names in (("zqa", "zqb"), pair)])
    _constants_beside_fields(target, [*fields, ("GAIN", "gain"), ("Gain", "gain"), ("gain", "GAIN_")])
    sequence = "uint8[] {}\nuint8 {}\n"
    for pair in (("tail", "tail_count"), ("tail", "n_tail"), ("tail", "tail_len")):
        _told_or_apart(target, [{"zq_msgs/msg/Foo.msg": sequence.format(*names)} for names in (("zqa", "zqb"), pair)])
    for harmless, hostile in MESSAGES:
        files = [
            {f"{name}.msg": f"uint8 B=1\nuint8 x{number}\n" for number, name in enumerate(pair)}
            for pair in (harmless, hostile)
        ]
        _told_or_apart(target, files, accepted)


def _constants_beside_fields(target: Target, pairs: Sequence[tuple[str, str]]) -> None:
    """A target that says that constants have a space of their own is taken at its word, and at the compiler's."""
    form = "uint8 {}=1\nuint8 {}\n"
    giver = next((other for other in TARGETS if other.key in target.after), target)
    names = target.load().NAMES or giver.load().NAMES
    if names and names.constants_apart:
        accepted(printed(target, {f"zq_msgs/msg/Foo{n}.msg": form.format(*pair) for n, pair in enumerate(pairs)}))
        return
    for pair in pairs:
        _told_or_apart(target, [{"zq_msgs/msg/Foo.msg": form.format(*names)} for names in (("zqa", "zqb"), pair)])


MESSAGES = [
    (("a/msg/b_C", "aqb/msg/C"), ("a/msg/b_C", "a_b/msg/C")),
    (("p/msg/FOO", "p/msg/Fqq"), ("p/msg/FOO", "p/msg/Foo")),
    (("p/msg/HTTPStart", "p/msg/HqqpStart"), ("p/msg/HTTPStart", "p/msg/HttpStart")),
    (("p/msg/A", "p/msg/A_C"), ("p/msg/A", "p/msg/A_B")),
    (("p/msg/Start", "p/msg/StartQublisher"), ("p/msg/Start", "p/msg/StartPublisher")),
    (("p/msg/JointState", "p/msg/Joint_Stqte"), ("p/msg/JointState", "p/msg/Joint_State")),
    (("class/msg/A", "classq/msg/B"), ("class/msg/A", "class_/msg/B")),
    (("a_b/msg/C", "a_q_b/msg/C"), ("a_b/msg/C", "a__b/msg/C")),
]


@functools.cache
def _printed_once(target: Target, files: tuple[tuple[str, str], ...]) -> dict[str, str]:
    return printed(target, dict(files))


def _told_or_apart(
    target: Target, files: Sequence[Mapping[str, str]], compiler: Callable[[Mapping[str, str]], object] = len
) -> None:
    harmless = _printed_once(target, tuple(files[0].items()))
    why = " and ".join(f"{path}: {text.split()}" for path, text in files[1].items())
    try:
        hostile = printed(target, files[1])
    except Rejected as rejected:
        codes = {found.code for found in rejected.diagnostics}
        assert codes <= {"SHM203", "SHM204", "SHM202"}, why
        return
    same_but_for_names(harmless, hostile, why)
    compiler(hostile)


EMPTY = re.compile(r"python/\w+/py\.typed|ros2/(\w+)/resource/\1")
COPIED = re.compile(r"ros\d/\w+/config/msgs/.*")
"""Files that cannot say who made them: those without a word, and copies of what the user wrote."""
MAKER = re.compile(r"\b(Generated|Made) by shmgen\b")


def files_say_who_made_them(target: Target) -> None:
    """In their first five lines. JSON has no comments."""
    for path, text in everything(target).items():
        if EMPTY.fullmatch(path):
            assert not text.strip(), path
        elif not path.endswith(".json") and not COPIED.fullmatch(path):
            assert MAKER.search("\n".join(text.splitlines()[:5])), f"{path} does not say that shmgen made it"


def files_are_its_own(target: Target) -> None:
    """In the folder of its key, of names that every file system takes, and no two alike where case is ignored."""
    for texts in (everything(target), _store(target)):
        for path in texts:
            assert path.startswith(f"{target.key}/"), path
            assert re.fullmatch(r"(\w+/)*\w+(\.\w+)*", path, re.ASCII), path
        assert len({path.lower() for path in texts}) == len(texts)


def twice_is_the_same(target: Target) -> None:
    """And in whatever order the messages are asked for."""
    files = {f"zq_msgs/msg/M{number}.msg": "uint8 x\n" for number in range(9)}
    first = printed(target, files)
    assert first == printed(target, files)
    turned = printed(target, files, order=-1)
    assert {path: text for path, text in first.items() if "config" not in path} == {
        path: text for path, text in turned.items() if "config" not in path
    }


def every_message_of_the_store(target: Target) -> None:
    """Is taken, read by whatever reads such files, and named as the target says."""
    texts = _store(target)
    accepted(texts)
    names = target.load().NAMES
    words = {token for found in tokens(texts) for token in found}
    for layout in _store_layouts(target).values() if names else ():
        assert names
        all_made = list(names.claims(layout, "shm_msgs"))
        if not all_made:
            continue  # it is nothing to this target
        for made in all_made:
            there = any(path.endswith(made.name) for path in texts) if made.kind == "file" else made.name in words
            assert there or made.kind == "package", made
        for slot in layout.slots:
            assert slot.role is not Role.DATA or names.member(slot.name) in words, (layout.name, slot.name)
    made = {name for layout in _store_layouts(target).values() for name in _made_of(layout, names)}
    for path, found in zip(texts, tokens(texts), strict=True):
        kind = language(path)
        for name in made.intersection(found) if kind.keywords else ():
            assert kind.is_name(name), f"`{name}` is no name in {path}"


def _made_of(layout: Layout, names: Names | None) -> set[str]:
    """What fields, constants and the generator's own members are called, before and after the target's escapes."""
    slots = {slot.name for slot in layout.slots if slot.role is not Role.DATA}
    if names:
        slots |= {names.member(slot.name) for slot in layout.slots}
        slots |= {names.constant(constant.name) for constant in layout.message.constants}
    return slots


CHECKS: tuple[Check, ...] = (
    comments_stay_comments,
    texts_stay_texts,
    words_are_escaped,
    clashes_are_told,
    files_say_who_made_them,
    files_are_its_own,
    twice_is_the_same,
    every_message_of_the_store,
)


def everything(target: Target) -> dict[str, str]:
    """Of a project that uses all there is."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        put({f"msgs/{path}": text for path, text in ALL.items()}, folder)
        (folder / "shmgen.toml").write_text(ALL_TOML)
        settings = config.load(folder / "shmgen.toml", "shmgen.toml", Report())
        try:
            return planned(target, settings, pipeline.lay_out(settings, ["cell_msgs"]))
        except Rejected as rejected:
            _told_only(rejected)
            path = folder / "msgs" / "cell_msgs" / "msg" / "State.msg"
            gone = [found.span.line - 1 for found in rejected.diagnostics]
            lines = path.read_text().splitlines()
            path.write_text("".join(f"{line}\n" for number, line in enumerate(lines) if number not in gone))
            return planned(target, settings, pipeline.lay_out(settings, ["cell_msgs"]))


ALL = {
    "cell_msgs/msg/State.msg": """uint8 OK=1
string NAME=cell
std_msgs/Header header
Part[] parts
string<=8 name "cell"
wstring<=4 wide
float64[3] at [1, 2, 3]
bool on true
builtin_interfaces/Duration took
builtin_interfaces/Time[] stamps
""",
    "cell_msgs/msg/Part.msg": "",
    "cell_msgs/srv/Start.srv": "bool go\n---\nbool ok\n",
    "cell_msgs/action/Move.action": "float64 x\n---\nbool ok\n---\nfloat64 x\n",
}
ALL_TOML = """
path = ["msgs"]
distribution = "cell-shm 1.2.3"
[types]
time = "struct"
[strings]
default = 16
[bounds]
cell_msgs = 3
[[topics]]
topic = "/cell/state"
type = "cell_msgs/State"
[[topics]]
topic = "/cell/command"
type = "cell_msgs/State"
direction = "from_plc"
[[services]]
service = "/cell/start"
type = "cell_msgs/Start"
[[actions]]
action = "/cell/move"
type = "cell_msgs/Move"
"""

_cache: dict[str, Layouts] = {}


def _store_settings() -> Config:
    """Every sequence bounded to 3, each package by one line; a topic for the packages that need one."""
    plain = Config(Path.cwd())
    packages = {entry.name.package for entry in pipeline.inventory(plain)}
    bounds = Bounds({}, {package: Bound(3, Span("shmgen.toml")) for package in packages})
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "shmgen.toml")
        file.write_text('[[topics]]\ntopic = "/pose"\ntype = "geometry_msgs/Pose"\n')
        loaded = config.load(file, "shmgen.toml", Report())
    return Config(Path.cwd(), bounds=bounds, topics=loaded.topics, document=loaded.document)


def _told_only(rejected: Rejected) -> None:
    """What its language has no type for, and nothing else."""
    assert {found.code for found in rejected.diagnostics} == {"SHM305"}, rejected


def _store_layouts(target: Target) -> Layouts:
    """Without what the target cannot hold, and what holds that."""
    if "store" not in _cache:
        settings = _store_settings()
        names = [str(entry.name) for entry in pipeline.inventory(settings)]
        _cache["store"] = pipeline.lay_out(settings, names)
    if target.key not in _cache:
        left = dict(_cache["store"])
        try:
            _print(target, left)
        except Rejected as rejected:
            _told_only(rejected)
            gone = {found.span.path for found in rejected.diagnostics}
            for name, layout in _cache["store"].items():
                if layout.message.span.path in gone or any(inner not in left for inner in layout.dependencies):
                    del left[name]
            assert len(left) > 0.9 * len(_cache["store"])
        _cache[target.key] = left
    return _cache[target.key]


def _store(target: Target) -> dict[str, str]:
    return _print(target, _store_layouts(target))


def _print(target: Target, layouts: Layouts) -> dict[str, str]:
    settings, report = _store_settings(), Report()
    others = [other for other in TARGETS if other.key != target.key]
    job: Job = pipeline.job_of(settings, layouts, report)
    return pipeline.render_targets([*others, target], [target.key], job, report)
