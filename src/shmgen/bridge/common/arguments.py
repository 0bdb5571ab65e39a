"""Parses the command line and the parameter files of a ROS 2 node for backends without ROS."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from shmgen.config import Config
from shmgen.config.keys import keys_of

PARAMETERS = ("use_sim_time", "rate", "stale")
_WITHOUT_EFFECT = ("--log-level", "--log-config-file", "--log-file-name", "-e", "--enclave")
"""Arguments of rcl that take a value and have no effect in a backend without ROS."""
_FLAG = re.compile("--(enable|disable)-(rosout|stdout|external-lib)-logs")


@dataclass(slots=True)
class Arguments:
    """The parsed ROS arguments of a command line. `ignored` lists arguments without effect, which the bridge logs."""

    node: str
    namespace: str = "/"
    remappings: list[tuple[str, str]] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)

    @property
    def use_sim_time(self) -> bool:
        """True if the parameter use_sim_time is true."""
        return self.parameters.get("use_sim_time", "").lower() == "true"

    def resolve(self, name: str) -> str:
        """Return the full name in the ROS graph for a topic, service or action of shmgen.toml."""
        full = self._expand(name)
        return next((self._expand(new) for old, new in self.remappings if self._expand(old) == full), full)

    def _expand(self, name: str) -> str:
        if name.startswith("/"):
            return name
        space = self.namespace.rstrip("/")
        return f"{space}/{self.node}{name[1:]}" if name.startswith("~") else f"{space}/{name}"

    def is_for_node(self, pattern: str) -> bool:
        """Return True if the node name of a parameter, such as `bridge`, `/cell1/*` or `/**`, matches this node."""
        escaped = re.escape(f"/{pattern.lstrip('/')}")
        expression = escaped.replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
        return re.fullmatch(expression, self._expand(self.node)) is not None


class _Parameter(NamedTuple):
    node: str
    """The pattern for the names of the nodes that the parameter is for."""
    name: str
    value: str


def parse(words: tuple[str, ...], node: str, is_strict: bool = True) -> Arguments:
    """Parse the ROS arguments of a command line by the rules of rcl, and read the parameter files.

    `words` is the command line. `node` is the name of the node if no argument renames the node. Raises ValueError if an
    argument is malformed, or if `is_strict` is True and an argument or parameter is unknown.
    """
    arguments, unknown = Arguments(node), list[str]()
    rules = list[tuple[str, list[_Parameter]]]()
    left, is_ros = iter(words), False
    for word in left:
        if word in ("--ros-args", "--"):
            is_ros = word == "--ros-args"
        elif not is_ros:
            unknown.append(f"{word!r} is not an argument of the bridge; write ROS arguments after --ros-args")
        elif word in ("-r", "--remap"):
            _remap(arguments, _value(word, left))
        elif word in ("-p", "--param"):
            rule = _value(word, left)
            rules.append((rule, [_parameter(rule)]))
        elif word == "--params-file":
            rules.append(("", list(_read(_value(word, left)))))
        elif word in _WITHOUT_EFFECT:
            arguments.ignored.append(f"{word} {_value(word, left)}")
        elif _FLAG.fullmatch(word):
            arguments.ignored.append(word)
        else:
            unknown.append(f"unknown ROS argument {word!r}; without ROS, use -r, -p, --params-file and --log-level")
    for rule, parameters in rules:
        unknown += _set(arguments, rule, parameters)
    if unknown and is_strict:
        raise ValueError(unknown[0])
    return arguments


def _set(arguments: Arguments, rule: str, parameters: list[_Parameter]) -> list[str]:
    """Store the `parameters` that are for this node in `arguments`, and return error texts.

    `rule` is the argument that sets the parameters, or `""` for a file. A file may contain unknown parameters.
    """
    faults = []
    for _, name, value in (one for one in parameters if arguments.is_for_node(one.node)):
        if name == "use_sim_time" and value.lower() not in ("true", "false"):
            faults.append(f"parameter use_sim_time must be true or false, not {value!r}")
        elif name in PARAMETERS:
            arguments.parameters[name] = value
        elif rule:
            faults.append(f"unknown parameter {rule!r}; without ROS, use {', '.join(PARAMETERS)}")
        else:
            arguments.ignored.append(f"parameter {name}")
    return faults


def _value(word: str, left: Iterator[str]) -> str:
    value = next(left, None)
    if value is None:
        raise ValueError(f"{word} needs a value")
    return value


def _remap(arguments: Arguments, rule: str) -> None:
    old, separator, new = rule.partition(":=")
    target, colon, bare = old.partition(":")
    if not (separator and old and new):
        raise ValueError(f"{rule!r} is not a remapping: write from:=to")
    if colon:  # the rule applies to one node only
        if target != arguments.node:
            return
        old = bare
    if old in ("__node", "__name"):
        arguments.node = new
    elif old == "__ns":
        arguments.namespace = new if new.startswith("/") else f"/{new}"
    else:
        arguments.remappings.append((old, new))


def _parameter(rule: str) -> _Parameter:
    """Parse the parameter in a command-line rule such as `rate:=50` or `node:rate:=50`."""
    name, _, value = rule.partition(":=")
    node, colon, bare = name.rpartition(":")
    return _Parameter(node if colon else "/**", bare, value)


def _read(path: str) -> Iterator[_Parameter]:
    """Yield the parameters in a parameter file. Raises ValueError if the file cannot be read."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        tree = YAML(typ="base", pure=True).load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"--params-file {path}: {error.strerror}") from None
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ValueError(f"--params-file {path}{place}: {getattr(error, 'problem', None) or error}") from None
    for keys, value in _leaves(tree or {}):
        if "ros__parameters" not in keys:
            raise ValueError(f"--params-file {path}: move {'/'.join(keys) or value} below `ros__parameters:` of a node")
        start = keys.index("ros__parameters")
        yield _Parameter("/".join(keys[:start]), ".".join(keys[start + 1 :]), str(value))


def _leaves(tree: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield each value in nested mappings that is not a mapping, with the keys that lead to the value."""
    if not isinstance(tree, dict):
        yield keys, tree
        return
    for key, value in tree.items():
        yield from _leaves(value, (*keys, str(key)))


def with_parameters(config: Config, parameters: Mapping[str, str]) -> Config:
    """Return `config` with `rate` and `stale` of `parameters` in all topics without these keys.

    Raises ValueError if a parameter is not a number in the range of the key.
    """
    topics = list(config.topics)
    for key in keys_of("topics"):
        if key.name in PARAMETERS and (text := parameters.get(key.name)):
            number = float(text) if re.fullmatch(r"\d+\.?\d*", text) else -1.0
            if not key.least <= number <= key.most:
                raise ValueError(f"parameter {key.name} must be from {key.least:g} to {key.most:g}, not {text!r}")
            options: dict[str, Any] = {key.name: number}
            for index, topic in enumerate(topics):
                if getattr(topic.carried, key.name) is None:
                    topics[index] = topic._replace(carried=topic.carried._replace(**options))
    return replace(config, topics=tuple(topics))
