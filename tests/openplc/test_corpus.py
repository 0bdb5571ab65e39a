"""Messages of the corpus that an open dialect supports pass unchanged in both directions."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Rejected, Span
from shmgen.generator import pipeline
from shmgen.targets.st import names as st

from ..support import build, open_plc, plc_bytes
from ..support.schemas import plain, random_message
from .test_blocks import call_until_open


@pytest.mark.sample("[noetic-221-0-openplc-v4]")
@pytest.mark.parametrize("compiler", open_plc.COMPILERS)
@pytest.mark.parametrize(("distribution", "count", "refused"), [("noetic", 221, 0), ("jazzy", 624, 7)])
def test_corpus_messages_pass_in_both_directions(
    distribution: str, count: int, refused: int, compiler: str, corpus: Path, tmp_path: Path, topic: str
) -> None:
    """Compile with -O0, because compilation takes most of the time."""
    folder, package = corpus / distribution, f"shm_open_{distribution}_{compiler.replace('-', '_')}"
    bounds = Bounds({}, {path.name: Bound(3, Span("shmgen.toml")) for path in folder.iterdir()})
    targets = ("openplc" if compiler == "openplc-v4" else "matiec", "python")
    config = Config(corpus, source=distribution, path=(folder,), package=package, bounds=bounds, targets=targets)
    names = plc_bytes.corpus_names(config)
    assert len(names) == count
    texts, names = generate_supported(config, names)
    assert count - len(names) <= refused
    layouts = pipeline.lay_out(config, names)
    build.put(texts, tmp_path)
    program = open_plc.Program(open_plc.compiled(texts, compiler, tmp_path, package, "-O0"))
    for number, (name, layout) in enumerate(layouts.items()):
        if not layout.requested:
            continue
        _, publisher_kind, subscriber_kind = build.classes(tmp_path, package, name)
        message = random_message(layout, layouts, random.Random(str(name)))
        to_plc, from_plc = f"{topic}/to{number}", f"{topic}/from{number}"
        subscriber = program.block(st.block_name(name, "Subscriber"), xEnable=True, sTopic=to_plc)
        publisher = program.block(st.block_name(name, "Publisher"), xEnable=True, sTopic=from_plc, xSend=False)
        with publisher_kind(to_plc) as writer, subscriber_kind(from_plc) as reader:
            call_until_open(subscriber)
            call_until_open(publisher)
            writer.publish(message)
            assert subscriber().xNewData, name
            subscriber.move(publisher)
            assert publisher(xSend=True).xSent, (name, publisher.eErrorID)
            assert plain(reader.read()) == plain(message), name
        subscriber(xEnable=False)
        publisher(xEnable=False)
    program.unload()


def generate_supported(config: Config, names: list[str]) -> tuple[dict[str, str], list[str]]:
    """Generate the messages that the dialect supports. Return the files and the names of these messages."""
    remaining = list(names)
    while True:
        try:
            return pipeline.generate(config, remaining), remaining
        except Rejected as rejected:
            refused = {it.field.rpartition(".")[0] for it in rejected.diagnostics if it.code == "SHM305"}
            layouts = pipeline.lay_out(config, remaining)
            unsupported = {name for name, layout in layouts.items() if layout.name.short in refused}
            for name, layout in layouts.items():
                if unsupported & set(layout.dependencies):
                    unsupported.add(name)
            remaining = [name for name in remaining if name not in map(str, unsupported)]
