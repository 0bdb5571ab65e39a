"""Names that both open compilers accept, STruC++ and matiec.

matiec refuses a name that ends with an underscore or holds two in a row, so that the escape of the target st, `type_`,
will not do: it is `type_0` here. The words are those of the target st, those of matiec's lexer beside them, and macros.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

from shmgen.core.model import Layout
from shmgen.targets.naming import ClaimedName, Names, words
from shmgen.targets.openplc.macros import MACROS
from shmgen.targets.st import names as st

GLOBALS = "GVL_Ros"
"""The global structure with a member for each topic, and as ST_Ros its type."""
PROGRAM = st.PRG_TOPICS

_MATIEC = words("""
    CD CLK CU DREF DS EN ENO FROM F_EDGE N NON_RETAIN NULL P P0 P1 PT PV R1 READ_ONLY READ_WRITE REF R_EDGE S1 SAFEBOOL
    SAFEBYTE SAFEDATE SAFEDATE_AND_TIME SAFEDINT SAFEDT SAFEDWORD SAFEINT SAFELINT SAFELREAL SAFELWORD SAFEREAL
    SAFESINT SAFESTRING SAFETIME SAFETIME_OF_DAY SAFETOD SAFEUDINT SAFEUINT SAFEULINT SAFEUSINT SAFEWORD SAFEWSTRING
    SD SINGLE SL VOID
""")
RESERVED = st.ST_RESERVED | _MATIEC | MACROS
"""In capitals; both compilers ignore case."""


def member(name: str) -> str:
    """A field, a constant or a topic: `step` -> `step_0`, `a__b` -> `a_b`, `x_` -> `x_0`."""
    single = re.sub("_+", "_", name)
    return single.rstrip("_") + "_0" if single.endswith("_") or single.upper() in RESERVED else single


def whole(name: str) -> str:
    """A type or a block that has a prefix already, and so can be no reserved word."""
    return name + "0" if name.endswith("_") else name


def topic(name: str) -> str:
    """The member of a topic in the global structure: `/robot/pose` -> `robot_pose`."""
    return member(name.removeprefix("/").replace("/", "_"))


def _made(layout: Layout, package: str) -> Iterator[ClaimedName]:
    yield ClaimedName("type", whole(st.st_type(layout.name)))


def names(title: str) -> Names:
    own = (st.ST_TIME, "ST_Ros")
    return Names(title, member, member, _made, fold=str.upper, own=own, constants_apart=True, use=topic)


def capital_names(title: str) -> Names:
    """The same where they are written in capitals."""
    return replace(
        names(title),
        member=lambda name: member(name).upper(),
        constant=lambda name: member(name).upper(),
        made=lambda layout, package: (one._replace(name=one.name.upper()) for one in _made(layout, package)),
    )
