"""Every message of the corpus that an open dialect can hold, there and back."""

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
from .test_blocks import ready


@pytest.mark.slow
@pytest.mark.parametrize("compiler", open_plc.COMPILERS)
@pytest.mark.parametrize(("distribution", "count", "refused"), [("noetic", 221, 0), ("jazzy", 624, 7)])
def test_every_message(
    distribution: str, count: int, refused: int, compiler: str, corpus: Path, tmp_path: Path, topic: str
) -> None:
    """At -O0: compiling is what takes the time."""
    folder, package = corpus / distribution, f"shm_open_{distribution}_{compiler.replace('-', '_')}"
    bounds = Bounds({}, {path.name: Bound(3, Span("shmgen.toml")) for path in folder.iterdir()})
    targets = ("openplc" if compiler == "openplc-v4" else "matiec", "python")
    config = Config(corpus, source=distribution, path=(folder,), package=package, bounds=bounds, targets=targets)
    names = plc_bytes.corpus_names(config)
    assert len(names) == count
    texts, names = held(config, names)
    assert count - len(names) <= refused
    layouts = pipeline.lay_out(config, names)
    build.put(texts, tmp_path)
    program = open_plc.Program(open_plc.compiled(texts, compiler, tmp_path, package, "-O0"))
    for number, (name, layout) in enumerate(layouts.items()):
        if not layout.requested:
            continue
        _, publisher_kind, subscriber_kind = build.classes(tmp_path, package, name)
        message = random_message(layout, layouts, random.Random(str(name)))
        heard = program.block(st.subscriber_block(name), xEnable=True, sTopic=f"{topic}/to{number}")
        said = program.block(st.publisher_block(name), xEnable=True, sTopic=f"{topic}/from{number}", xSend=False)
        with (
            publisher_kind(f"{topic}/to{number}") as writer,
            subscriber_kind(f"{topic}/from{number}") as reader,
        ):
            ready(heard)
            ready(said)
            writer.publish(message)
            assert heard().xNewData, name
            heard.move(said)
            assert said(xSend=True).xSent, (name, said.eErrorID)
            assert plain(reader.read()) == plain(message), name
        heard(xEnable=False)
        said(xEnable=False)
    program.unload()


def held(config: Config, names: list[str]) -> tuple[dict[str, str], list[str]]:
    """What is generated of those that the dialect can hold, and their names."""
    left = list(names)
    while True:
        try:
            return pipeline.generate(config, left), left
        except Rejected as rejected:
            gone = {found.field.rpartition(".")[0] for found in rejected.diagnostics if found.code == "SHM305"}
            layouts = pipeline.lay_out(config, left)
            bad = {name for name, layout in layouts.items() if layout.name.short in gone}
            for name, layout in layouts.items():
                if bad & set(layout.dependencies):
                    bad.add(name)
            left = [name for name in left if name not in map(str, bad)]
