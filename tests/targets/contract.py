"""Define the contract of all targets: checks that take a Target and raise AssertionError.

The checks are independent of the language. They compare a message with harmless names and a message with hostile names.
The code must be equal, token by token, except the names. Each harmless name must become exactly one other name, which
must not be a reserved word. Alternatively, the target reports SHM203 or SHM204.
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
"""Words that end, begin or escape something in a language, and letters that a conversion to ASCII turns into them."""


# --- rendering files -----------------------------------------------------------------------------------------


def render(target: Target, files: Mapping[str, str], order: int = 1) -> dict[str, str]:
    """Return {path: text} for definitions by `package/msg/Name.msg`, each used by one topic, or raise Rejected.

    If `order` is -1, the messages are requested from the last to the first.
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
        return render_layouts(target, settings, pipeline.lay_out(settings, requests[::order]))


def render_layouts(target: Target, settings: Config, layouts: Layouts) -> dict[str, str]:
    others = [other for other in TARGETS if other.key != target.key]
    report = Report()
    job = pipeline.job_of(settings, pipeline.lay_out(settings, [*map(str, layouts), *settings.types_used]), report)
    return pipeline.render_targets([*others, target], [target.key], job, report)


def file_tokens(texts: Mapping[str, str]) -> list[list[str]]:
    """Return the tokens of each file, in the order of `texts`."""
    return [language(path).tokens(text) for path, text in texts.items()]


def assert_accepted(texts: Mapping[str, str]) -> None:
    """Raise an error if the compiler or parser of a language rejects its files."""
    kinds = {id(language(path)): language(path) for path in texts}
    for number, kind in kinds.items():
        kind.accepts({path: text for path, text in texts.items() if id(language(path)) == number})


def compare_code(harmless: Mapping[str, str], hostile: Mapping[str, str], why: str) -> None:
    """Compare token by token: each name became one other valid name, and no two names became the same name."""
    assert len(harmless) == len(hostile), f"{why}: other files"
    new_names: dict[tuple[int, str], str] = {}
    originals: dict[tuple[int, str], str] = {}
    for (path, text), (other_path, other_text) in zip(harmless.items(), hostile.items(), strict=True):
        kind = language(path)
        for before, after in zip_longest(kind.tokens(text), kind.tokens(other_text)):
            place = f"{why}, in {other_path}: `{before}` became `{after}`"
            assert before is not None, place
            assert after is not None, place
            if _STRING.match(before) and _STRING.match(after):
                continue  # names in strings cannot clash
            known = new_names.setdefault((id(kind), before), after)
            assert known == after, f"{place} and `{known}`"
            first = originals.setdefault((id(kind), kind.folded(after)), before)
            assert kind.folded(first) == kind.folded(before), f"{place}, and so did `{first}`"
            assert before == after or kind.folded(after) not in kind.keywords, place
            assert "zq" not in before or not kind.is_name(before) or kind.is_name(after), f"{place}, an invalid name"


_STRING = re.compile(r"\w?['\"]")


# --- the checks --------------------------------------------------------------------------------------------


def comments_stay_comments(target: Target) -> None:
    """Put each piece alone, at the start and at the end of a comment, for fields, constants and the message."""

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
    harmless = render(target, {"zq_msgs/msg/Foo.msg": definition(clean, "")})
    hostile = render(target, {"zq_msgs/msg/Foo.msg": definition(PIECES, "m")})
    assert list(harmless) == list(hostile)
    for path, expected in zip(harmless, file_tokens(harmless), strict=True):
        assert expected == language(path).tokens(hostile[path]), f"a comment left its place in {path}"
    assert_accepted(hostile)


def strings_stay_strings(target: Target) -> None:
    """Compare string constants of one piece each with harmless string constants of equal lengths."""
    ascii_pieces = [piece.replace("#", "") for piece in PIECES if piece.isascii() and piece.replace("#", "")]

    def definition(pieces: Iterable[str]) -> str:
        return "".join(f"string S{number}={piece}\n" for number, piece in enumerate(pieces)) + "uint8 x\n"

    hostile = render(target, {"zq_msgs/msg/Foo.msg": definition(ascii_pieces)})
    harmless = render(target, {"zq_msgs/msg/Foo.msg": definition("z" * len(piece) for piece in ascii_pieces)})
    assert list(harmless) == list(hostile)
    for path, expected in zip(harmless, file_tokens(harmless), strict=True):
        for before, after in zip_longest(expected, language(path).tokens(hostile[path])):
            both = before and after and _STRING.match(before) and _STRING.match(after)
            assert before == after or both, f"in {path}, {before} became {after}"
    assert_accepted(hostile)


def words_are_escaped(target: Target) -> None:
    """Use each reserved word of the target's languages as a field, as a constant, as a message and as a package."""
    words = _reserved_words(target)
    clean = [f"zq{number}z" for number in range(len(words))]
    for form in ("uint8 {}\n", "string {}\n", "uint8[3] {}\n", "uint8 {}=1\n", "zq_msgs/Part {}\n"):
        files = [
            {"zq_msgs/msg/Foo.msg": "".join(map(form.format, names)) + "uint8 x\n", "zq_msgs/msg/Part.msg": "uint8 x\n"}
            for names in (clean, words)
        ]
        harmless, hostile = (render(target, definitions) for definitions in files)
        compare_code(harmless, hostile, form.strip())
        assert_accepted(hostile)
    for word in [*filter(str.istitle, words), "Array", "Step", "Type", "String", "Time"]:
        plain, named = (render(target, {f"zq_msgs/msg/{name}.msg": "uint8 x\n"}) for name in (_harmless(word), word))
        compare_code(plain, named, f"a message {word}")
        assert_accepted(named)
    packages = [word for word in words if re.fullmatch("[a-z][a-z]+", word)]
    for word in packages[::6]:
        compare_code(*(render(target, _package_files([name])) for name in (_harmless(word), word)), f"a package {word}")
    assert_accepted(render(target, _package_files(packages)))


def _package_files(names: Iterable[str]) -> dict[str, str]:
    """Return one definition for each package, and a message that contains all these messages."""
    files = {f"{name}/msg/Bar.msg": "uint8 x\n" for name in names}
    return {**files, "zz_msgs/msg/Foo.msg": "".join(f"{name}/Bar {name}_1\n" for name in names)}


def _reserved_words(target: Target) -> list[str]:
    """Return the reserved words of the target's languages, in lower case if one of the languages ignores case."""
    kinds = [language(path) for path in render(target, {"zq_msgs/msg/Foo.msg": "uint8 x\n"})]
    small = any(kind.ignores_case for kind in kinds)
    return sorted({word.lower() if small else word for kind in kinds for word in kind.keywords})


def _harmless(word: str) -> str:
    """Return a harmless name of equal length that is sorted to the same place."""
    return word[0] + "q" * (len(word) - 1)


def clashes_are_reported(target: Target) -> None:
    """Expect SHM203 or SHM204 for two names that a language might not distinguish, or output with both names."""
    words = _reserved_words(target)[::6]
    fields = [(word, f"{word}_") for word in words]
    fields += [("gain", "Gain"), ("a_b", "a__b"), ("a_b", "aB"), ("x", "x_"), ("aB", "AB")]
    for form in ("uint8 {}\nuint8 {}\n", "uint8 {}=1\nuint8 {}=2\nuint8 x9\n", "uint8[3] {}\nuint8 {}\n"):
        for pair in fields:
            _check_clash(target, [{"zq_msgs/msg/Foo.msg": form.format(*names)} for names in (("zqa", "zqb"), pair)])
    _check_constants_beside_fields(target, [*fields, ("GAIN", "gain"), ("Gain", "gain"), ("gain", "GAIN_")])
    sequence = "uint8[] {}\nuint8 {}\n"
    for pair in (("tail", "tail_count"), ("tail", "n_tail"), ("tail", "tail_len")):
        _check_clash(target, [{"zq_msgs/msg/Foo.msg": sequence.format(*names)} for names in (("zqa", "zqb"), pair)])
    for harmless, hostile in MESSAGES:
        files = [
            {f"{name}.msg": f"uint8 B=1\nuint8 x{number}\n" for number, name in enumerate(pair)}
            for pair in (harmless, hostile)
        ]
        _check_clash(target, files, assert_accepted)


def _check_constants_beside_fields(target: Target, pairs: Sequence[tuple[str, str]]) -> None:
    """Let the compiler decide if the target declares that constants and fields are separate name spaces."""
    form = "uint8 {}=1\nuint8 {}\n"
    base = next((other for other in TARGETS if other.key in target.after), target)
    names = target.load().NAMES or base.load().NAMES
    if names and names.constants_apart:
        assert_accepted(render(target, {f"zq_msgs/msg/Foo{n}.msg": form.format(*pair) for n, pair in enumerate(pairs)}))
        return
    for pair in pairs:
        _check_clash(target, [{"zq_msgs/msg/Foo.msg": form.format(*names)} for names in (("zqa", "zqb"), pair)])


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
def _render_cached(target: Target, files: tuple[tuple[str, str], ...]) -> dict[str, str]:
    return render(target, dict(files))


def _check_clash(
    target: Target, files: Sequence[Mapping[str, str]], compiler: Callable[[Mapping[str, str]], object] = len
) -> None:
    harmless = _render_cached(target, tuple(files[0].items()))
    why = " and ".join(f"{path}: {text.split()}" for path, text in files[1].items())
    try:
        hostile = render(target, files[1])
    except Rejected as rejected:
        codes = {diagnostic.code for diagnostic in rejected.diagnostics}
        assert codes <= {"SHM203", "SHM204", "SHM202"}, why
        return
    compare_code(harmless, hostile, why)
    compiler(hostile)


EMPTY_FILES = re.compile(r"python/\w+/py\.typed|ros2/(\w+)/resource/\1")
COPIED_FILES = re.compile(r"ros\d/\w+/config/msgs/.*")
"""Files that cannot name their generator: empty files, and copies of files that the user wrote."""
GENERATOR = re.compile(r"\b(Generated|Made) by shmgen\b")


def files_name_their_generator(target: Target) -> None:
    """Require a comment that names shmgen in the first five lines, except in JSON, which has no comments."""
    for path, text in render_project(target).items():
        if EMPTY_FILES.fullmatch(path):
            assert not text.strip(), path
        elif not path.endswith(".json") and not COPIED_FILES.fullmatch(path):
            assert GENERATOR.search("\n".join(text.splitlines()[:5])), f"{path} does not name shmgen as its generator"


def files_stay_in_folder(target: Target) -> None:
    """Require portable file names in the folder of the target's key that differ even if case is ignored."""
    for texts in (render_project(target), _render_store(target)):
        for path in texts:
            assert path.startswith(f"{target.key}/"), path
            assert re.fullmatch(r"(\w+/)*\w+(\.\w+)*", path, re.ASCII), path
        assert len({path.lower() for path in texts}) == len(texts)


def output_is_reproducible(target: Target) -> None:
    """Render the same files twice, and also if the messages are requested in reverse order."""
    files = {f"zq_msgs/msg/M{number}.msg": "uint8 x\n" for number in range(9)}
    first = render(target, files)
    assert first == render(target, files)
    reversed_order = render(target, files, order=-1)
    assert {path: text for path, text in first.items() if "config" not in path} == {
        path: text for path, text in reversed_order.items() if "config" not in path
    }


def store_messages_are_accepted(target: Target) -> None:
    """Render all messages of the store: compilers accept them, and their names are those that the target claims."""
    texts = _render_store(target)
    assert_accepted(texts)
    names = target.load().NAMES
    words = {token for sequence in file_tokens(texts) for token in sequence}
    for layout in _store_layouts(target).values() if names else ():
        assert names
        claims = list(names.claims(layout, "shm_msgs"))
        if not claims:
            continue  # the target generates nothing for this message
        for claim in claims:
            is_used = any(path.endswith(claim.name) for path in texts) if claim.kind == "file" else claim.name in words
            assert is_used or claim.kind == "package", claim
        for slot in layout.slots:
            assert slot.role is not Role.DATA or names.member(slot.name) in words, (layout.name, slot.name)
    generated = {name for layout in _store_layouts(target).values() for name in _generated_names(layout, names)}
    for path, sequence in zip(texts, file_tokens(texts), strict=True):
        kind = language(path)
        for name in generated.intersection(sequence) if kind.keywords else ():
            assert kind.is_name(name), f"`{name}` is not a valid name in {path}"


def _generated_names(layout: Layout, names: Names | None) -> set[str]:
    """Return the names of fields and constants, escaped for the target, and the names of shmgen's own members."""
    slots = {slot.name for slot in layout.slots if slot.role is not Role.DATA}
    if names:
        slots |= {names.member(slot.name) for slot in layout.slots}
        slots |= {names.constant(constant.name) for constant in layout.message.constants}
    return slots


CHECKS: tuple[Check, ...] = (
    comments_stay_comments,
    strings_stay_strings,
    words_are_escaped,
    clashes_are_reported,
    files_name_their_generator,
    files_stay_in_folder,
    output_is_reproducible,
    store_messages_are_accepted,
)


def render_project(target: Target) -> dict[str, str]:
    """Render a project that uses all features."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        put({f"msgs/{path}": text for path, text in FULL_PROJECT.items()}, folder)
        (folder / "shmgen.toml").write_text(FULL_PROJECT_TOML)
        settings = config.load(folder / "shmgen.toml", "shmgen.toml", Report())
        try:
            return render_layouts(target, settings, pipeline.lay_out(settings, ["cell_msgs"]))
        except Rejected as rejected:
            _assert_only_unsupported_types(rejected)
            path = folder / "msgs" / "cell_msgs" / "msg" / "State.msg"
            rejected_lines = [diagnostic.span.line - 1 for diagnostic in rejected.diagnostics]
            lines = path.read_text().splitlines()
            path.write_text("".join(f"{line}\n" for number, line in enumerate(lines) if number not in rejected_lines))
            return render_layouts(target, settings, pipeline.lay_out(settings, ["cell_msgs"]))


FULL_PROJECT = {
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
FULL_PROJECT_TOML = """
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
    """Return settings that bound all sequences to 3, with one topic, which some targets require."""
    plain = Config(Path.cwd())
    packages = {entry.name.package for entry in pipeline.inventory(plain)}
    bounds = Bounds({}, {package: Bound(3, Span("shmgen.toml")) for package in packages})
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "shmgen.toml")
        file.write_text('[[topics]]\ntopic = "/pose"\ntype = "geometry_msgs/Pose"\n')
        loaded = config.load(file, "shmgen.toml", Report())
    return Config(Path.cwd(), bounds=bounds, topics=loaded.topics, document=loaded.document)


def _assert_only_unsupported_types(rejected: Rejected) -> None:
    """Require that all diagnostics are SHM305: the language has no type for a field."""
    assert {diagnostic.code for diagnostic in rejected.diagnostics} == {"SHM305"}, rejected


def _store_layouts(target: Target) -> Layouts:
    """Return the layouts without messages that the target cannot represent, and without messages that contain them."""
    if "store" not in _cache:
        settings = _store_settings()
        names = [str(entry.name) for entry in pipeline.inventory(settings)]
        _cache["store"] = pipeline.lay_out(settings, names)
    if target.key not in _cache:
        supported = dict(_cache["store"])
        try:
            _render_store_layouts(target, supported)
        except Rejected as rejected:
            _assert_only_unsupported_types(rejected)
            paths = {diagnostic.span.path for diagnostic in rejected.diagnostics}
            for name, layout in _cache["store"].items():
                if layout.message.span.path in paths or any(inner not in supported for inner in layout.dependencies):
                    del supported[name]
            assert len(supported) > 0.9 * len(_cache["store"])
        _cache[target.key] = supported
    return _cache[target.key]


def _render_store(target: Target) -> dict[str, str]:
    return _render_store_layouts(target, _store_layouts(target))


def _render_store_layouts(target: Target, layouts: Layouts) -> dict[str, str]:
    settings, report = _store_settings(), Report()
    others = [other for other in TARGETS if other.key != target.key]
    job: Job = pipeline.job_of(settings, layouts, report)
    return pipeline.render_targets([*others, target], [target.key], job, report)
