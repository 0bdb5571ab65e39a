"""A document is unchanged after it was written and read as TOML."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from shmgen.core import toml

texts = st.text(st.characters(exclude_categories=["Cs"]))
plain = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | texts
flat = st.dictionaries(texts, plain | st.lists(plain), max_size=3)
documents = st.dictionaries(texts, plain | st.lists(plain) | flat | st.lists(flat, max_size=3), max_size=5)


@given(documents)
def test_written_document_is_read_unchanged(document: dict[str, object]) -> None:
    assert toml.loads(toml.dumps(document)) == document


def test_written_text_is_readable() -> None:
    tree = {"bounds": {"a_msgs/B.c": 8}, "path": ["msgs"], "topics": [{"topic": "/a", "latch": True}, {"topic": "/b"}]}
    assert toml.dumps(tree) == (
        'path = ["msgs"]\n\n[bounds]\n"a_msgs/B.c" = 8\n\n[[topics]]\ntopic = "/a"\nlatch = true\n'
        '\n[[topics]]\ntopic = "/b"\n'
    )
