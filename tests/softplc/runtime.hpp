// What the translated Structured Text stands on: the types of IEC 61131-3 with the widths of CODESYS, and its
// operators. Whatever CODESYS would convert with a warning or not at all does not compile here.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <new>
#include <type_traits>

#include "shim.h"

// --- types ----------------------------------------------------------------------------------------------

using BYTE = uint8_t;
using WORD = uint16_t;
using DWORD = uint32_t;
using LWORD = uint64_t;
using SINT = int8_t;
using INT = int16_t;
using DINT = int32_t;
using LINT = int64_t;
using USINT = uint8_t;
using UINT = uint16_t;
using UDINT = uint32_t;
using ULINT = uint64_t;
using REAL = float;
using LREAL = double;

// A type of its own, because NOT of it is another thing than NOT of a BYTE.
struct BOOL {
    uint8_t byte = 0;
    BOOL() = default;
    explicit constexpr BOOL(bool value) : byte(value) {}
    explicit constexpr operator bool() const { return byte != 0; }
};
struct TIME { uint32_t ms = 0; };
struct LTIME { uint64_t ns = 0; };

// Thrown instead of what stops a PLC: an index outside its bounds, a null pointer, a division by zero.
struct Trap { const char *reason; };

// What an untyped literal may be, from the least LINT to the largest ULINT: no type of 64 bits holds both, and
// compilers for 32-bit machines have none of 128.
struct Whole {
    bool below;  // zero
    uint64_t size;
    template <class T> constexpr bool fits() const {
        return size <= static_cast<uint64_t>(std::numeric_limits<T>::max()) + below && (std::is_signed_v<T> || !below);
    }
    template <class T> constexpr T as() const {
        if constexpr (std::is_floating_point_v<T>) return below ? -static_cast<T>(size) : static_cast<T>(size);
        else return static_cast<T>(below ? 0 - size : size);
    }
    constexpr uint64_t bits() const { return below ? throw Trap{"bits of a negative literal"} : size; }
    constexpr Whole operator-() const { return {!below && size != 0, size}; }
};
constexpr Whole operator+(Whole a, Whole b) {
    if (a.below != b.below)
        return a.size > b.size ? Whole{a.below, a.size - b.size} : Whole{b.below && a.size != b.size, b.size - a.size};
    return a.size + b.size < a.size ? throw Trap{"literals beyond 64 bits"} : Whole{a.below, a.size + b.size};
}
constexpr Whole operator*(Whole a, Whole b) {
    if (b.size != 0 && a.size > UINT64_MAX / b.size) throw Trap{"literals beyond 64 bits"};
    return {a.below != b.below && a.size * b.size != 0, a.size * b.size};
}
constexpr Whole operator/(Whole a, Whole b) { return {a.below != b.below && a.size >= b.size, a.size / b.size}; }
constexpr Whole operator%(Whole a, Whole b) { return {a.below && a.size % b.size != 0, a.size % b.size}; }
constexpr bool operator<(Whole a, Whole b) { return (b + -a).size != 0 && !(b + -a).below; }

// An untyped literal takes the type of what it meets, and must fit it.
template <uint64_t Size, bool Below = false> struct Integer {
    static constexpr Whole value{Below, Size};
};
struct Real { double value; };

template <int N, class C> struct Text {
    C units[N + 1] = {};
};
template <int N> using STRING = Text<N, char>;
template <int N> using WSTRING = Text<N, char16_t>;

template <class T> struct Pointer {
    T *to = nullptr;
    T &operator*() const {
        if (to == nullptr) throw Trap{"a null pointer"};
        return *to;
    }
};

template <int64_t First, int64_t Last, class T> struct Array {
    T items[Last - First + 1] = {};
};

// --- conversions ----------------------------------------------------------------------------------------

template <class T> inline constexpr bool is_integer = std::is_integral_v<T> && !std::is_same_v<T, char16_t>;
template <class T> inline constexpr bool is_number = is_integer<T> || std::is_floating_point_v<T>;
template <class T> struct literal : std::false_type {};
template <uint64_t Size, bool Below> struct literal<Integer<Size, Below>> : std::true_type {};
template <class T> inline constexpr bool is_literal = literal<T>::value;
template <class T> struct pointer : std::false_type {};
template <class T> struct pointer<Pointer<T>> : std::true_type {};
template <class T> inline constexpr bool is_pointer = pointer<T>::value;
template <class> inline constexpr bool never = false;

template <class To, class From> constexpr bool widens() {
    if constexpr (std::is_same_v<To, From>) return true;
    else if constexpr (std::is_floating_point_v<To>)
        return std::is_floating_point_v<From> ? sizeof(To) >= sizeof(From) : sizeof(From) < sizeof(To);
    else if constexpr (std::is_floating_point_v<From>) return false;
    else if constexpr (std::is_signed_v<To> == std::is_signed_v<From>) return sizeof(To) >= sizeof(From);
    else return std::is_signed_v<To> && sizeof(To) > sizeof(From);
}

// A number as a T.
template <class T, class From> constexpr T as(From from) {
    if constexpr (is_literal<From>) {
        if constexpr (is_integer<T>)
            static_assert(From::value.template fits<T>(), "the literal does not fit the type");
        return From::value.template as<T>();
    } else if constexpr (std::is_same_v<From, Real>) {
        static_assert(std::is_floating_point_v<T>, "a REAL literal is no integer");
        return static_cast<T>(from.value);
    } else {
        static_assert(is_number<From> && widens<T, From>(), "no implicit conversion: the value could change");
        return static_cast<T>(from);
    }
}

// The type of A and B together.
template <class A, class B> constexpr auto common() {
    if constexpr (is_literal<A> || std::is_same_v<A, Real>) {
        if constexpr (is_number<B>) return B{};
        else return double{};  // Real with Real or Integer
    } else if constexpr (is_literal<B> || std::is_same_v<B, Real>) return A{};
    else if constexpr (widens<A, B>()) return A{};
    else {
        static_assert(widens<B, A>(), "the operands have no common type: signed and unsigned, or integer and REAL");
        return B{};
    }
}
template <class A, class B> using common_t = decltype(common<A, B>());

// --- assignment -----------------------------------------------------------------------------------------

template <class L, class R> void set(L &left, const R &right) {
    if constexpr (std::is_same_v<L, R>) left = right;
    else if constexpr (is_number<L>) left = as<L>(right);
    else if constexpr (is_pointer<L> && is_pointer<R>) left.to = reinterpret_cast<decltype(left.to)>(right.to);
    else if constexpr (is_pointer<L> && is_literal<R>) {
        static_assert(R::value.size == 0, "a pointer takes no number but 0");
        left.to = nullptr;
    } else static_assert(never<L>, "no conversion between these types");
}

// What does not fit is cut off. What stands behind the terminating 0 stays as it was, as in CODESYS.
template <int N, int M, class C> void set(Text<N, C> &left, const Text<M, C> &right) {
    int at = 0;
    for (; at < N && at < M && right.units[at] != 0; ++at) left.units[at] = right.units[at];
    left.units[at] = 0;
}

template <class T, class R> T initial(const R &value) {
    T made{};
    set(made, value);
    return made;
}

template <class T, class... R> T initial_array(const R &...values) {
    static_assert(sizeof...(values) <= sizeof(T::items) / sizeof(T::items[0]), "more initial values than elements");
    T made{};
    long at = 0;
    (set(made.items[at++], values), ...);
    return made;
}

template <int N, class C> constexpr Text<N - 1, C> text(const C (&units)[N]) {
    Text<N - 1, C> made{};
    for (int at = 0; at < N; ++at) made.units[at] = units[at];
    return made;
}

// --- operators ------------------------------------------------------------------------------------------

// Two's complement in 64 bits, then cut to the width of T: it wraps round in the declared width.
using Wide = uint64_t;

struct Add {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a + b;
        else return static_cast<T>(static_cast<Wide>(a) + static_cast<Wide>(b));
    }
    static constexpr Whole of(Whole a, Whole b) { return a + b; }
};
struct Subtract {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a - b;
        else return static_cast<T>(static_cast<Wide>(a) - static_cast<Wide>(b));
    }
    static constexpr Whole of(Whole a, Whole b) { return a + -b; }
};
struct Multiply {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a * b;
        else return static_cast<T>(static_cast<Wide>(a) * static_cast<Wide>(b));
    }
    static constexpr Whole of(Whole a, Whole b) { return a * b; }
};
struct Divide {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a / b;
        else {
            if (b == 0) throw Trap{"a division by zero"};
            if (b == static_cast<T>(-1) && std::is_signed_v<T>) return Subtract::of(T{}, a);  // the least wraps
            return static_cast<T>(a / b);
        }
    }
    static constexpr Whole of(Whole a, Whole b) { return b.size == 0 ? throw Trap{"a division by zero"} : a / b; }
};
struct Modulo {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(!std::is_floating_point_v<T>, "MOD is for integers");
        if (b == 0) throw Trap{"a division by zero"};
        if (b == static_cast<T>(-1) && std::is_signed_v<T>) return T{};
        return static_cast<T>(a % b);
    }
    static constexpr Whole of(Whole a, Whole b) { return b.size == 0 ? throw Trap{"a division by zero"} : a % b; }
};

struct And {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(is_integer<T>, "AND is for BOOL and integers");
        return static_cast<T>(a & b);
    }
    static constexpr Whole of(Whole a, Whole b) { return {false, a.bits() & b.bits()}; }
};
struct Or {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(is_integer<T>, "OR is for BOOL and integers");
        return static_cast<T>(a | b);
    }
    static constexpr Whole of(Whole a, Whole b) { return {false, a.bits() | b.bits()}; }
};
struct Xor {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(is_integer<T>, "XOR is for BOOL and integers");
        return static_cast<T>(a ^ b);
    }
    static constexpr Whole of(Whole a, Whole b) { return {false, a.bits() ^ b.bits()}; }
};

template <class Operation, class A, class B> constexpr auto combined(A a, B b) {
    if constexpr (is_literal<A> && is_literal<B>) {
        constexpr Whole made = Operation::of(A::value, B::value);
        return Integer<made.size, made.below>{};
    } else {
        using T = common_t<A, B>;
        return Operation::of(as<T>(a), as<T>(b));
    }
}
template <class A, class B> constexpr auto multiply(A a, B b) { return combined<Multiply>(a, b); }
template <class A, class B> constexpr auto divide(A a, B b) { return combined<Divide>(a, b); }
template <class A, class B> constexpr auto modulo(A a, B b) { return combined<Modulo>(a, b); }

// A pointer counts in bytes.
template <class T> Pointer<T> moved(Pointer<T> pointer, intptr_t bytes) {
    return {reinterpret_cast<T *>(reinterpret_cast<uintptr_t>(pointer.to) + bytes)};
}
template <class B> constexpr intptr_t bytes(B b) {
    if constexpr (is_literal<B>) return as<intptr_t>(b);
    else {
        static_assert(is_integer<B>, "a pointer moves by an integer");
        return static_cast<intptr_t>(b);
    }
}
template <class A, class B> constexpr auto add(A a, B b) {
    if constexpr (is_pointer<A>) return moved(a, bytes(b));
    else if constexpr (std::is_same_v<A, TIME> && std::is_same_v<B, TIME>) return TIME{a.ms + b.ms};
    else return combined<Add>(a, b);
}
template <class A, class B> constexpr auto subtract(A a, B b) {
    if constexpr (is_pointer<A>) return moved(a, -bytes(b));
    else if constexpr (std::is_same_v<A, TIME> && std::is_same_v<B, TIME>) return TIME{a.ms - b.ms};
    else return combined<Subtract>(a, b);
}
template <class A> constexpr auto negative(A a) {
    if constexpr (is_literal<A>) return Integer<A::value.size, (-A::value).below>{};
    else if constexpr (std::is_same_v<A, Real>) return Real{-a.value};
    else {
        static_assert(std::is_signed_v<A>, "the negative of an unsigned number");
        return Subtract::of(A{}, a);
    }
}

// Both sides are evaluated, as in CODESYS, where only AND_THEN and OR_ELSE stop early.
inline BOOL both(BOOL a, BOOL b) { return BOOL((a.byte != 0) & (b.byte != 0)); }
inline BOOL either(BOOL a, BOOL b) { return BOOL((a.byte != 0) | (b.byte != 0)); }
inline BOOL differ(BOOL a, BOOL b) { return BOOL((a.byte != 0) ^ (b.byte != 0)); }
inline BOOL inverse(BOOL a) { return BOOL(a.byte == 0); }
template <class A, class B> constexpr auto both(A a, B b) { return combined<And>(a, b); }
template <class A, class B> constexpr auto either(A a, B b) { return combined<Or>(a, b); }
template <class A, class B> constexpr auto differ(A a, B b) { return combined<Xor>(a, b); }
template <class A> constexpr A inverse(A a) {
    static_assert(is_integer<A>, "NOT is for BOOL and integers");
    return static_cast<A>(~a);
}

// -1, 0 or 1; for what has no order 0 or 1, and 2 where one is not a number. Operands are looked at once, by value:
// shared memory may be another between two looks.
template <class T> constexpr int order(T a, T b) { return a != a || b != b ? 2 : (a > b) - (a < b); }
template <class A, class B> constexpr int compared(const A &a, const B &b) {
    if constexpr (is_pointer<A>) {
        if constexpr (is_literal<B>) {
            static_assert(B::value.size == 0, "a pointer is compared with no number but 0");
            return a.to != nullptr;
        } else return static_cast<const void *>(a.to) != static_cast<const void *>(b.to);
    } else if constexpr (std::is_same_v<A, BOOL> && std::is_same_v<B, BOOL>) return (a.byte != 0) - (b.byte != 0);
    else if constexpr (std::is_same_v<A, TIME> && std::is_same_v<B, TIME>) return order(a.ms, b.ms);
    else if constexpr (std::is_same_v<A, LTIME> && std::is_same_v<B, LTIME>) return order(a.ns, b.ns);
    else if constexpr (std::is_enum_v<A> || std::is_enum_v<B>) {
        static_assert(std::is_same_v<A, B>, "a strict enumeration is compared with its own values only");
        return order<A>(a, b);
    } else if constexpr (is_literal<A> && is_literal<B>) return (B::value < A::value) - (A::value < B::value);
    else return order<common_t<A, B>>(as<common_t<A, B>>(a), as<common_t<A, B>>(b));
}
template <int N, int M, class C> constexpr int compared(const Text<N, C> &a, const Text<M, C> &b) {
    int at = 0;
    while (a.units[at] == b.units[at] && a.units[at] != 0) ++at;
    return (a.units[at] > b.units[at]) - (a.units[at] < b.units[at]);
}
template <class A, class B> BOOL equal(const A &a, const B &b) { return BOOL(compared(a, b) == 0); }
template <class A, class B> BOOL unequal(const A &a, const B &b) { return BOOL(compared(a, b) != 0); }
template <class A, class B> BOOL less(const A &a, const B &b) {
    static_assert(!is_pointer<A>, "pointers have no order");
    return BOOL(compared(a, b) < 0);
}
template <class A, class B> BOOL greater(const A &a, const B &b) { return less(b, a); }
template <class A, class B> BOOL at_most(const A &a, const B &b) {
    static_assert(!is_pointer<A>, "pointers have no order");
    const int found = compared(a, b);
    return BOOL(found == -1 || found == 0);
}
template <class A, class B> BOOL at_least(const A &a, const B &b) { return at_most(b, a); }

// A condition is a BOOL and nothing else.
inline bool truth(BOOL value) { return value.byte != 0; }
template <class T> bool truth(T) = delete;

// --- access ---------------------------------------------------------------------------------------------

template <class I> constexpr int64_t index_of(I index) {
    if constexpr (is_literal<I>) return as<int64_t>(index);
    else {
        static_assert(is_integer<I>, "an index is an integer");
        if (!std::is_signed_v<I> && static_cast<uint64_t>(index) > INT64_MAX) throw Trap{"an index outside the bounds"};
        return static_cast<int64_t>(index);
    }
}
template <int64_t First, int64_t Last, class T, class I> T &element(Array<First, Last, T> &array, I index) {
    const int64_t at = index_of(index);
    if (at < First || at > Last) throw Trap{"an index outside the bounds"};
    return array.items[at - First];
}
template <int64_t First, int64_t Last, class T, class I> const T &element(const Array<First, Last, T> &array, I index) {
    return element(const_cast<Array<First, Last, T> &>(array), index);
}
// p[i] counts in elements.
template <class T, class I> T &element(Pointer<T> pointer, I index) {
    return *moved(pointer, static_cast<intptr_t>(index_of(index)) * static_cast<intptr_t>(sizeof(T)));
}

// --- functions ------------------------------------------------------------------------------------------

template <class T> Pointer<T> ADR(T &variable) { return {&variable}; }

// X_TO_Y: explicit, so it may cut off; a REAL is rounded to the nearest, a half away from zero.
template <class To, class From> To converted(From from) {
    if constexpr (std::is_same_v<From, TIME>) return converted<To>(from.ms);
    else if constexpr (std::is_same_v<From, LTIME>) return converted<To>(from.ns);
    else if constexpr (std::is_same_v<From, BOOL>) return converted<To>(static_cast<uint8_t>(from.byte != 0));
    else if constexpr (std::is_same_v<To, TIME>) return TIME{converted<uint32_t>(from)};
    else if constexpr (std::is_same_v<To, LTIME>) return LTIME{converted<uint64_t>(from)};
    else if constexpr (std::is_same_v<To, BOOL>) return BOOL(from != 0);
    else if constexpr (is_integer<To> && std::is_floating_point_v<From>) return static_cast<To>(std::llround(from));
    else return static_cast<To>(from);
}

template <class From, class T> From as_given(T value) {
    if constexpr (std::is_same_v<From, T>) return value;
    else return as<From>(value);
}

inline TIME IEC_TIME() { return {shim_now()}; }

// The system libraries; the types are those of the documents, so that ADR of a UDINT is no `POINTER TO __UXINT`.
using RTS_IEC_HANDLE = LWORD;
using RTS_IEC_RESULT = UDINT;

template <int N, class P> RTS_IEC_HANDLE SYSSHAREDMEMORYOPEN2(const STRING<N> &name, P address, Pointer<ULINT> size, Pointer<UDINT> result) {
    return shim_shm_open(name.units, as<ULINT>(address), &*size, &*result);
}
template <int N, class P> RTS_IEC_HANDLE SYSSHAREDMEMORYCREATE(const STRING<N> &name, P address, Pointer<ULINT> size, Pointer<UDINT> result) {
    return shim_shm_create(name.units, as<ULINT>(address), &*size, &*result);
}
inline Pointer<BYTE> SYSSHAREDMEMORYGETPOINTER(RTS_IEC_HANDLE handle, Pointer<UDINT> result) {
    return {static_cast<BYTE *>(shim_shm_pointer(handle, &*result))};
}
inline RTS_IEC_RESULT SYSSHAREDMEMORYCLOSE(RTS_IEC_HANDLE handle) { return shim_shm_close(handle); }
template <int N> RTS_IEC_HANDLE SYSSEMPROCESSCREATE(const STRING<N> &name, Pointer<UDINT> result) {
    return shim_sem_create(name.units, &*result);
}
template <class T> RTS_IEC_RESULT SYSSEMPROCESSENTER(RTS_IEC_HANDLE handle, T timeout) {
    return shim_sem_enter(handle, as<UDINT>(timeout));
}
inline RTS_IEC_RESULT SYSSEMPROCESSLEAVE(RTS_IEC_HANDLE handle) { return shim_sem_leave(handle); }
inline RTS_IEC_RESULT SYSSEMPROCESSDELETE(RTS_IEC_HANDLE handle) { return shim_sem_delete(handle); }

// --- what Python sees -----------------------------------------------------------------------------------

struct Member {
    const char *owner, *name;
    uint64_t offset, size;
};
struct Kind {  // a structure, a block, a method's parameters, a list
    const char *name;
    uint64_t size;
    void (*make)(void *);
    void *global;
};
struct Entry {  // a block's body, where method is empty, or a method
    const char *block, *method;
    const char *(*call)(void *self, void *parameters);
};
template <class T> void make(void *where) { new (where) T(); }
template <class F> const char *guarded(F call) {
    try {
        call();
        return nullptr;
    } catch (const Trap &trap) {
        return trap.reason;
    }
}
