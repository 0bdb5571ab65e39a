"""Turns ROS names into names that Rust accepts.

The words are those of the reference, section "Keywords", and the names of types that a structure could hide.
"""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, TypeName
from shmgen.targets.naming import ClaimedName, Names, file_stem, words


def rust_name(name: str) -> str:
    """Return the name of a field, a constant, a structure or a module: `type` -> `type_`."""
    return name + "_" if name in RUST_RESERVED else name


def module(name: TypeName) -> str:
    """Return the module of a structure: `crate::geometry_msgs::msg`."""
    return f"crate::{rust_name(name.package)}::{name.kind}"


def file(name: TypeName) -> str:
    """Return a path below the crate's folder: `geometry_msgs/msg/file_pose.rs`. No keyword begins with `file_`."""
    return f"{rust_name(name.package)}/{name.kind}/file_{file_stem(name)}.rs"


def _claims(layout: Layout, package: str) -> Iterator[ClaimedName]:
    yield ClaimedName("module", rust_name(layout.name.package), owner=layout.name.package)
    yield ClaimedName("structure", rust_name(layout.name.name), module(layout.name))
    yield ClaimedName("file", file(layout.name))


RUST_RESERVED = words("""
    as async await break const continue crate dyn else enum extern false fn for if impl in let loop match mod move mut
    pub ref return self Self static struct super trait true type unsafe use where while
    abstract become box do final gen macro override priv try typeof unsized virtual yield union
    bool char f32 f64 i8 i16 i32 i64 i128 isize str u8 u16 u32 u64 u128 usize core std
""")
_OWN = ("SHM_TYPE_NAME", "SHM_DIGEST")
NAMES = Names("Rust", rust_name, rust_name, _claims, own_constants=_OWN, constants_apart=True)
