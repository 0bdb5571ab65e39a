"""Map names to names that C11 and C++17 accept.

The reserved words come from ISO/IEC 9899:2011 and 9899:2024 and from ISO/IEC 14882:2020. The list also contains the
macros without a leading underscore that gcc defines in its default mode.
"""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, TypeName
from shmgen.targets.naming import ClaimedName, Names, file_stem, words


def c_member(name: str) -> str:
    """Return a valid name for a field in C and C++, and for anything else in C++: `default` -> `default_`."""
    return name + "_" if name in C_RESERVED else name


def struct_name(name: TypeName) -> str:
    """Return the structure's name: `shm_geometry_msgs_Pose`."""
    return f"shm_{name.package}_{name.name}"


def macro(name: TypeName, constant: str) -> str:
    """Return a constant's macro name, with a prefix as its namespace: `shm_shape_msgs_SolidPrimitive_BOX`."""
    return f"{struct_name(name)}_{constant}"


def header(name: TypeName, package: str) -> str:
    """Return the include path of a message's header: `shm_msgs/geometry_msgs/msg/pose.h`."""
    return f"{package}/{name.package}/{name.kind}/{file_stem(name)}.h"


def ends_header(name: TypeName, package: str) -> str:
    """Return the include path of the publisher and subscriber header: `shm_msgs/geometry_msgs/msg/pose_shm.h`."""
    return header(name, package).removesuffix(".h") + "_shm.h"


def calls_header(name: TypeName, package: str) -> str:
    """Return the include path of a service or action header: `shm_msgs/std_srvs/srv/set_bool_service.h`."""
    word = "action" if name.kind == "action" else "service"
    return header(name, package).removesuffix(".h") + f"_{word}.h"


def calls_name(name: TypeName) -> str:
    """Return the prefix of a service's or an action's C names: `shm_std_srvs_SetBool`, as in `<prefix>_client`.

    The prefix of an action ends with `_action`, so that a service of the same name has other names.
    """
    return struct_name(name) + ("_action" if name.kind == "action" else "")


def _claims(layout: Layout, package: str) -> Iterator[ClaimedName]:
    """Yield all C names and files of a message.

    Structures and macros have the same kind `name`, because a structure must not have the name of a macro.
    """
    struct = struct_name(layout.name)
    yield ClaimedName("name", struct)
    for constant in layout.message.constants:
        yield ClaimedName("name", macro(layout.name, constant.name))
    for ending in _ENDS if layout.requested else ():
        yield ClaimedName("name", struct + ending, is_derived=True)
    for wrapper, calls in _CALLS.items() if layout.requested else ():
        if layout.name.kind != "msg" and struct.endswith(wrapper):
            begin = calls_name(layout.name._replace(name=layout.name.name.removesuffix(wrapper)))
            yield from (ClaimedName("name", begin + call, is_derived=True) for call in calls)
    yield ClaimedName("file", header(layout.name, package))
    yield ClaimedName("file", ends_header(layout.name, package), is_derived=True)


_PUBLISHER = ("", "_open", "_start", "_send", "_publish", "_try_publish", "_close")
_SUBSCRIBER = ("", "_open", "_start", "_read", "_try_read", "_read_next", "_wait", "_close")
_ENDS = (
    *(f"_publisher{call}" for call in _PUBLISHER),
    *(f"_subscriber{call}" for call in _SUBSCRIBER),
)
"""The suffixes that publishers, subscribers and their functions append to the structure's name."""
_EACH = ("", "_open", "_start", "_close")
_CLIENT = tuple(f"_client{call}" for call in (*_EACH, "_send", "_poll", "_wait"))
_SERVER = tuple(f"_server{call}" for call in (*_EACH, "_take"))
_CALLS = {
    "_Reply": (*_CLIENT, "_client_call", *_SERVER, "_server_reply", "_server_fail"),
    "_Outcome": (
        *(*_CLIENT, "_client_send_goal", "_client_progress", "_client_cancel", *_SERVER),
        *(f"_server{call}" for call in ("_is_cancel_requested", "_accept", "_feedback", "_end")),
    ),
}
"""The suffixes for services and actions, by the message that shmgen adds to each (`_Reply`, `_Outcome`)."""


C_RESERVED = words("""
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
"""Names that C and C++ code cannot use for fields.

The last rows are macros of gcc, of C's own headers and of POSIX. gcc defines `linux` as 1, except under -std=c11.
"""

NAMES = Names("C", member=c_member, constant=str, claims=_claims, constants_apart=True)
