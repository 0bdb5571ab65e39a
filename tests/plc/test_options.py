"""Messages pass unchanged through generated ST and C with every option for types, encodings and bounds."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Span
from shmgen.core.model import (
    Array,
    Clock,
    Element,
    Field,
    Layouts,
    Ref,
    Role,
    Scalar,
    Sequence,
    String,
    TypeName,
    TypeOptions,
)
from shmgen.generator import pipeline

from ..support import plc_bytes
from ..test_machines import MACHINES

SETS = {
    "BOOL-LTIME-latin1-truncate": TypeOptions("BOOL", "LTIME", "latin-1", "truncate"),
    "BOOL-struct-utf8-truncate": TypeOptions("BOOL", "struct", "utf-8", "truncate"),
    "BOOL-TIME-latin1": TypeOptions("BOOL", "TIME", "latin-1", "error"),
    "USINT-LTIME-utf8": TypeOptions("USINT", "LTIME", "utf-8", "error"),
    "USINT-struct-latin1": TypeOptions("USINT", "struct", "latin-1", "error"),
    "USINT-TIME-utf8-truncate": TypeOptions("USINT", "TIME", "utf-8", "truncate"),
}
"""Sets of options. They combine each value of an option with each value of every other option."""


def test_sets_contain_every_pair_of_values() -> None:
    values = [("USINT", "BOOL"), ("TIME", "LTIME", "struct"), ("utf-8", "latin-1"), ("error", "truncate")]
    combinations = [(it.bool, it.time, it.encoding, it.overflow) for it in SETS.values()]
    for one, other in ((a, b) for a in range(4) for b in range(a)):
        assert {(it[one], it[other]) for it in combinations} == set(product(values[one], values[other]))


@pytest.mark.parametrize("name", SETS)
@pytest.mark.sample("[BOOL-struct-utf8-truncate]")
def test_sample_with_each_set(name: str, corpus: Path, tmp_path_factory: pytest.TempPathFactory, topic: str) -> None:
    """Test about 20 messages of ROS 2 with all types that options change, alone, in arrays and in sequences."""
    config, capacities = build_config(corpus, "jazzy", SETS[name], f"shm_sample_{list(SETS).index(name)}")
    layouts = pipeline.lay_out(config, plc_bytes.corpus_names(config))
    chosen = select_messages(layouts)
    folder = tmp_path_factory.mktemp("options")
    proof = plc_bytes.make(config, chosen, folder)
    assert_bounded(proof.layouts, capacities)
    plc_bytes.prove(proof, topic)
    assert_compiles_on_all_machines(folder / "c")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Use the sets that `--options-set` selects, or the first set. All messages with all sets take minutes."""
    if "chosen" in metafunc.fixturenames:
        option = metafunc.config.getoption("--options-set")
        metafunc.parametrize("chosen", SETS if option == "all" else [option or next(iter(SETS))])


@pytest.mark.exhaustive
def test_ros_1_messages_pass_with_the_chosen_set(
    chosen: str, corpus: Path, tmp_path_factory: pytest.TempPathFactory, topic: str
) -> None:
    config, capacities = build_config(corpus, "noetic", SETS[chosen], "shm_noetic_options")
    proof = plc_bytes.make(config, plc_bytes.corpus_names(config), tmp_path_factory.mktemp(chosen))
    assert_bounded(proof.layouts, capacities)
    plc_bytes.prove(proof, topic)


# --- bounds -------------------------------------------------------------------------------------------

LEVELS = {"bounds": (2, 4, 5), "strings": (21, 13, 7)}
"""The bounds that the configuration gives to a package, a message and a field."""


def build_config(
    corpus: Path, distribution: str, options: TypeOptions, package: str
) -> tuple[Config, dict[tuple[str, str], int]]:
    """Return bounds of packages, every third message and every fifth field, and the capacity that each field gets."""
    config = Config(
        corpus, source=distribution, path=(corpus / distribution,), types=options, package=package, max_region=2**26
    )
    schema = pipeline.read(config, plc_bytes.corpus_names(config))
    tables: dict[str, dict[str, Bound]] = {"bounds": {}, "strings": {}}
    capacities: dict[tuple[str, str], int] = {}
    for number, message in enumerate(schema.messages):
        for section, (of_package, of_message, of_field) in LEVELS.items():
            table = tables[section]
            table[message.name.package] = make_bound(of_package)
            if number % 3 == 0:
                table[message.name.short] = make_bound(of_message)
            for place, field in enumerate(message.fields):
                if is_open(field, section):
                    key = f"{message.name.short}.{field.name}"
                    capacity = of_message if number % 3 == 0 else of_package
                    if (number + place) % 5 == 0:
                        capacity = of_field
                    capacity = max(capacity, required_capacity(field, section, options))
                    if (number + place) % 5 == 0 or required_capacity(field, section, options) == capacity:
                        table[key] = make_bound(capacity)
                    capacities[section, key] = capacity
    bounds = Bounds(tables["strings"], tables["bounds"])
    return dataclasses.replace(config, bounds=bounds), capacities


def make_bound(value: int) -> Bound:
    return Bound(value, Span("shmgen.toml"))


def element(field: Field) -> Element:
    return field.type.element if isinstance(field.type, Array | Sequence) else field.type


def is_open(field: Field, section: str) -> bool:
    type_, kind = (field.type, Sequence) if section == "bounds" else (element(field), String)
    return isinstance(type_, kind) and type_.capacity is None


def required_capacity(field: Field, section: str, options: TypeOptions) -> int:
    """Return the capacity that the field's default requires."""
    default = field.default
    if section == "bounds":
        return len(default) if isinstance(default, tuple) else 0
    texts = [text for text in (default if isinstance(default, tuple) else (default,)) if isinstance(text, str)]
    encoding = "utf-16-le" if element(field) == String(wide=True) else options.encoding
    return max((len(text.encode(encoding)) for text in texts), default=0)


def assert_bounded(layouts: Layouts, capacities: dict[tuple[str, str], int]) -> None:
    """Require the capacity of the most specific bound in each field."""
    for name, layout in layouts.items():
        for slot in layout.slots:
            if slot.role is Role.DATA:
                key = f"{name.short}.{slot.name}"
                if ("bounds", key) in capacities:
                    assert slot.count == capacities["bounds", key], key
                if ("strings", key) in capacities:
                    assert isinstance(slot.type, String)
                    assert slot.type.capacity == capacities["strings", key], key


# --- the sample ---------------------------------------------------------------------------------------


def select_messages(layouts: Layouts) -> list[str]:
    """Select each message with a feature that no smaller message has."""
    seen: set[tuple[str, ...]] = set()
    chosen = []
    for name, layout in sorted(layouts.items(), key=lambda item: (item[1].size, item[0])):
        new = set(features(layout.name, layouts)) - seen
        if layout.requested and new:
            seen |= new
            chosen.append(str(name))
    kinds = {kind for kind, _, _ in seen}
    assert kinds == {"bool", "time", "duration", "string", "wstring"}
    return chosen


def features(name: TypeName, layouts: Layouts, within: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield each type that an option changes, with its shape and the shape of the outermost field."""
    for slot in layouts[name].slots:
        if slot.role is not Role.DATA:
            continue
        assert slot.field is not None
        shape = type(slot.field.type).__name__ if slot.count is not None else "one"
        match slot.type:
            case Ref(inner):
                yield from features(inner, layouts, within or shape)
            case String(_, wide):
                yield ("wstring" if wide else "string"), shape, within
            case Clock() | Scalar.BOOL:
                yield slot.type.value, shape, within


def assert_compiles_on_all_machines(folder: Path) -> None:
    """Compile the headers, which assert every offset and size."""
    source = "".join(f'#include "{path.relative_to(folder)}"\n' for path in sorted(folder.rglob("*.h")))
    for compiler, _ in MACHINES.values():
        if shutil.which(compiler):
            command = [compiler, "-std=c11", "-Wall", "-Werror", f"-I{folder}", "-fsyntax-only", "-xc", "-"]
            done = subprocess.run(command, input=source, text=True, capture_output=True, check=False)
            assert done.returncode == 0, f"{compiler}: {done.stderr[:2000]}"
