// What messages are made of in C++: texts, sequences, truth and time, each with the bytes it has in the region.
//
// Made by shmgen; changes made here are lost.
//
// A value that does not fit is not lost in silence, and throws nothing: the field remembers it, and publish() refuses
// the message with the field's path.
#ifndef SHMGEN_VALUES_HPP
#define SHMGEN_VALUES_HPP

#include "shmgen_runtime.h"

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <iterator>
#include <string>
#include <string_view>
#include <type_traits>

namespace shmgen {

using Status = shmgen_status;

// What becomes of a text that is too long: it makes its message one that is refused, or it is cut, in UTF-8 before the
// code point that would be torn (`overflow` and `encoding` in shmgen.toml).
enum class Long { refused, cut_utf8, cut_latin1 };

// A STRING(Capacity). Reading never goes beyond its bytes, whatever they are.
template <std::uint32_t Capacity, Long TooLong = Long::refused> class text {
public:
    text() noexcept = default;
    text(std::string_view value) noexcept { assign(value); }
    text(const char *value) noexcept { assign(std::string_view(value)); }
    text(const std::string &value) noexcept { assign(std::string_view(value)); }
    text &operator=(std::string_view value) noexcept
    {
        assign(value);
        return *this;
    }
    text &operator=(const char *value) noexcept { return *this = std::string_view(value); }
    text &operator=(const std::string &value) noexcept { return *this = std::string_view(value); }

    // False: it was too long, or held a NUL.
    bool assign(std::string_view value) noexcept
    {
        std::size_t length = value.size();
        const bool whole = length <= Capacity;
        if (!whole && TooLong != Long::refused) {
            length = Capacity;
            while (TooLong == Long::cut_utf8 && length > 0 && (static_cast<unsigned char>(value[length]) & 0xC0) == 0x80)
                --length;
        }
        if (length > Capacity || std::memchr(value.data(), 0, length) != nullptr) {
            std::memset(data_, '?', sizeof data_);
            return false;
        }
        if (length > 0)
            std::memcpy(data_, value.data(), length);
        std::memset(data_ + length, 0, sizeof data_ - length);
        return whole;
    }
    std::string_view view() const noexcept
    {
        const void *end = std::memchr(data_, 0, Capacity);
        return {data_, end == nullptr ? Capacity : static_cast<std::size_t>(static_cast<const char *>(end) - data_)};
    }
    operator std::string_view() const noexcept { return view(); }
    std::string str() const { return std::string(view()); }
    std::size_t size() const noexcept { return view().size(); }
    bool empty() const noexcept { return data_[0] == 0; }
    static constexpr std::size_t capacity() noexcept { return Capacity; }
    // Whether it holds what was assigned to it.
    bool fits() const noexcept { return std::memchr(data_, 0, sizeof data_) != nullptr; }

    friend bool operator==(const text &one, const text &other) noexcept { return one.view() == other.view(); }
    friend bool operator==(const text &one, std::string_view other) noexcept { return one.view() == other; }
    friend bool operator==(const text &one, const char *other) noexcept { return one.view() == other; }
    friend bool operator!=(const text &one, const text &other) noexcept { return one.view() != other.view(); }
    friend bool operator!=(const text &one, std::string_view other) noexcept { return one.view() != other; }
    friend bool operator!=(const text &one, const char *other) noexcept { return one.view() != other; }

private:
    char data_[Capacity + 1]{};
};

// A WSTRING(Capacity), in UTF-16 code units.
template <std::uint32_t Capacity, Long TooLong = Long::refused> class wide_text {
public:
    wide_text() noexcept = default;
    wide_text(std::u16string_view value) noexcept { assign(value); }
    wide_text(const char16_t *value) noexcept { assign(std::u16string_view(value)); }
    wide_text &operator=(std::u16string_view value) noexcept
    {
        assign(value);
        return *this;
    }
    wide_text &operator=(const char16_t *value) noexcept { return *this = std::u16string_view(value); }

    // False: it was too long, or held a NUL.
    bool assign(std::u16string_view value) noexcept
    {
        std::size_t length = value.size();
        const bool whole = length <= Capacity;
        if (!whole && TooLong != Long::refused) {
            length = Capacity;
            if (length > 0 && (value[length] & 0xFC00) == 0xDC00)
                --length;
        }
        if (length > Capacity || value.substr(0, length).find(u'\0') != std::u16string_view::npos) {
            for (char16_t &unit : data_)
                unit = u'?';
            return false;
        }
        for (std::size_t index = 0; index <= Capacity; ++index)
            data_[index] = index < length ? value[index] : u'\0';
        return whole;
    }
    std::u16string_view view() const noexcept
    {
        std::size_t length = 0;
        while (length < Capacity && data_[length] != 0)
            ++length;
        return {data_, length};
    }
    operator std::u16string_view() const noexcept { return view(); }
    std::u16string str() const { return std::u16string(view()); }
    std::size_t size() const noexcept { return view().size(); }
    bool empty() const noexcept { return data_[0] == 0; }
    static constexpr std::size_t capacity() noexcept { return Capacity; }
    bool fits() const noexcept { return shmgen_ends_wide(data_, Capacity + 1) != 0; }

    friend bool operator==(const wide_text &one, const wide_text &other) noexcept { return one.view() == other.view(); }
    friend bool operator==(const wide_text &one, std::u16string_view other) noexcept { return one.view() == other; }
    friend bool operator!=(const wide_text &one, const wide_text &other) noexcept { return one.view() != other.view(); }
    friend bool operator!=(const wide_text &one, std::u16string_view other) noexcept { return one.view() != other; }

private:
    char16_t data_[Capacity + 1]{};
};

// Up to Bound elements: the count, Gap bytes, the room for all. It lies in its message, an Owner, and nowhere else: take
// a reference to it. Whatever the count says, size() is Bound at most, and an index beyond it ends the program.
template <class T, std::uint32_t Bound, std::uint32_t Gap, class Owner> class sequence {
    static_assert(std::is_trivially_copyable<T>::value, "elements are bytes");

public:
    using value_type = T;
    using iterator = T *;
    using const_iterator = const T *;

    sequence &operator=(const sequence &) noexcept = default;
    sequence &operator=(std::initializer_list<T> values) noexcept
    {
        assign(values);
        return *this;
    }
    template <class Range, class = decltype(std::begin(std::declval<const Range &>()))>
    sequence &operator=(const Range &values) noexcept
    {
        assign(values);
        return *this;
    }

    // False: there were more than Bound, and publish() will refuse the message.
    template <class Range> bool assign(const Range &values) noexcept
    {
        clear();
        bool fits = true;
        for (const auto &value : values)
            fits = push_back(static_cast<T>(value));
        return fits;
    }
    bool push_back(const T &value) noexcept
    {
        const std::uint32_t before = count();
        if (before < Bound)
            std::memcpy(data_ + before * sizeof(T), &value, sizeof(T));
        if (before <= Bound)
            set_count(before + 1);
        return before < Bound;
    }
    bool resize(std::size_t wanted) noexcept
    {
        const std::size_t before = size();
        set_count(wanted <= Bound ? static_cast<std::uint32_t>(wanted) : Bound + 1);
        const T fresh{};
        for (std::size_t index = before; index < size(); ++index)
            std::memcpy(data_ + index * sizeof(T), &fresh, sizeof(T));
        return wanted <= Bound;
    }
    void clear() noexcept { set_count(0); }

    std::size_t size() const noexcept { return fits() ? count() : Bound; }
    bool empty() const noexcept { return count() == 0; }
    static constexpr std::size_t capacity() noexcept { return Bound; }
    // Whether it holds all that was assigned to it.
    bool fits() const noexcept { return count() <= Bound; }
    T *data() noexcept { return reinterpret_cast<T *>(data_); }
    const T *data() const noexcept { return reinterpret_cast<const T *>(data_); }
    iterator begin() noexcept { return data(); }
    iterator end() noexcept { return data() + size(); }
    const_iterator begin() const noexcept { return data(); }
    const_iterator end() const noexcept { return data() + size(); }
    T &operator[](std::size_t index) noexcept { return data()[checked(index)]; }
    const T &operator[](std::size_t index) const noexcept { return data()[checked(index)]; }
    // The element, or nullptr where there is none.
    T *find(std::size_t index) noexcept { return index < size() ? data() + index : nullptr; }
    const T *find(std::size_t index) const noexcept { return index < size() ? data() + index : nullptr; }

private:
    friend Owner;
    sequence() noexcept = default;
    sequence(std::initializer_list<T> values) noexcept { assign(values); }
    sequence(const sequence &) noexcept = default;

    std::uint32_t count() const noexcept
    {
        std::uint32_t value;
        std::memcpy(&value, count_, sizeof value);
        return value;
    }
    void set_count(std::uint32_t value) noexcept { std::memcpy(count_, &value, sizeof value); }
    std::size_t checked(std::size_t index) const noexcept
    {
        if (index >= size())
            __builtin_trap();
        return index;
    }

    unsigned char count_[4 + Gap]{};
    unsigned char data_[Bound * sizeof(T)]{};
};

// A bool of one byte, true whatever it is but 0.
class flag {
public:
    constexpr flag(bool value = false) noexcept : value_(value ? 1 : 0) {}
    constexpr operator bool() const noexcept { return value_ != 0; }

private:
    std::uint8_t value_;
};

// A time or duration in a TIME of the PLC: ms modulo 2^32.
struct clock_ms {
    std::uint32_t value{};
    clock_ms() noexcept = default;
    clock_ms(std::chrono::nanoseconds time) noexcept
        : value(static_cast<std::uint32_t>(std::chrono::floor<std::chrono::milliseconds>(time).count()))
    {
    }
    std::chrono::nanoseconds time() const noexcept { return std::chrono::milliseconds(value); }
    // The instant nearest to `now` that it can mean: right within 24 days either way.
    std::chrono::nanoseconds near(std::chrono::nanoseconds now) const noexcept
    {
        const auto ms = std::chrono::floor<std::chrono::milliseconds>(now).count();
        return std::chrono::milliseconds(ms + static_cast<std::int32_t>(value - static_cast<std::uint32_t>(ms)));
    }
};

// The same in an LTIME: ns.
struct clock_ns {
    alignas(8) std::uint64_t value{};
    clock_ns() noexcept = default;
    clock_ns(std::chrono::nanoseconds time) noexcept : value(static_cast<std::uint64_t>(time.count())) {}
    std::chrono::nanoseconds time() const noexcept { return std::chrono::nanoseconds(static_cast<std::int64_t>(value)); }
    std::chrono::nanoseconds near(std::chrono::nanoseconds) const noexcept { return time(); }
};

// The same where time = "struct".
struct clock_pair {
    std::int32_t sec{};
    std::uint32_t nanosec{};
    clock_pair() noexcept = default;
    clock_pair(std::chrono::nanoseconds time) noexcept
        : sec(static_cast<std::int32_t>(std::chrono::floor<std::chrono::seconds>(time).count())),
          nanosec(static_cast<std::uint32_t>((time - std::chrono::floor<std::chrono::seconds>(time)).count()))
    {
    }
    std::chrono::nanoseconds time() const noexcept { return std::chrono::seconds(sec) + std::chrono::nanoseconds(nanosec); }
    std::chrono::nanoseconds near(std::chrono::nanoseconds) const noexcept { return time(); }
};

// What a generated message says of itself: name, digest, how its files look, and what in it may not fit.
template <class T> struct Message;

// What of a value does not fit; with Texts, as before it is sent, else its counts only, as when it was read.
template <bool Texts, class T> Status misfit(const T &value, shmgen_path &path) noexcept
{
    return Message<T>::template misfit<Texts>(value, path);
}

template <bool Texts, std::uint32_t Capacity, Long TooLong>
Status misfit(const text<Capacity, TooLong> &value, shmgen_path &) noexcept
{
    return !Texts || value.fits() ? SHMGEN_OK : SHMGEN_TEXT_TOO_LONG;
}

template <bool Texts, std::uint32_t Capacity, Long TooLong>
Status misfit(const wide_text<Capacity, TooLong> &value, shmgen_path &) noexcept
{
    return !Texts || value.fits() ? SHMGEN_OK : SHMGEN_TEXT_TOO_LONG;
}

template <bool Texts, class Elements> Status misfit_within(const Elements &values, shmgen_path &path) noexcept
{
    using T = typename Elements::value_type;
    if constexpr (!std::is_arithmetic<T>::value && !std::is_same<T, flag>::value && !std::is_same<T, clock_ms>::value &&
                  !std::is_same<T, clock_ns>::value && !std::is_same<T, clock_pair>::value) {
        std::uint32_t index = 0;
        for (const T &value : values) {
            const Status status = misfit<Texts>(value, path);
            if (status != SHMGEN_OK) {
                if (*shmgen_path_text(&path) != 0)
                    shmgen_path_put(&path, ".");
                shmgen_path_index(&path, index);
                return status;
            }
            ++index;
        }
    }
    return SHMGEN_OK;
}

template <bool Texts, class T, std::uint32_t Bound, std::uint32_t Gap, class Owner>
Status misfit(const sequence<T, Bound, Gap, Owner> &values, shmgen_path &path) noexcept
{
    return values.fits() ? misfit_within<Texts>(values, path) : SHMGEN_COUNT_EXCEEDED;
}

template <bool Texts, class T, std::size_t Length>
Status misfit(const std::array<T, Length> &values, shmgen_path &path) noexcept
{
    return misfit_within<Texts>(values, path);
}

} // namespace shmgen

#endif
