"""Every key of shmgen.toml, once: the parser accepts it, `shmgen schema` prints it, docs/configuration.md lists it."""

from __future__ import annotations

import keyword
from typing import Any, Literal, NamedTuple

from shmgen.config import backends
from shmgen.core import abi
from shmgen.targets import KEYS as TARGETS
from shmgen.targets import USUAL

SOURCES = ("jazzy", "humble", "noetic", "kilted", "lyrical", "iron", "galactic", "foxy", "eloquent", "dashing", "env")
BACKENDS = ("auto", *(backend.key for backend in backends.BACKENDS))
MAX_REGION = 32 * 2**20
"""Bytes; more than any sane topic, less than what a forgotten bound makes."""
MAX_NUMBER = 2**31 - 1
MAX_SECONDS = 86_400.0
MAX_DOMAIN = 232
"""The highest DDS domain whose ports are below 65536 (RTPS, 9.6.2.3)."""
BOUND_KEY = r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z][A-Za-z0-9_]*)?)?"
# Patterns are compiled where such a key is, and read by editors as ECMA 262 too.
_PACKAGE = rf"(?!({'|'.join(keyword.kwlist)}|shmgen)$)[A-Za-z_][A-Za-z0-9_]*"  # shmgen: generated code imports that one
_DISTRIBUTION = r"([A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])? [0-9]+(\.[0-9]+)*((a|b|rc|\.post|\.dev)[0-9]+)?)?"
"""Names of PEP 508 and the common versions of PEP 440."""
_MODE = r"0?6[06][06]"
"""Who may read a region and not write it cannot enter its lock."""
_GROUP_HINT = "whoever opens a region needs to read and write it: 0660 is for owner and group, 0666 for all"
_REP_144 = "is made of small letters, digits and single _, a letter first, two characters at least (REP 144)"


class Key(NamedTuple):
    """`default` None: there is none, and leaving the key out means something else. `rule` is what an error says."""

    section: str
    name: str
    kind: Literal["string", "strings", "choice", "integer", "number", "boolean"]
    default: Any
    meaning: str
    choices: tuple[str, ...] = ()
    least: float = 1
    most: float = MAX_NUMBER
    unit: str = ""
    pattern: str = ""
    rule: str = "is a string"
    hint: str = ""
    required: bool = False


SECTIONS = {
    "types": "How types of ROS appear in IEC 61131-3.",
    "strings": "Capacity of strings without a bound in their definition; the most specific key wins.",
    "bounds": "Elements of sequences without a bound in their definition; the most specific key wins.",
    "topics": "One topic: a region, and a block that the PLC program calls.",
    "services": "One service.",
    "actions": "One action.",
    "regions": "Permissions and access of regions.",
    "bridge": "How `shmgen bridge` runs.",
    "plc": "Of a PLC program of your own.",
}
LISTS = ("topics", "services", "actions")
"""Sections of which there are any number: `[[topics]]`."""
OPEN = ("strings", "bounds")
"""Sections whose other keys are `package`, `package/Message` or `package/Message.field`."""


def _choice(section: str, name: str, choices: tuple[str, ...], meaning: str) -> Key:
    return Key(section, name, "choice", choices[0], meaning, choices)


def _call(section: str, name: str, timeout: str) -> tuple[Key, ...]:
    return (
        Key(section, name, "string", "", f"Name of the {name}.", required=True),
        Key(section, "type", "string", "", "Its type, `package/Name`.", required=True),
        _choice(section, "server", ("plc", "ros"), "Which side is the server."),
        Key(section, "timeout", "number", 1.0, timeout, least=0.001, most=MAX_SECONDS, unit="seconds"),
    )


KEYS = (
    Key("", "messages", "strings", (), "What `shmgen generate` writes; a package means all of it."),
    _choice("", "source", SOURCES, "Built-in definitions, or `env`: the sourced ROS."),
    Key("", "path", "strings", (), "Folders with message packages of your own; they come first."),
    Key("", "targets", "strings", USUAL, "What to generate.", TARGETS),
    Key("", "package", "string", "shm_msgs", "Name of the Python package and of the C folder.", pattern=_PACKAGE,
        rule='names the Python package to make, such as "shm_msgs"'),
    Key("", "distribution", "string", "", "Name and version for pip: generated/python gets a pyproject.toml.",
        pattern=_DISTRIBUTION, rule='is a name and a version, such as "robot-shm 1.2.0"'),
    _choice("", "runtime", ("installed", "beside"),
            "`beside` puts shmgen.runtime into the Python package: a robot needs only posix_ipc."),
    Key("", "max_region", "integer", MAX_REGION, "Bytes; a message whose region needs more is refused."),
    Key("", "task_interval", "integer", 10, "Milliseconds between two calls of the generated program PRG_Ros."),
    Key("", "ros_package", "string", "", "Name of the generated ROS package; empty: `package` and `_bridge`.",
        pattern="([a-z](_?[a-z0-9])+_?)?", rule=_REP_144),
    _choice("types", "bool", ("USINT", "BOOL"), "IEC type of a bool."),
    _choice("types", "time", ("TIME", "LTIME", "struct"), "IEC type of a time or duration."),
    _choice("types", "names", ("plc", "ros"), "Names in Structured Text of what `shmgen import` made."),
    Key("strings", "default", "integer", 80, "Capacity where nothing more specific is said, as CODESYS has it."),
    _choice("strings", "encoding", ("utf-8", "latin-1"), "Encoding of strings in a region."),
    _choice("strings", "overflow", ("error", "truncate"), "What Python does with a string that is too long."),
    Key("bounds", "default", "integer", None, "Elements of every sequence without a bound; left out: an error."),
    Key("topics", "topic", "string", "", "Name of the topic.", required=True),
    Key("topics", "type", "string", "", "Its type, `package/Name`.", required=True),
    _choice("topics", "direction", ("to_plc", "from_plc"), "Who reads: the PLC, or ROS."),
    Key("topics", "depth", "integer", 1, "Samples that a slow reader can still fetch; the same on both sides.",
        most=abi.MAX_DEPTH),
    Key("topics", "rate", "number", None, "The bridge carries at most so many a second.", least=0.001, most=10_000.0,
        unit="Hz"),
    _choice("topics", "qos", ("reliable", "best_effort"), "Reliability of the bridge's end in ROS."),
    Key("topics", "latch", "boolean", False, "Late subscribers in ROS get the last message."),
    _choice("topics", "stamp", ("now", "keep"), "Of from_plc: whether the bridge sets the time of a header."),
    _choice("topics", "overflow", ("reject", "truncate"), "Of to_plc: what the bridge does with what is too long."),
    Key("topics", "stale", "number", None, "Seconds without a sample before the bridge reports the topic.", least=0.01,
        most=MAX_SECONDS, unit="seconds"),
    _choice("topics", "other_definition", ("refuse", "accept"),
            "Of to_plc: messages of ROS 2 peers that have another definition of the type."),
    *_call("services", "service", "Seconds that the bridge waits for the PLC."),
    *_call("actions", "action", "Seconds that the bridge waits for a reply on whether a goal is accepted."),
    Key("regions", "mode", "string", None, "Permission bits of the files of a region; left out: 0660.", pattern=_MODE,
        rule="is 0600, 0660 or the like, in quotes", hint=_GROUP_HINT),
    Key("regions", "group", "string", "", "Group of these files; empty: that of the process.", pattern=".+",
        rule='is the name of one, such as "plc"'),
    _choice("regions", "sync", ("lock", "sequence"), "`sequence`: no lock, for sides of different bitness."),
    _choice("bridge", "backend", BACKENDS, "The ROS to connect to; `auto`: the first that is there."),
    Key("bridge", "node", "string", "shmgen_bridge", "Name of the bridge in ROS.", pattern="[A-Za-z_][A-Za-z0-9_]*",
        rule="is a name of letters, digits and _, no digit first"),
    Key("bridge", "diagnostics", "number", 1.0, "Seconds between two messages on /diagnostics; 0: none.", least=0,
        most=MAX_SECONDS, unit="seconds"),
    Key("bridge", "domain", "integer", None, "DDS domain; left out: ROS_DOMAIN_ID.", least=0, most=MAX_DOMAIN),
    Key("plc", "sources", "strings", (), "Structured Text of your own, to stand in what is uploaded to OpenPLC."),
)  # fmt: skip


def of(section: str) -> tuple[Key, ...]:
    return tuple(key for key in KEYS if key.section == section)


def header(section: str) -> str:
    return f"[[{section}]]" if section in LISTS else f"[{section}]"
