"""Define every key of shmgen.toml in one table.

The parser accepts these keys, `shmgen schema` prints them, and docs/configuration.md lists them.
"""

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
"""The default of the largest region in bytes: larger than any useful topic, but reached if a bound is far too large."""
MAX_NUMBER = 2**31 - 1
MAX_SECONDS = 86_400.0
MAX_DOMAIN = 232
"""The highest DDS domain whose ports are below 65536 (RTPS, 9.6.2.3)."""
BOUND_KEY = r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z][A-Za-z0-9_]*)?)?"
# The patterns are also part of the JSON schema, so they must be valid in ECMA 262.
_PACKAGE = rf"(?!({'|'.join(keyword.kwlist)}|shmgen)$)[A-Za-z_][A-Za-z0-9_]*"  # shmgen: generated code imports that one
_DISTRIBUTION = r"([A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])? [0-9]+(\.[0-9]+)*((a|b|rc|\.post|\.dev)[0-9]+)?)?"
"""A name and a version of a Python package, as PEP 508 and PEP 440 define them."""
_MODE = r"0?6[06][06]"
"""The modes of a region's files. Each user who may read may also write, because a reader must acquire the lock."""
_GROUP_HINT = 'use "0660" for owner and group, or "0666" for all: each process must read and write'
_REP_144 = "must have at least two lower-case letters, digits or single _, with a letter first (REP 144)"


class Key(NamedTuple):
    """A key of shmgen.toml. If `default` is None, a missing key has no value.

    An error message consists of the key's name and `rule`, such as "must be a string".
    """

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
    rule: str = "must be a string"
    hint: str = ""
    required: bool = False


SECTIONS = {
    "types": "IEC 61131-3 types of ROS types.",
    "strings": "Capacity of strings without a bound in their definition; the most specific key wins.",
    "bounds": "Elements of sequences without a bound in their definition; the most specific key wins.",
    "topics": "One topic: a region, and a block that the PLC program calls.",
    "services": "One service.",
    "actions": "One action.",
    "regions": "Permissions and access of regions.",
    "bridge": "How `shmgen bridge` runs.",
    "plc": "Your own PLC program.",
}
LISTS = ("topics", "services", "actions")
"""Sections that may occur several times, such as `[[topics]]`."""
FREE_SECTIONS = ("strings", "bounds")
"""Sections in which the user chooses keys: `package`, `package/Message` or `package/Message.field`."""


def _choice(section: str, name: str, choices: tuple[str, ...], meaning: str) -> Key:
    return Key(section, name, "choice", choices[0], meaning, choices)


def _call(section: str, name: str, timeout: str) -> tuple[Key, ...]:
    return (
        Key(section, name, "string", "", f"Name of the {name}.", required=True),
        Key(section, "type", "string", "", f"Type of the {name}, `package/Name`.", required=True),
        _choice(section, "server", ("plc", "ros"), "Whether the PLC or ROS is the server."),
        Key(section, "timeout", "number", 1.0, timeout, least=0.001, most=MAX_SECONDS, unit="seconds"),
    )


KEYS = (
    Key("", "messages", "strings", (), "Messages to generate; a package name selects all of its messages."),
    _choice("", "source", SOURCES, "Built-in definitions of this distribution; `env` selects the sourced ROS."),
    Key("", "path", "strings", (), "Folders with your own message packages, searched before `source`."),
    Key("", "targets", "strings", USUAL, "Languages and formats to generate.", TARGETS),
    Key("", "package", "string", "shm_msgs", "Name of the Python package and of the C folder.", pattern=_PACKAGE,
        rule='must be a valid name of a Python package, such as "shm_msgs"'),
    Key("", "distribution", "string", "",
        "Name and version of the generated pip package, written to generated/python/pyproject.toml.",
        pattern=_DISTRIBUTION, rule='must be a name and a version, such as "robot-shm 1.2.0"'),
    _choice("", "runtime", ("installed", "beside"),
            "`beside` copies shmgen.runtime into the Python package, which then needs only posix_ipc."),
    Key("", "max_region", "integer", MAX_REGION, "Largest size of a region in bytes; shmgen refuses larger messages."),
    Key("", "task_interval", "integer", 10, "Milliseconds between two calls of the generated program PRG_Ros."),
    Key("", "ros_package", "string", "", "Name of the generated ROS package; if empty, `package` plus `_bridge`.",
        pattern="([a-z](_?[a-z0-9])+_?)?", rule=_REP_144),
    _choice("types", "bool", ("USINT", "BOOL"), "IEC type of a bool."),
    _choice("types", "time", ("TIME", "LTIME", "struct"), "IEC type of a time or duration."),
    _choice("types", "names", ("plc", "ros"), "Whether `shmgen import` keeps PLC names or writes ROS names."),
    Key("strings", "default", "integer", 80,
        "Capacity in bytes of strings without a bound; 80 is the default of CODESYS."),
    _choice("strings", "encoding", ("utf-8", "latin-1"), "Encoding of strings in a region."),
    _choice("strings", "overflow", ("error", "truncate"),
            "Whether Python and C++ reject or cut a string that is too long."),
    Key("bounds", "default", "integer", None,
        "Capacity of sequences without a bound; without this key, such a sequence is an error."),
    Key("topics", "topic", "string", "", "Name of the topic.", required=True),
    Key("topics", "type", "string", "", "Type of the topic, `package/Name`.", required=True),
    _choice("topics", "direction", ("to_plc", "from_plc"), "Direction of messages: ROS to PLC, or PLC to ROS."),
    Key("topics", "depth", "integer", 1, "Number of samples that a region keeps; must be equal in all programs.",
        most=abi.MAX_DEPTH),
    Key("topics", "rate", "number", None, "Maximum number of messages per second through the bridge.", least=0.001,
        most=10_000.0, unit="Hz"),
    _choice("topics", "qos", ("auto", "reliable", "best_effort"),
            "Reliability in ROS; `auto` selects best effort if a ROS publisher is best effort, otherwise reliable."),
    Key("topics", "latch", "boolean", False, "Whether late subscribers in ROS get the newest message."),
    _choice("topics", "stamp", ("now", "keep"), "`now` replaces a zero time stamp of the PLC with the ROS time."),
    _choice("topics", "overflow", ("reject", "truncate"),
            "Whether the bridge rejects or cuts a message that is too long."),
    Key("topics", "stale", "number", None, "Seconds without a sample until the bridge reports the topic as stale.",
        least=0.01, most=MAX_SECONDS, unit="seconds"),
    _choice("topics", "other_definition", ("refuse", "accept"),
            "Whether the bridge refuses or accepts publishers with another definition of the type."),
    *_call("services", "service", "Seconds that the bridge waits for a response."),
    *_call("actions", "action", "Seconds that the bridge waits until a goal is accepted."),
    Key("regions", "mode", "string", None, "Permission bits of the files of a region; 0660 by default.", pattern=_MODE,
        rule='must be a mode such as "0660", in quotes', hint=_GROUP_HINT),
    Key("regions", "group", "string", "", "Group of the files of a region; if empty, the group of the process.",
        pattern=".+", rule='must be the name of a group, such as "plc"'),
    _choice("regions", "sync", ("lock", "sequence"),
            "`sequence` uses no lock; required between 32-bit and 64-bit programs."),
    _choice("bridge", "backend", BACKENDS,
            "Middleware; `auto` selects the sourced ROS, or else the first installed of ros2, dds, zenoh and ros1."),
    Key("bridge", "node", "string", "shmgen_bridge", "Name of the bridge's ROS node.", pattern="[A-Za-z_][A-Za-z0-9_]*",
        rule="must have letters, digits and _, and no digit first"),
    Key("bridge", "diagnostics", "number", 1.0, "Seconds between two messages on /diagnostics; 0 sends none.", least=0,
        most=MAX_SECONDS, unit="seconds"),
    Key("bridge", "domain", "integer", None, "DDS domain number; ROS_DOMAIN_ID by default.", least=0, most=MAX_DOMAIN),
    Key("plc", "sources", "strings", (), "Files with your own Structured Text, included in the upload to OpenPLC."),
)  # fmt: skip


def keys_of(section: str) -> tuple[Key, ...]:
    return tuple(key for key in KEYS if key.section == section)


def header(section: str) -> str:
    return f"[[{section}]]" if section in LISTS else f"[{section}]"
