"""Map names to names that both open compilers, STruC++ and matiec, accept.

matiec rejects a name with consecutive underscores or an underscore at the end. The escape of the target st, `type_`,
is therefore `type_0` here. The reserved words are the words of the target st, of matiec's lexer, and macros.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from shmgen.core.model import Layout
from shmgen.targets.naming import ClaimedName, Names, words
from shmgen.targets.openplc.macros import MACROS
from shmgen.targets.st import names as st

GLOBALS = "GVL_Ros"
"""The global structure with a member for each topic, service and action. Its type is ST_Ros."""

_MATIEC = words("""
    CD CLK CU DREF DS EN ENO FROM F_EDGE N NON_RETAIN NULL P P0 P1 PT PV R1 READ_ONLY READ_WRITE REF R_EDGE S1 SAFEBOOL
    SAFEBYTE SAFEDATE SAFEDATE_AND_TIME SAFEDINT SAFEDT SAFEDWORD SAFEINT SAFELINT SAFELREAL SAFELWORD SAFEREAL
    SAFESINT SAFESTRING SAFETIME SAFETIME_OF_DAY SAFETOD SAFEUDINT SAFEUINT SAFEULINT SAFEUSINT SAFEWORD SAFEWSTRING
    SD SINGLE SL VOID
""")
RESERVED = st.ST_RESERVED | _MATIEC | MACROS
"""All reserved words, in capitals, because both compilers ignore case."""


def member(name: str) -> str:
    """Return the name of a field, a constant or a topic: `step` -> `step_0`, `a__b` -> `a_b`, `x_` -> `x_0`."""
    single = re.sub("_+", "_", name)
    return single.rstrip("_") + "_0" if single.endswith("_") or single.upper() in RESERVED else single


def whole(name: str) -> str:
    """Return a valid name for a type or a block, which already has a prefix: `ST_pkg_Name_` -> `ST_pkg_Name_0`.

    Because of the prefix, the name cannot be a reserved word.
    """
    return name + "0" if name.endswith("_") else name


def topic(name: str) -> str:
    """Return the name of a topic's member in the structure `GVL_Ros`: `/robot/pose` -> `robot_pose`."""
    return member(name.removeprefix("/").replace("/", "_"))


def names(title: str, case: Callable[[str], str] = str) -> Names:
    """Return the naming rules of an open compiler. `case` is str.upper if all names are in capitals."""

    def spelled(name: str) -> str:
        return case(member(name))

    def claims(layout: Layout, package: str) -> Iterator[ClaimedName]:
        yield ClaimedName("type", case(whole(st.st_type(layout.name))))

    own = (st.ST_TIME, "ST_Ros")
    return Names(title, spelled, spelled, claims, fold=str.upper, own=own, constants_apart=True, use=topic)
