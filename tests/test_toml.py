"""What is written as TOML is what comes back."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from shmgen.core import toml

texts = st.text(st.characters(exclude_categories=["Cs"]))
plain = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | texts
flat = st.dictionaries(texts, plain | st.lists(plain), max_size=3)
documents = st.dictionaries(texts, plain | st.lists(plain) | flat | st.lists(flat, max_size=3), max_size=5)


@given(documents)
def test_tables_come_back(document: dict[str, object]) -> None:
    assert toml.loads(toml.dumps(document)) == document


def test_what_a_person_reads() -> None:
    said = {"bounds": {"a_msgs/B.c": 8}, "path": ["msgs"], "topics": [{"topic": "/a", "latch": True}, {"topic": "/b"}]}
    assert toml.dumps(said) == (
        'path = ["msgs"]\n\n[bounds]\n"a_msgs/B.c" = 8\n\n[[topics]]\ntopic = "/a"\nlatch = true\n'
        '\n[[topics]]\ntopic = "/b"\n'
    )
