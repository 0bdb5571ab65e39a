"""Write the files of a ROS package with imported PLC types: names, lines of a .msg, package.xml and CMakeLists.txt."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter

from shmgen.plc import types
from shmgen.plc.declarations import Declaration, Member
from shmgen.plc.numbers import NotConvertible, Numbers

_GERMAN = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss", "ẞ": "Ss"})
_PREFIX = re.compile(r"(ST|E|EN|ENUM|DUT|T|TYP|U)_(?=[A-Za-z])", re.IGNORECASE)
_WORDS = re.compile(r"[A-Z]+(?![a-z])\d*|[A-Z]?[a-z]+\d*|\d+")


def snake(name: str) -> str:
    """Convert a name to snake case: `rActPos` -> `r_act_pos`, `nAxisID` -> `n_axis_id`, `Länge` -> `laenge`."""
    words = "_".join(_WORDS.findall(_ascii(name))).lower() or "x"
    return words if words[0].isalpha() else f"n{words}"


def _ascii(name: str) -> str:
    """Spell a name in ASCII: `ä` -> `ae`, `é` -> `e`, and any other letter as its code point, `速` -> `u36895`."""
    parts = unicodedata.normalize("NFKD", unicodedata.normalize("NFC", name).translate(_GERMAN))
    bare = (part for part in parts if not unicodedata.combining(part))
    spelled = "".join(part if part.isascii() else f"u{ord(part)}" for part in bare)
    return spelled.upper() if name.isupper() else spelled


def _camel(name: str) -> str:
    words = re.findall(r"[A-Za-z0-9]+", _ascii(name))
    whole = "".join(
        word.capitalize() if word.isupper() or word.islower() else word[0].upper() + word[1:] for word in words
    )
    return whole if whole[:1].isalpha() else f"N{whole}"


def of_messages(names: list[str]) -> dict[str, str]:
    """Return the message name for each PLC type, whose names are in capital letters: `ST_AXIS` -> `Axis`.

    A prefix such as `ST_` is removed if the names stay different without the prefix.
    """
    short = {name.upper(): _camel(_PREFIX.sub("", name, count=1)) for name in names}
    often = Counter(it.upper() for it in short.values())
    camel_names = [
        it if often[it.upper()] == 1 else _camel(name) for name, it in zip(names, short.values(), strict=True)
    ]
    return dict(zip(short, unique(camel_names), strict=True))


def unique(names: list[str]) -> list[str]:
    """Append numbers to repeated names. Case is ignored, because Structured Text does not distinguish case."""
    seen: set[str] = set()
    counts: Counter[str] = Counter()
    unique_names = []
    for name in names:
        other = name
        while other.upper() in seen:
            counts[name] += 1
            other = f"{name}{'' if name[0].isupper() and '_' not in name else '_'}{counts[name] + 1}"
        seen.add(other.upper())
        unique_names.append(other)
    return unique_names


def head(declared: Declaration, own: str) -> list[str]:
    """Return the comment lines at the top of a .msg file: the comment of the PLC type, then the note `own` in brackets.

    `own` contains the type's name in the PLC, such as `PLC: ST_Axis`.
    """
    lines = [line for line in declared.comment.split("\n") if line]
    return [*(f"# {_harmless(line)}" for line in lines), f"# ({own})", ""]


def field_lines(name: str, member: Member, field: types.Field, note: str) -> list[str]:
    """Return the lines of a .msg file that declare a field, with its comment.

    The comment ends with `(PLC: …)` if the field alone does not show the name, type and alignment of `member`. `note`
    is the alignment as a part of this text, such as `, align 4`, or `""`.
    """
    value = _default(member, field)
    left = "" if value or not member.value else f"initial value {member.value}"
    comment = "\n".join(filter(None, [member.comment, left and _harmless(left)]))
    if field.says and "[" not in comment:
        comment = f"{comment} [{field.says}]" if re.fullmatch(r"\w+", field.says) else f"{comment} {field.says}"
    own = f"{member.name} : {field.own}{note}" if field.own else f"{member.name}{note}"
    own = "" if own == name else f"(PLC: {own})"
    return commented(f"{field.type} {name}{value and f' {value}'}", comment.strip(), own)


def commented(code: str, comment: str, own: str) -> list[str]:
    """Return `code` with its comment: a one-line comment follows the code, and a longer comment stands above.

    `own` is a note with the PLC's name, such as `(PLC: rSpeed)`, or `""`. The note always follows the code.
    """
    lines = [_harmless(line) for line in comment.split("\n") if line]
    if len(lines) > 1:
        return [*(f"# {line}" for line in lines), f"{code}  # {own}" if own else code]
    beside = " ".join(filter(None, [*lines, own]))
    return [f"{code}  # {beside}" if beside else code]


def _harmless(line: str) -> str:
    """Return a line of a comment with blanks for control characters. Escape text that looks like a note `(PLC: …)`."""
    return "".join(c if c.isprintable() else " " for c in line).replace("(PLC:", "(plc:").strip()


_FLOAT = re.compile(r"(?:[A-Za-z_]\w*#)?([-+]?\d[\d_]{0,40}(?:\.[\d_]{1,40})?(?:[eE][-+]?\d{1,3})?)", re.ASCII)
_LARGEST_FLOAT = {4: 3.4028234e38, 8: 1.7976931348623157e308}
_WITHOUT_CONSTANTS = Numbers((), ())


def _default(member: Member, field: types.Field) -> str:
    """Return the default of a field as the text for a .msg file, from the initial value of a PLC variable.

    Only numbers, BOOLs and strings get a default. For any other type, return `""`.
    """
    text = member.value
    if not text or field.many or field.element or "/" in field.type:
        return ""
    if field.type == "bool":
        return {"TRUE": "true", "FALSE": "false", "1": "true", "0": "false"}.get(text.upper(), "")
    if "string" in field.type:
        inner = text[1:-1]
        room = int(field.type.partition("=")[2])
        plain = text == f"'{inner}'" and inner.isascii() and inner.isprintable() and not set("$\\'\"") & set(inner)
        return f'"{inner}"' if inner and plain and len(inner) <= room else ""
    if field.type.startswith("float"):
        value = match[1].replace("_", "") if (match := _FLOAT.fullmatch(text)) else ""
        return value if value and abs(float(value)) <= _LARGEST_FLOAT[field.size] else ""
    try:
        number = _WITHOUT_CONSTANTS.value(text)
    except NotConvertible:
        return ""
    return str(number) if types.fits(number, field.type, field.size) else ""


def manifest(package: str, times: bool) -> str:
    depend = "  <depend>builtin_interfaces</depend>\n" if times else ""
    return f"""<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.0.0</version>
  <description>Data types of a PLC project</description>
  <maintainer email="nobody@localhost">nobody</maintainer>
  <license>unknown</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{depend}  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


def cmake(package: str, files: list[str], times: bool) -> str:
    listed = "\n".join(f"  {file}" for file in files)
    find, depend = (
        ("find_package(builtin_interfaces REQUIRED)\n", " DEPENDENCIES builtin_interfaces") if times else ("", "")
    )
    return f"""cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{find}rosidl_generate_interfaces(${{PROJECT_NAME}}
{listed}
 {depend})
ament_package()
"""
