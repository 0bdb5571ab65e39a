"""Turns ROS names into names that Structured Text, Python and C accept, and reports the ones that meet.

Where the word lists come from:

* Structured Text: the keywords, elementary types, standard functions and function blocks of IEC 61131-3
  edition 3, the instruction list operators of edition 2, and what the CODESYS and TwinCAT help adds under
  "Keywords" and under compiler error C0543. Not verified on a real CODESYS: the lists are rather too long
  than too short, because a name escaped in vain compiles and one left out does not.
* Python: the language reference, section "Keywords" (3.10 to 3.14 agree).
* C: ISO/IEC 9899:2011 and 9899:2024, ISO/IEC 14882:2020, and the macros without a leading underscore that
  gcc defines in its default mode.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

from shmgen.diagnostics import Report, Span
from shmgen.model import Clock, Element, Layout, Ref, Role, Scalar, Slot, String, TypeName, TypeOptions, assert_never


def st_member(name: str) -> str:
    """A field or a constant in Structured Text: `step` -> `step_`.

    CODESYS keeps two underscores in a row to itself, so a row of them becomes one.
    """
    single = _single_underscores(name)
    return single + "_" if single.upper() in ST_RESERVED else single


def python_member(name: str) -> str:
    """A field or a class in Python: `from` -> `from_`."""
    return name + "_" if name in PYTHON_RESERVED else name


def python_class(name: TypeName) -> str:
    """`Pose`; a ROS 1 message `struct` -> `struct_`, because a module refers to Python's own."""
    return name.name + "_" if name.name in PYTHON_RESERVED | PYTHON_USED else name.name


def c_member(name: str) -> str:
    """A field in a header for C11 and C++17: `default` -> `default_`."""
    return name + "_" if name in C_RESERVED else name


def st_type(name: TypeName) -> str:
    """`ST_geometry_msgs_Pose`. The package is always there: 54 bare names occur in more than one ROS package."""
    return _st("ST", name)


def gvl(name: TypeName) -> str:
    """The list that holds a message's constants, a namespace of its own: `GVL_geometry_msgs_Pose`."""
    return _st("GVL", name)


def publisher_block(name: TypeName) -> str:
    """`FB_geometry_msgs_Pose_Publisher`."""
    return _st("FB", name) + "_Publisher"


def subscriber_block(name: TypeName) -> str:
    """`FB_geometry_msgs_Pose_Subscriber`."""
    return _st("FB", name) + "_Subscriber"


def client_block(name: TypeName) -> str:
    """`FB_std_srvs_SetBool_Client`."""
    return _st("FB", name) + "_Client"


def server_block(name: TypeName) -> str:
    """`FB_std_srvs_SetBool_Server`."""
    return _st("FB", name) + "_Server"


def action_client_block(name: TypeName) -> str:
    """`FB_example_interfaces_Fibonacci_ActionClient`."""
    return _st("FB", name) + "_ActionClient"


def action_server_block(name: TypeName) -> str:
    """`FB_example_interfaces_Fibonacci_ActionServer`."""
    return _st("FB", name) + "_ActionServer"


def st_topic(name: str) -> str:
    """The block of a topic in the list of them: `/robot/pose` -> `robot_pose`."""
    return st_member(name.removeprefix("/").replace("/", "_"))


def iec_type(slot: Slot, options: TypeOptions) -> str:
    """The type of a member as Structured Text spells it: `ARRAY[0..35] OF LREAL`."""
    element = iec_element(slot.type, options)
    return element if slot.count is None else f"ARRAY[0..{slot.count - 1}] OF {element}"


def iec_element(type_: Element, options: TypeOptions) -> str:
    """`LREAL`, `STRING(80)`, `TIME`, `ST_geometry_msgs_Point`."""
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
            return st_type(name)
        case _:
            assert_never(type_)


def file_stem(name: TypeName) -> str:
    """`JointState` -> `joint_state`, `SetBool_Request` -> `set_bool_request`: lower case, as rosidl names files."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Za-z0-9])(?=[A-Z][a-z])", "_", name.name).lower()


class Target(NamedTuple):
    """What a target does to a name; `keys` are its names in shmgen.toml, `fold` maps names it takes for one."""

    title: str
    keys: tuple[str, ...]
    escape: Callable[[str], str]
    fold: Callable[[str], str]

    @property
    def way_out(self) -> str:
        keys = " and ".join(f'"{key}"' for key in self.keys)
        return f"rename one of them, or leave {keys} out of `targets` in shmgen.toml"


STRUCTURED_TEXT = Target("Structured Text", ("st", "plcopen"), st_member, str.upper)
PYTHON = Target("Python", ("python",), python_member, str)
C = Target("C", ("c",), c_member, str)

STRUCTURE_FILLER = "structure_needs_at_least_one_member"
"""The single member of a message without fields, named as rosidl names it."""
GVL_SIZE = "SHM_SIZE"
GVL_DIGEST = "SHM_DIGEST"
GVL_TYPE_NAME = "SHM_TYPE_NAME"
"""The generator's own constants beside those of the message."""
GVL_REGION = "GVL_Shm"
"""The list of what both ends of a region must know."""
GVL_TOPICS = "GVL_Ros"
PRG_TOPICS = "PRG_Ros"
"""The list with a block for each topic, and the program that calls them."""
ST_TIME = "ST_shmgen_Time"
"""A ROS time or duration where `time = "struct"`."""


def check_members(layout: Layout, target: Target, report: Report) -> None:
    """Reports fields that `target` cannot tell apart (SHM203) or that meet a member of the generator (SHM204)."""
    named = [
        _Named(
            slot.name,
            "" if slot.role is Role.DATA else f"{slot.role.value} member",
            slot.field.span.at(slot.field.name) if slot.field else layout.message.span,
        )
        for slot in layout.slots
    ]
    _check(layout.name, named, target, report)


def check_constants(layout: Layout, target: Target, own: tuple[str, ...], report: Report) -> None:
    """The same for constants; `own` are the generator's in the same list."""
    named = [_Named(constant.name, "", constant.span) for constant in layout.message.constants]
    made = [_Named(name, "constant", layout.message.span) for name in own]
    _check(layout.name, made + named, target, report)


def check_messages(
    layouts: Iterable[Layout],
    what: str,
    made_of: Callable[[Layout], Iterable[str]],
    target: Target,
    report: Report,
    own: Collection[str] = (),
) -> None:
    """Reports messages that become one `what` ("class", "file") in `target` (SHM203), or one of our `own` (SHM204)."""
    seen: dict[str, Layout] = {}
    for layout in layouts:
        for made in made_of(layout):
            if target.fold(made) in map(target.fold, own):
                fault = f"{layout.name} becomes the {what} `{made}`, which shmgen adds in {target.title}"
                report.error("SHM204", fault, layout.message.span, hint="rename the message")
            other = seen.setdefault(target.fold(made), layout)
            if other is not layout:
                case = "" if made in made_of(other) else ", which ignores case"
                report.error(
                    "SHM203",
                    f"{other.name} and {layout.name} both become the {what} `{made}` in {target.title}{case}",
                    layout.message.span,
                    hint=target.way_out,
                )


class _Named(NamedTuple):
    """A name; `role` says what the generator has it for, and is empty where it is the user's."""

    name: str
    role: str
    span: Span


def _check(message: TypeName, names: list[_Named], target: Target, report: Report) -> None:
    first: dict[str, _Named] = {}
    for named in names:
        escaped = target.escape(named.name)
        other = first.setdefault(target.fold(escaped), named)
        if other is named or report.is_enough(named.span.path):
            continue
        theirs, ours = (named, other) if other.role else (other, named)
        if ours.role:
            report.error(
                "SHM204",
                f"`{theirs.name}` meets the {ours.role} `{ours.name}` that shmgen adds",
                theirs.span,
                field=f"{message.short}.{theirs.name}",
                hint=f"rename `{theirs.name}` in the definition",
            )
        else:
            report.error(
                "SHM203",
                f"`{other.name}` and `{named.name}` are one name in {target.title}" + _why(other, named, target),
                named.span,
                field=f"{message.short}.{named.name}",
                hint=target.way_out,
            )


def _why(one: _Named, other: _Named, target: Target) -> str:
    if one.name.upper() == other.name.upper():
        return ", which ignores case"
    for named in (one, other):
        if target.escape(named.name) != named.name:
            return f": `{named.name}` becomes `{target.escape(named.name)}`"
    return ""


def _st(prefix: str, name: TypeName) -> str:
    return _single_underscores(f"{prefix}_{name.package}_{name.name}")


def _single_underscores(name: str) -> str:
    return re.sub("__+", "_", name)


# --- Structured Text ----------------------------------------------------------------------------------


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ELEMENTARY_TYPES = _words("""
    BOOL BYTE WORD DWORD LWORD SINT INT DINT LINT USINT UINT UDINT ULINT REAL LREAL
    TIME LTIME DATE LDATE TIME_OF_DAY TOD LTIME_OF_DAY LTOD DATE_AND_TIME DT LDATE_AND_TIME LDT
    CHAR WCHAR STRING WSTRING
""")
_KEYWORDS = _words("""
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
_OPERATORS = _words("""
    AND AND_THEN MOD NOT OR OR_ELSE XOR
    ANDN CAL CALC CALCN JMP JMPC JMPCN LD LDN ORN R RET RETC RETCN S ST STN XORN
""")
_STANDARD_FUNCTIONS = _words("""
    ABS ACOS ADD ASIN ATAN ATAN2 CONCAT COS DELETE DIV EQ EXP EXPT FIND GE GT INSERT LE LEFT LEN LIMIT LN LOG LT MAX
    MID MIN MOVE MUL MUX NE REPLACE RIGHT ROL ROR SEL SHL SHR SIN SQRT SUB TAN TRUNC
    CTD CTU CTUD F_TRIG R_TRIG RS SEMA SR TOF TON TP
""")
_CODESYS = _words("""
    ADR BIT BITADR END_FUNCTIONBLOCK END_PROPERTY END_UNION FUNCTIONBLOCK INDEXOF INI LOWER_BOUND PARAMS PERSISTENT
    POINTER PROPERTY REFERENCE SIZEOF TRUNC_INT UNION UPPER_BOUND VAR_GENERIC VAR_INST VAR_STAT XSIZEOF
    CHAR_TO WCHAR_TO
""")
_CONVERSIONS = frozenset(
    f"{source}TO_{target}"
    for source in ("", *(f"{name}_" for name in _ELEMENTARY_TYPES))
    for target in _ELEMENTARY_TYPES
)
ST_RESERVED = _ELEMENTARY_TYPES | _KEYWORDS | _OPERATORS | _STANDARD_FUNCTIONS | _CODESYS | _CONVERSIONS
"""In capitals; Structured Text ignores case. Words such as `__NEW` cannot be met: their underscores become one."""

# --- Python and C -------------------------------------------------------------------------------------

PYTHON_RESERVED = _words("""
    False None True and as assert async await break class continue def del elif else except finally for from global
    if import in is lambda nonlocal not or pass raise return try while with yield
    __debug__ self
""")
"""`self` too: a generated method takes the fields as keyword arguments beside it."""

PYTHON_USED = _words("""
    bool bytearray bytes ctypes float int memoryview runtime staticmethod str struct typing values
""")
"""What a generated module refers to by a bare name."""

PYTHON_STORED = _words("""
    _anonymous_ _align_ _as_parameter_ _b_base_ _b_needsfree_ _decode _digest_ _encode _fields_ _layout_
    _names_ _objects _pack_ _regions_ _set_defaults _swappedbytes_ _type_name_
""")
"""Attributes that ctypes and the generated classes have for themselves, and that all begin with an underscore."""

C_RESERVED = _words("""
    auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    alignas alignof bool constexpr false nullptr static_assert thread_local true typeof typeof_unqual
    and and_eq asm bitand bitor catch char16_t char32_t char8_t class co_await co_return co_yield compl concept
    const_cast consteval constinit decltype delete dynamic_cast explicit export friend mutable namespace new noexcept
    not not_eq operator or or_eq private protected public reinterpret_cast requires static_cast template this throw
    try typeid typename using virtual wchar_t xor xor_eq
    NULL errno i386 linux noreturn offsetof unix
    BUFSIZ EOF HUGE_VAL I INFINITY NAN NSIG complex imaginary math_errhandling stderr stdin stdout
    d_fileno s6_addr s6_addr16 s6_addr32 sa_handler sa_sigaction sched_priority si_addr si_addr_lsb si_arch si_band
    si_call_addr si_fd si_int si_lower si_overrun si_pid si_pkey si_ptr si_status si_stime si_syscall si_timerid si_uid
    si_upper si_utime si_value sigev_notify_attributes sigev_notify_function st_atime st_ctime st_mtime
""")
"""The last rows are macros of gcc (`linux` is 1 unless it is told -std=c11), of C's own headers and of POSIX."""
