"""Each key of shmgen.toml for the bridge accepts its values, and each error names its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from shmgen.config.entries import TransferOptions
from shmgen.config.file import Bridge

from .test_file import load, load_errors

TO_PLC = "[[topics]]\ntopic = '/a'\ntype = 'a/B'\n"
FROM_PLC = TO_PLC + "direction = 'from_plc'\n"


def test_keys_of_the_bridge_are_optional(tmp_path: Path) -> None:
    loaded = load(tmp_path, TO_PLC)
    assert loaded.bridge == Bridge(backend="auto", node="shmgen_bridge", diagnostics=1.0, domain=None)
    assert loaded.topics[0].carried == TransferOptions(
        rate=None, qos="auto", latch=False, stamp="now", overflow="reject", stale=None, other_definition="refuse"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("backend = 'dds'", Bridge(backend="dds")),
        ("node = 'cell_4'", Bridge(node="cell_4")),
        ("diagnostics = 0", Bridge(diagnostics=0.0)),
        ("diagnostics = 0.25", Bridge(diagnostics=0.25)),
        ("domain = 0", Bridge(domain=0)),
        ("domain = 232", Bridge(domain=232)),
    ],
)
def test_keys_of_the_bridge_are_loaded(tmp_path: Path, text: str, expected: Bridge) -> None:
    assert load(tmp_path, f"[bridge]\n{text}").bridge == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (TO_PLC + "rate = 10", TransferOptions(rate=10.0)),
        (TO_PLC + "qos = 'best_effort'", TransferOptions(qos="best_effort")),
        (TO_PLC + "latch = true", TransferOptions(latch=True)),
        (TO_PLC + "overflow = 'truncate'", TransferOptions(overflow="truncate")),
        (TO_PLC + "stale = 0.5", TransferOptions(stale=0.5)),
        (TO_PLC + "other_definition = 'accept'", TransferOptions(other_definition="accept")),
        (FROM_PLC + "stamp = 'keep'", TransferOptions(stamp="keep")),
    ],
)
def test_keys_of_a_topic_are_loaded(tmp_path: Path, text: str, expected: TransferOptions) -> None:
    assert load(tmp_path, text).topics[0].carried == expected


@pytest.mark.parametrize(
    ("text", "code", "line", "phrase"),
    [
        ("bridge = 3", "SHM502", 1, "write [bridge]"),
        ("[bridge]\nbackend = 'ros'", "SHM502", 2, "auto, ros2, dds, zenoh, ros1"),
        ("[bridge]\nbackand = 'ros1'", "SHM501", 2, "did you mean backend?"),
        ("[bridge]\nnode = '/bridge'", "SHM502", 2, "letters, digits and _"),
        ("[bridge]\nnode = 3", "SHM502", 2, "not 3"),
        ("[bridge]\ndiagnostics = -1", "SHM502", 2, "from 0 to 86400"),
        ("[bridge]\ndomain = 233", "SHM502", 2, "from 0 to 232"),
        ("[bridge]\ndomain = true", "SHM502", 2, "not True"),
        (TO_PLC + "rate = 0", "SHM502", 4, "a number of Hz from 0.001 to 10000, not 0"),
        (TO_PLC + "rate = nan", "SHM502", 4, "not nan"),
        (TO_PLC + "rate = '10'", "SHM502", 4, "not '10'"),
        (TO_PLC + "qos = 'best-effort'", "SHM502", 4, "did you mean best_effort?"),
        (TO_PLC + "latch = 1", "SHM502", 4, "true or false, not 1"),
        (TO_PLC + "overflow = 'cut'", "SHM502", 4, "reject, truncate"),
        (TO_PLC + "stale = 0", "SHM502", 4, "a number of seconds"),
        (TO_PLC + "stamp = 'now'", "SHM502", 4, 'stamp is valid only with direction = "from_plc"'),
        (TO_PLC + "other_definition = 'trust'", "SHM502", 4, "refuse, accept"),
        (FROM_PLC + "other_definition = 'accept'", "SHM502", 5, 'is valid only with direction = "to_plc"'),
        (FROM_PLC + "overflow = 'reject'", "SHM502", 5, 'overflow is valid only with direction = "to_plc"'),
        (FROM_PLC + "stamp = 'zero'", "SHM502", 5, "now, keep"),
        (FROM_PLC + "latched = true", "SHM501", 5, "did you mean latch?"),
    ],
)
def test_errors_name_code_line_and_hint(tmp_path: Path, text: str, code: str, line: int, phrase: str) -> None:
    (error,) = load_errors(tmp_path, text)
    assert (error.code, error.span.line) == (code, line), str(error)
    assert phrase in error.message + error.hint


def test_options_of_the_bridge_change_no_generated_file(tmp_path: Path) -> None:
    """Keep these options out of layout.lock, so that a new `rate` requires no new PLC program."""
    from shmgen.generator import pipeline

    plain = TO_PLC.replace("a/B", "std_msgs/Bool")
    texts: list[Any] = [
        pipeline.generate(load(tmp_path, text), [])
        for text in (plain, plain + "rate = 5\nlatch = true\n[bridge]\nbackend = 'dds'")
    ]
    assert texts[0] == texts[1]
