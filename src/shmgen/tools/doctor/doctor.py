"""Reports the state of all regions, or of one, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from shmgen.config import Config
from shmgen.core.plural import counted
from shmgen.live import processes
from shmgen.live.classes import ClassRegistry
from shmgen.live.processes import called
from shmgen.live.regions import live, meant, missing
from shmgen.runtime import region_name
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import region_file
from shmgen.tools.doctor import checks, permissions
from shmgen.tools.doctor.environment import of_machine, of_strays
from shmgen.tools.doctor.problem import Problem, owner
from shmgen.tools.doctor.snapshot import Evidence, Wanted, gather


@dataclass(frozen=True, slots=True)
class Examination:
    """What was looked at, and what was found; `healthy` if nothing of that is a fault."""

    regions: tuple[Evidence, ...]
    findings: tuple[Problem, ...]

    @property
    def healthy(self) -> bool:
        return all(finding.note for finding in self.findings)


def examine(topic: str | None, registry: ClassRegistry) -> Examination:
    """Looks at every region, or at one, for a quarter of a second, or a whole one where a lock seems stuck.

    Raises RegionMissing, PermissionDenied, Rejected for a wrong shmgen.toml, and ValueError for a wrong topic.
    """
    asked = None if topic is None else meant(topic)
    names = live() if asked is None else [region_name(one) for one in asked]
    around = processes.look()
    said = Wanted(regions=registry.config.regions)
    wanted = dict.fromkeys(map(_full, asked or ()), said) | _wanted(registry.config)
    meant_to_be = {*live(), *map(region_name, wanted)}
    known, wrong = registry.known() if names else ({}, ())
    regions = gather(names, around, wanted, known)
    found = [finding for seen in regions for finding in checks.of_region(seen)]
    found += [Problem("", f"{one.message} ({one.code})", one.hint, one.span.path) for one in wrong]
    found += permissions.of_places(sorted(meant_to_be))
    found += of_strays(around, meant_to_be, names if asked else ())
    found += of_machine(around)
    if asked is not None:
        about = {"", *map(_full, asked)}
        found = [finding for finding in found if finding.topic in about]
    if topic is not None and not regions and not any(finding.topic for finding in found):
        raise missing(topic)
    return Examination(tuple(regions), tuple(found))


def text(report: Examination) -> str:
    """Region by region, its state and the findings; then what holds for all."""
    lines: list[str] = []
    for seen in report.regions:
        lines += [_title(seen), *(f"  {line}" for line in _state(seen))]
        lines += _shown(finding for finding in report.findings if finding.topic == seen.topic)
    known = {seen.topic for seen in report.regions}
    others = [finding for finding in report.findings if finding.topic not in known]
    for topic in dict.fromkeys(finding.topic for finding in others):
        lines += [topic or "this machine", *_shown(finding for finding in others if finding.topic == topic)]
    faults = sum(not finding.note for finding in report.findings)
    return "\n".join([*lines, f"{_count(len(report.regions), 'region')}, {_count(faults, 'fault')}"])


def plain(report: Examination) -> dict[str, Any]:
    """The same for machines."""
    return {
        "healthy": report.healthy,
        "regions": [
            {
                "topic": seen.topic,
                "file": region_file(seen.name),
                "type": seen.after.type_name,
                "digest": f"{seen.after.digest:016x}",
                "payload_size": seen.after.payload_size,
                "size": seen.after.size,
                "slots": seen.after.slots,
                "samples": seen.after.newest,
                "owner": seen.status.st_uid,
                "group": seen.status.st_gid,
                "mode": f"{seen.status.st_mode & 0o7777:o}",
                "writer": _writer(seen),
                "writer_pid": seen.writer if seen.claimed else None,
                "semaphore": seen.semaphores[1].value if seen.semaphores[1] else None,
                "recoveries": seen.after.recoveries,
                "processes": [asdict(peer) for peer in seen.peers],
            }
            for seen in report.regions
        ],
        "findings": [asdict(finding) for finding in report.findings],
    }


def _wanted(config: Config) -> dict[str, Wanted]:
    """What the configuration says of each region."""
    said = [(entry.topic, entry.type, entry.depth) for entry in config.topics]
    for service in config.services:
        for half, ending in (("request", "Request"), ("response", "Reply")):
            said.append((f"{service.service}-{half}", f"{service.type}_{ending}", 1))
    for action in config.actions:
        for half, ending in (("goal", "Command"), ("feedback", "Progress"), ("result", "Outcome")):
            said.append((f"{action.action}-{half}", f"{action.type}_{ending}", 1))
    return {_full(topic): Wanted(type_name, depth, config.regions) for topic, type_name, depth in said}


def _full(topic: str) -> str:
    return "/" + topic.removeprefix("/")


def _title(seen: Evidence) -> str:
    header = seen.after
    return (
        f"{seen.topic}  {header.type_name}, {counted(header.slots, 'slot')}, {counted(header.newest, 'sample')}, "
        f"{counted(header.size, 'byte')}, {owner(seen.status)}"
    )


def _state(seen: Evidence) -> Iterator[str]:
    yield f"writer: {_writer(seen)}"
    others = [str(peer) for peer in seen.peers if not (seen.claimed and peer.pid == seen.writer)]
    if others:
        yield f"open in: {', '.join(others)}"
    lock = seen.semaphores[1]
    if lock and lock.value is not None:
        entered = (seen.after.lock_count - seen.before.lock_count) % 2**32 / seen.seconds
        recovered = f", {seen.after.recoveries} times taken from the dead" if seen.after.recoveries else ""
        yield f"lock: {'free' if lock.value else 'taken'}, entered {entered:.0f} times a second{recovered}"
    if seen.layout:
        same = (seen.layout.digest, seen.layout.size) == (seen.after.digest, seen.after.payload_size)
        yield f"layout: {'as' if same else 'not as'} in {seen.layout.origin}"


def _writer(seen: Evidence) -> str:
    writer = seen.writer
    if seen.claimed:
        return f"process {writer} ({called(writer) or 'of another pid namespace'}), alive"
    if writer == h.PLC:
        return "a PLC, alive" if seen.before.heartbeat != seen.after.heartbeat else "a PLC, which stands still"
    return f"process {writer}, ended" if writer else "none yet"


def _shown(findings: Iterator[Problem] | Sequence[Problem]) -> list[str]:
    lines = []
    for finding in findings:
        lines.append(f"  {'note' if finding.note else 'fault'}: {finding.message}")
        if finding.file:
            lines.append(f"    file: {finding.file}")
        lines.append(f"    hint: {finding.hint}")
    return lines


def _count(number: int, word: str) -> str:
    return counted(number, word) if number else f"no {word}s"
