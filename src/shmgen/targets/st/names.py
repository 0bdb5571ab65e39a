"""Map names to names that Structured Text accepts, and types to types of IEC 61131-3.

The reserved words include the keywords, elementary types, standard functions and function blocks of IEC 61131-3
edition 3. The instruction list operators come from edition 2. Further words come from the CODESYS and TwinCAT help,
from "Keywords" and from compiler error C0543. The list is not verified with a real CODESYS. The list is
rather too long than too short: an unnecessary escape compiles, but a missing escape does not.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from shmgen.core.model import Clock, Element, Layout, Ref, Scalar, Slot, String, TypeName, TypeOptions, assert_never
from shmgen.targets.naming import ClaimedName, Names, words

GVL_SIZE = "SHM_SIZE"
GVL_DIGEST = "SHM_DIGEST"
GVL_TYPE_NAME = "SHM_TYPE_NAME"
"""The constants that shmgen adds to a message's own constants. Templates in `templates/st` spell these names too."""
GVL_REGION = "GVL_Shm"
"""The list of the protocol's constants."""
GVL_TOPICS = "GVL_Ros"
PRG_TOPICS = "PRG_Ros"
"""The list with a block for each topic, service and action, and the program that calls the blocks."""
ST_TIME = "ST_shmgen_Time"
"""The structure for a ROS time or duration if `time = "struct"`."""


_USUAL = TypeOptions()


def st_member(name: str) -> str:
    """Return the name of a field or a constant in Structured Text: `step` -> `step_`.

    CODESYS reserves consecutive underscores, so a sequence of underscores becomes one.
    """
    single = re.sub("__+", "_", name)
    return single + "_" if single.upper() in ST_RESERVED else single


def st_type(name: TypeName, options: TypeOptions = _USUAL) -> str:
    """Return the structure's name, such as `ST_geometry_msgs_Pose`.

    The name includes the package, because 54 message names occur in more than one ROS package.
    A type that was imported from a PLC project keeps its name from the project.
    """
    own = dict(options.own).get(name, "") if options.own else ""
    return own if own and _is_usable(own) else _st("ST", name)


def own_member(plc: str, options: TypeOptions) -> tuple[str, str]:
    """Return the name and the type that a field had in the PLC project from which the user imported the definition.

    `plc` is the note in the field's comment, such as `rSpeed : REAL`. If the name or the type is missing or unusable,
    return `""` in its place.
    """
    name, _, type_ = plc.partition(" : ")
    if options.names == "ros" or not name or not _is_usable(name):
        return "", ""
    return name, type_ if _OWN_TYPE.fullmatch(type_) else ""


def _is_usable(name: str) -> bool:
    """Return True if the name of a type or member from an imported PLC project can be used in generated code.

    The project's PLC already accepts the name, so only words that all PLCs reserve are rejected.
    """
    return "__" not in name and name.upper() not in _RESERVED_BY_ALL


_OWN_TYPE = re.compile(
    r"(?:ARRAY\[-?\d+\.\.-?\d+(?:, -?\d+\.\.-?\d+)*\] OF )*(?:[^\W\d_]\w*(?:\.[^\W\d_]\w*)?|W?STRING\(\d+\))"
)
"""The types that shmgen copies from an imported project into code.

The pattern keeps all other text of a comment out of the code.
"""


def gvl(name: TypeName) -> str:
    """Return the name of the list of a message's constants: `GVL_geometry_msgs_Pose`.

    Programs write this name before each constant, so messages may have constants of the same name.
    """
    return _st("GVL", name)


def block_name(name: TypeName, role: str) -> str:
    """Return the name of a function block: `FB_geometry_msgs_Pose_Publisher` for the role `Publisher`.

    The other roles are Subscriber, Client, Server, ActionClient and ActionServer.
    """
    return f"{_st('FB', name)}_{role}"


def st_topic(name: str) -> str:
    """Return the name of a topic's block in the variable list `GVL_Ros`: `/robot/pose` -> `robot_pose`."""
    return st_member(name.removeprefix("/").replace("/", "_"))


def iec_type(slot: Slot, options: TypeOptions) -> str:
    """Return a member's type in Structured Text, such as `ARRAY[0..35] OF LREAL`."""
    element = iec_element(slot.type, options)
    return element if slot.count is None else f"ARRAY[0..{slot.count - 1}] OF {element}"


def iec_element(type_: Element, options: TypeOptions) -> str:
    """Return an element's type in Structured Text, such as `LREAL`, `STRING(80)` or `ST_geometry_msgs_Point`."""
    match type_:
        case Scalar.BOOL:
            return options.bool
        case Scalar():
            return type_.iec
        case Clock():
            return ST_TIME if options.time == "struct" else options.time
        case String(capacity, wide):
            assert capacity is not None, "bounds come before targets"
            return f"WSTRING({capacity})" if wide else f"STRING({capacity})"
        case Ref(name):
            return st_type(name, options)
        case _:
            assert_never(type_)


def _claims(layout: Layout, package: str) -> Iterator[ClaimedName]:
    yield ClaimedName("type", st_type(layout.name, layout.options))


def _st(prefix: str, name: TypeName) -> str:
    return re.sub("__+", "_", f"{prefix}_{name.package}_{name.name}")


_ELEMENTARY_TYPES = words("""
    BOOL BYTE WORD DWORD LWORD SINT INT DINT LINT USINT UINT UDINT ULINT REAL LREAL
    TIME LTIME DATE LDATE TIME_OF_DAY TOD LTIME_OF_DAY LTOD DATE_AND_TIME DT LDATE_AND_TIME LDT
    CHAR WCHAR STRING WSTRING
""")
_KEYWORDS = words("""
    ABSTRACT ACTION ARRAY AT BY CASE CLASS CONFIGURATION CONSTANT CONTINUE DO ELSE ELSIF EN ENO
    END_ACTION END_CASE END_CLASS END_CONFIGURATION END_FOR END_FUNCTION END_FUNCTION_BLOCK END_IF END_INTERFACE
    END_METHOD END_NAMESPACE END_PROGRAM END_REPEAT END_RESOURCE END_STEP END_STRUCT END_TRANSITION END_TYPE
    END_VAR END_WHILE EXIT EXTENDS F_EDGE FALSE FINAL FOR FROM FUNCTION FUNCTION_BLOCK IF IMPLEMENTS
    INITIAL_STEP INTERFACE INTERNAL INTERVAL METHOD NAMESPACE NON_RETAIN NULL OF ON OVERLAP OVERRIDE PRIORITY
    PRIVATE PROGRAM PROTECTED PUBLIC R_EDGE READ_ONLY READ_WRITE REF REF_TO REPEAT RESOURCE RETAIN RETURN SINGLE
    STEP STRUCT SUPER TASK THEN THIS TO TRANSITION TRUE TYPE UNTIL USING VAR VAR_ACCESS VAR_CONFIG
    VAR_EXTERNAL VAR_GLOBAL VAR_IN_OUT VAR_INPUT VAR_OUTPUT VAR_TEMP WHILE WITH
    ANY ANY_BIT ANY_CHAR ANY_CHARS ANY_DATE ANY_DERIVED ANY_DURATION ANY_ELEMENTARY ANY_INT ANY_MAGNITUDE ANY_NUM
    ANY_REAL ANY_SIGNED ANY_STRING ANY_UNSIGNED
""")
_OPERATORS = words("""
    AND AND_THEN MOD NOT OR OR_ELSE XOR
    ANDN CAL CALC CALCN JMP JMPC JMPCN LD LDN ORN R RET RETC RETCN S ST STN XORN
""")
_STANDARD_FUNCTIONS = words("""
    ABS ACOS ADD ASIN ATAN ATAN2 CONCAT COS DELETE DIV EQ EXP EXPT FIND GE GT INSERT LE LEFT LEN LIMIT LN LOG LT MAX
    MID MIN MOVE MUL MUX NE REPLACE RIGHT ROL ROR SEL SHL SHR SIN SQRT SUB TAN TRUNC
    CTD CTU CTUD F_TRIG R_TRIG RS SEMA SR TOF TON TP
""")
_CODESYS = words("""
    ADR BIT BITADR END_FUNCTIONBLOCK END_GET END_PROPERTY END_SET END_UNION FUNCTIONBLOCK INDEXOF INI LOWER_BOUND
    PARAMS PERSISTENT POINTER PROPERTY REFERENCE SIZEOF TEST_AND_SET TRUNC_INT UNION UPPER_BOUND VAR_GENERIC VAR_INST
    VAR_STAT XSIZEOF
    CHAR_TO WCHAR_TO
""")
_CONVERSIONS = frozenset(
    f"{source}TO_{target}"
    for source in ("", *(f"{name}_" for name in _ELEMENTARY_TYPES))
    for target in _ELEMENTARY_TYPES
)
ST_RESERVED = _ELEMENTARY_TYPES | _KEYWORDS | _OPERATORS | _STANDARD_FUNCTIONS | _CODESYS | _CONVERSIONS
"""All reserved words, in capitals, because Structured Text ignores case.

Words with consecutive underscores, such as `__NEW`, are not listed: st_member() reduces the underscores to one.
"""
_OF_EDITION_3 = words("""
    LTIME LDATE LTIME_OF_DAY LTOD LDATE_AND_TIME LDT CHAR WCHAR
    ABSTRACT CLASS CONTINUE FINAL FROM INTERFACE INTERNAL INTERVAL METHOD NAMESPACE NULL ON OVERLAP OVERRIDE PRIORITY
    PRIVATE PROTECTED PUBLIC REF REF_TO SINGLE SUPER TASK THIS USING
""")
_RESERVED_BY_ALL = (_ELEMENTARY_TYPES | _KEYWORDS | words("AND MOD NOT OR XOR")) - _OF_EDITION_3

NAMES = Names(
    "Structured Text",
    member=st_member,
    constant=st_member,
    claims=_claims,
    fold=str.upper,
    own=(ST_TIME,),
    own_constants=(GVL_TYPE_NAME, GVL_SIZE, GVL_DIGEST),
    constants_apart=True,
    use=st_topic,
)
