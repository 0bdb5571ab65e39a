// The types of IEC 61131-3 with the widths of CODESYS, and their operators, for translated Structured Text.
// A conversion that causes a warning or an error in CODESYS does not compile here.
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

// A separate type, because NOT of a BOOL differs from NOT of a BYTE.
struct BOOL {
    uint8_t byte = 0;
    BOOL() = default;
    explicit constexpr BOOL(bool value) : byte(value) {}
    explicit constexpr operator bool() const { return byte != 0; }
};
struct TIME { uint32_t ms = 0; };
struct LTIME { uint64_t ns = 0; };

// Thrown if a PLC would stop, because of an index outside its bounds, a null pointer, or a division by zero.
struct Trap { const char *reason; };

// The value of an untyped literal, from the smallest LINT to the largest ULINT. No 64-bit type can represent both, and
// compilers for 32-bit machines have no 128-bit type.
struct Literal {
    bool is_negative;
    uint64_t magnitude;
    template <class T> constexpr bool fits() const {
        return magnitude <= static_cast<uint64_t>(std::numeric_limits<T>::max()) + is_negative && (std::is_signed_v<T> || !is_negative);
    }
    template <class T> constexpr T as() const {
        if constexpr (std::is_floating_point_v<T>) return is_negative ? -static_cast<T>(magnitude) : static_cast<T>(magnitude);
        else return static_cast<T>(is_negative ? 0 - magnitude : magnitude);
    }
    constexpr uint64_t bits() const { return is_negative ? throw Trap{"bits of a negative literal"} : magnitude; }
    constexpr Literal operator-() const { return {!is_negative && magnitude != 0, magnitude}; }
};
constexpr Literal operator+(Literal a, Literal b) {
    if (a.is_negative != b.is_negative)
        return a.magnitude > b.magnitude ? Literal{a.is_negative, a.magnitude - b.magnitude}
                                         : Literal{b.is_negative && a.magnitude != b.magnitude, b.magnitude - a.magnitude};
    if (a.magnitude + b.magnitude < a.magnitude) throw Trap{"literals beyond 64 bits"};
    return {a.is_negative, a.magnitude + b.magnitude};
}
constexpr Literal operator*(Literal a, Literal b) {
    if (b.magnitude != 0 && a.magnitude > UINT64_MAX / b.magnitude) throw Trap{"literals beyond 64 bits"};
    return {a.is_negative != b.is_negative && a.magnitude * b.magnitude != 0, a.magnitude * b.magnitude};
}
constexpr Literal operator/(Literal a, Literal b) {
    return {a.is_negative != b.is_negative && a.magnitude >= b.magnitude, a.magnitude / b.magnitude};
}
constexpr Literal operator%(Literal a, Literal b) {
    return {a.is_negative && a.magnitude % b.magnitude != 0, a.magnitude % b.magnitude};
}
constexpr bool operator<(Literal a, Literal b) { return (b + -a).magnitude != 0 && !(b + -a).is_negative; }

// An untyped literal takes the type of the other operand or of the target, and must fit into this type.
template <uint64_t Magnitude, bool IsNegative = false> struct Integer {
    static constexpr Literal value{IsNegative, Magnitude};
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
template <uint64_t Magnitude, bool IsNegative> struct literal<Integer<Magnitude, IsNegative>> : std::true_type {};
template <class T> inline constexpr bool is_literal = literal<T>::value;
template <class T> struct pointer : std::false_type {};
template <class T> struct pointer<Pointer<T>> : std::true_type {};
template <class T> inline constexpr bool is_pointer = pointer<T>::value;
template <class> inline constexpr bool never = false;

template <class To, class From> constexpr bool can_widen() {
    if constexpr (std::is_same_v<To, From>) return true;
    else if constexpr (std::is_floating_point_v<To>)
        return std::is_floating_point_v<From> ? sizeof(To) >= sizeof(From) : sizeof(From) < sizeof(To);
    else if constexpr (std::is_floating_point_v<From>) return false;
    else if constexpr (std::is_signed_v<To> == std::is_signed_v<From>) return sizeof(To) >= sizeof(From);
    else return std::is_signed_v<To> && sizeof(To) > sizeof(From);
}

// Convert a number to T. Does not compile if the conversion could change the value.
template <class T, class From> constexpr T as(From from) {
    if constexpr (is_literal<From>) {
        if constexpr (is_integer<T>)
            static_assert(From::value.template fits<T>(), "the literal does not fit the type");
        return From::value.template as<T>();
    } else if constexpr (std::is_same_v<From, Real>) {
        static_assert(std::is_floating_point_v<T>, "a REAL literal is not an integer");
        return static_cast<T>(from.value);
    } else {
        static_assert(is_number<From> && can_widen<T, From>(), "no implicit conversion: the value could change");
        return static_cast<T>(from);
    }
}

// Return a value of the type of an operation with operands of the types A and B.
template <class A, class B> constexpr auto common() {
    if constexpr (is_literal<A> || std::is_same_v<A, Real>) {
        if constexpr (is_number<B>) return B{};
        else return double{};  // Real with Real or Integer
    } else if constexpr (is_literal<B> || std::is_same_v<B, Real>) return A{};
    else if constexpr (can_widen<A, B>()) return A{};
    else {
        static_assert(can_widen<B, A>(), "the operands have no common type: signed and unsigned, or integer and REAL");
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
        static_assert(R::value.magnitude == 0, "0 is the only number that can be assigned to a pointer");
        left.to = nullptr;
    } else static_assert(never<L>, "no conversion between these types");
}

// Truncate the text if it is too long. Characters after the terminating 0 keep their values, as in CODESYS.
template <int N, int M, class C> void set(Text<N, C> &left, const Text<M, C> &right) {
    int index = 0;
    for (; index < N && index < M && right.units[index] != 0; ++index) left.units[index] = right.units[index];
    left.units[index] = 0;
}

template <class T, class R> T initial(const R &value) {
    T result{};
    set(result, value);
    return result;
}

template <class T, class... R> T initial_array(const R &...values) {
    static_assert(sizeof...(values) <= sizeof(T::items) / sizeof(T::items[0]), "more initial values than elements");
    T result{};
    long index = 0;
    (set(result.items[index++], values), ...);
    return result;
}

template <int N, class C> constexpr Text<N - 1, C> text(const C (&units)[N]) {
    Text<N - 1, C> result{};
    for (int index = 0; index < N; ++index) result.units[index] = units[index];
    return result;
}

// --- operators ------------------------------------------------------------------------------------------

// Integers are calculated in 64 bits and truncated to T, so that they wrap around at their declared width.
using Wide = uint64_t;

struct Add {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a + b;
        else return static_cast<T>(static_cast<Wide>(a) + static_cast<Wide>(b));
    }
    static constexpr Literal of(Literal a, Literal b) { return a + b; }
};
struct Subtract {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a - b;
        else return static_cast<T>(static_cast<Wide>(a) - static_cast<Wide>(b));
    }
    static constexpr Literal of(Literal a, Literal b) { return a + -b; }
};
struct Multiply {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a * b;
        else return static_cast<T>(static_cast<Wide>(a) * static_cast<Wide>(b));
    }
    static constexpr Literal of(Literal a, Literal b) { return a * b; }
};
struct Divide {
    template <class T> static constexpr T of(T a, T b) {
        if constexpr (std::is_floating_point_v<T>) return a / b;
        else {
            if (b == 0) throw Trap{"a division by zero"};
            if (b == static_cast<T>(-1) && std::is_signed_v<T>) return Subtract::of(T{}, a);  // the minimum wraps around
            return static_cast<T>(a / b);
        }
    }
    static constexpr Literal of(Literal a, Literal b) { return b.magnitude == 0 ? throw Trap{"a division by zero"} : a / b; }
};
struct Modulo {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(!std::is_floating_point_v<T>, "MOD requires integers");
        if (b == 0) throw Trap{"a division by zero"};
        if (b == static_cast<T>(-1) && std::is_signed_v<T>) return T{};
        return static_cast<T>(a % b);
    }
    static constexpr Literal of(Literal a, Literal b) { return b.magnitude == 0 ? throw Trap{"a division by zero"} : a % b; }
};

struct And {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(is_integer<T>, "AND requires BOOL or integers");
        return static_cast<T>(a & b);
    }
    static constexpr Literal of(Literal a, Literal b) { return {false, a.bits() & b.bits()}; }
};
struct Or {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(is_integer<T>, "OR requires BOOL or integers");
        return static_cast<T>(a | b);
    }
    static constexpr Literal of(Literal a, Literal b) { return {false, a.bits() | b.bits()}; }
};
struct Xor {
    template <class T> static constexpr T of(T a, T b) {
        static_assert(is_integer<T>, "XOR requires BOOL or integers");
        return static_cast<T>(a ^ b);
    }
    static constexpr Literal of(Literal a, Literal b) { return {false, a.bits() ^ b.bits()}; }
};

template <class Operation, class A, class B> constexpr auto apply(A a, B b) {
    if constexpr (is_literal<A> && is_literal<B>) {
        constexpr Literal result = Operation::of(A::value, B::value);
        return Integer<result.magnitude, result.is_negative>{};
    } else {
        using T = common_t<A, B>;
        return Operation::of(as<T>(a), as<T>(b));
    }
}
template <class A, class B> constexpr auto multiply(A a, B b) { return apply<Multiply>(a, b); }
template <class A, class B> constexpr auto divide(A a, B b) { return apply<Divide>(a, b); }
template <class A, class B> constexpr auto modulo(A a, B b) { return apply<Modulo>(a, b); }

// Pointer arithmetic counts bytes, as in CODESYS.
template <class T> Pointer<T> move_pointer(Pointer<T> pointer, intptr_t bytes) {
    return {reinterpret_cast<T *>(reinterpret_cast<uintptr_t>(pointer.to) + bytes)};
}
template <class B> constexpr intptr_t bytes(B b) {
    if constexpr (is_literal<B>) return as<intptr_t>(b);
    else {
        static_assert(is_integer<B>, "an offset of a pointer must be an integer");
        return static_cast<intptr_t>(b);
    }
}
template <class A, class B> constexpr auto add(A a, B b) {
    if constexpr (is_pointer<A>) return move_pointer(a, bytes(b));
    else if constexpr (std::is_same_v<A, TIME> && std::is_same_v<B, TIME>) return TIME{a.ms + b.ms};
    else return apply<Add>(a, b);
}
template <class A, class B> constexpr auto subtract(A a, B b) {
    if constexpr (is_pointer<A>) return move_pointer(a, -bytes(b));
    else if constexpr (std::is_same_v<A, TIME> && std::is_same_v<B, TIME>) return TIME{a.ms - b.ms};
    else return apply<Subtract>(a, b);
}
template <class A> constexpr auto negative(A a) {
    if constexpr (is_literal<A>) return Integer<A::value.magnitude, (-A::value).is_negative>{};
    else if constexpr (std::is_same_v<A, Real>) return Real{-a.value};
    else {
        static_assert(std::is_signed_v<A>, "an unsigned number cannot be negated");
        return Subtract::of(A{}, a);
    }
}

// Both operands are evaluated, as in CODESYS, which skips the second operand only of AND_THEN and OR_ELSE.
inline BOOL both(BOOL a, BOOL b) { return BOOL((a.byte != 0) & (b.byte != 0)); }
inline BOOL either(BOOL a, BOOL b) { return BOOL((a.byte != 0) | (b.byte != 0)); }
inline BOOL differ(BOOL a, BOOL b) { return BOOL((a.byte != 0) ^ (b.byte != 0)); }
inline BOOL inverse(BOOL a) { return BOOL(a.byte == 0); }
template <class A, class B> constexpr auto both(A a, B b) { return apply<And>(a, b); }
template <class A, class B> constexpr auto either(A a, B b) { return apply<Or>(a, b); }
template <class A, class B> constexpr auto differ(A a, B b) { return apply<Xor>(a, b); }
template <class A> constexpr A inverse(A a) {
    static_assert(is_integer<A>, "NOT requires BOOL or integers");
    return static_cast<A>(~a);
}

// Return -1, 0 or 1 for the order of two operands. Return 2 if an operand is NaN, and 0 or 1 for pointers, which have no
// order. Operands are passed by value and read once, because shared memory may change between two reads.
template <class T> constexpr int order(T a, T b) { return a != a || b != b ? 2 : (a > b) - (a < b); }
template <class A, class B> constexpr int compare(const A &a, const B &b) {
    if constexpr (is_pointer<A>) {
        if constexpr (is_literal<B>) {
            static_assert(B::value.magnitude == 0, "0 is the only number that can be compared with a pointer");
            return a.to != nullptr;
        } else return static_cast<const void *>(a.to) != static_cast<const void *>(b.to);
    } else if constexpr (std::is_same_v<A, BOOL> && std::is_same_v<B, BOOL>) return (a.byte != 0) - (b.byte != 0);
    else if constexpr (std::is_same_v<A, TIME> && std::is_same_v<B, TIME>) return order(a.ms, b.ms);
    else if constexpr (std::is_same_v<A, LTIME> && std::is_same_v<B, LTIME>) return order(a.ns, b.ns);
    else if constexpr (std::is_enum_v<A> || std::is_enum_v<B>) {
        static_assert(std::is_same_v<A, B>, "a strict enumeration can only be compared with its own values");
        return order<A>(a, b);
    } else if constexpr (is_literal<A> && is_literal<B>) return (B::value < A::value) - (A::value < B::value);
    else return order<common_t<A, B>>(as<common_t<A, B>>(a), as<common_t<A, B>>(b));
}
template <int N, int M, class C> constexpr int compare(const Text<N, C> &a, const Text<M, C> &b) {
    int index = 0;
    while (a.units[index] == b.units[index] && a.units[index] != 0) ++index;
    return (a.units[index] > b.units[index]) - (a.units[index] < b.units[index]);
}
template <class A, class B> BOOL equal(const A &a, const B &b) { return BOOL(compare(a, b) == 0); }
template <class A, class B> BOOL unequal(const A &a, const B &b) { return BOOL(compare(a, b) != 0); }
template <class A, class B> BOOL less(const A &a, const B &b) {
    static_assert(!is_pointer<A>, "pointers have no order");
    return BOOL(compare(a, b) < 0);
}
template <class A, class B> BOOL greater(const A &a, const B &b) { return less(b, a); }
template <class A, class B> BOOL at_most(const A &a, const B &b) {
    static_assert(!is_pointer<A>, "pointers have no order");
    const int order_of_operands = compare(a, b);
    return BOOL(order_of_operands == -1 || order_of_operands == 0);
}
template <class A, class B> BOOL at_least(const A &a, const B &b) { return at_most(b, a); }

// A condition must be a BOOL.
inline bool truth(BOOL value) { return value.byte != 0; }
template <class T> bool truth(T) = delete;

// --- access ---------------------------------------------------------------------------------------------

template <class I> constexpr int64_t index_of(I index) {
    if constexpr (is_literal<I>) return as<int64_t>(index);
    else {
        static_assert(is_integer<I>, "an index must be an integer");
        if (!std::is_signed_v<I> && static_cast<uint64_t>(index) > INT64_MAX) throw Trap{"an index outside the bounds"};
        return static_cast<int64_t>(index);
    }
}
template <int64_t First, int64_t Last, class T, class I> T &element(Array<First, Last, T> &array, I index) {
    const int64_t number = index_of(index);
    if (number < First || number > Last) throw Trap{"an index outside the bounds"};
    return array.items[number - First];
}
template <int64_t First, int64_t Last, class T, class I> const T &element(const Array<First, Last, T> &array, I index) {
    return element(const_cast<Array<First, Last, T> &>(array), index);
}
// An index of a pointer, as in p[i], counts elements.
template <class T, class I> T &element(Pointer<T> pointer, I index) {
    return *move_pointer(pointer, static_cast<intptr_t>(index_of(index)) * static_cast<intptr_t>(sizeof(T)));
}

// --- functions ------------------------------------------------------------------------------------------

template <class T> Pointer<T> ADR(T &variable) { return {&variable}; }

// The explicit conversion X_TO_Y may truncate the value. A REAL is rounded to the nearest integer, and halves away from zero.
template <class To, class From> To convert(From from) {
    if constexpr (std::is_same_v<From, TIME>) return convert<To>(from.ms);
    else if constexpr (std::is_same_v<From, LTIME>) return convert<To>(from.ns);
    else if constexpr (std::is_same_v<From, BOOL>) return convert<To>(static_cast<uint8_t>(from.byte != 0));
    else if constexpr (std::is_same_v<To, TIME>) return TIME{convert<uint32_t>(from)};
    else if constexpr (std::is_same_v<To, LTIME>) return LTIME{convert<uint64_t>(from)};
    else if constexpr (std::is_same_v<To, BOOL>) return BOOL(from != 0);
    else if constexpr (is_integer<To> && std::is_floating_point_v<From>) return static_cast<To>(std::llround(from));
    else return static_cast<To>(from);
}

template <class From, class T> From as_argument(T value) {
    if constexpr (std::is_same_v<From, T>) return value;
    else return as<From>(value);
}

inline TIME IEC_TIME() { return {shim_now()}; }

// The system libraries with the documented types. The ADR of a UDINT is therefore not accepted as `POINTER TO __UXINT`.
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

// --- tables for Python ----------------------------------------------------------------------------------

struct Member {
    const char *owner, *name;
    uint64_t offset, size;
};
struct Kind {  // a structure, a block, the parameters of a method, or a variable list
    const char *name;
    uint64_t size;
    void (*make)(void *);
    void *global;
};
struct Entry {  // a method, or a block's body if `method` is empty
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
