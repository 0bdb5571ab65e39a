// A stand-in for the type headers of STruC++. Each variable is a wrapper with a value and a flag that forces the value.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <type_traits>

#define SHMGEN_TEST_EXPORT extern "C"

namespace strucpp {

template <class T> class IECVar {
  public:
    using value_type = T;
    IECVar() noexcept : value_{}, forced_{false} {}
    IECVar(T value) noexcept : value_{value}, forced_{false} {}
    IECVar &operator=(const IECVar &other) noexcept
    {
        set(other.get());
        return *this;
    }
    IECVar(const IECVar &other) noexcept : value_{other.get()}, forced_{false} {}
    T get() const noexcept { return value_; }
    void set(T value) noexcept
    {
        if (!forced_)
            value_ = value;
    }

  private:
    T value_;
    bool forced_;
};

template <std::size_t Size> class IECString {
  public:
    IECString() noexcept : length_{0} { data_[0] = 0; }
    void set(const char *text) noexcept
    {
        std::size_t length = std::strlen(text);
        length_ = static_cast<uint16_t>(length < Size ? length : Size);
        std::memcpy(data_, text, length_);
        data_[length_] = 0;
    }
    std::size_t length() const noexcept { return length_; }
    const char *c_str() const noexcept { return data_; }

  private:
    char data_[Size + 1];
    uint16_t length_;
};

template <std::size_t Size> class IECStringVar {
  public:
    IECString<Size> get() const noexcept { return value_; }
    IECStringVar &operator=(const char *text) noexcept
    {
        value_.set(text);
        return *this;
    }

  private:
    IECString<Size> value_;
};

template <class T, int64_t Lower, int64_t Upper> class Array1D {
  public:
    Array1D() noexcept : data_{} {}
    template <class U> Array1D(std::initializer_list<U> values) noexcept : data_{}
    {
        std::size_t index = 0;
        for (const auto &value : values)
            data_[index++] = value;
    }
    T &operator[](int64_t index) noexcept { return data_[static_cast<std::size_t>(index - Lower)]; }
    const T &operator[](int64_t index) const noexcept { return data_[static_cast<std::size_t>(index - Lower)]; }

  private:
    std::array<T, static_cast<std::size_t>(Upper - Lower + 1)> data_;
};

using IEC_BOOL = IECVar<bool>;
using IEC_SINT = IECVar<int8_t>;
using IEC_INT = IECVar<int16_t>;
using IEC_DINT = IECVar<int32_t>;
using IEC_LINT = IECVar<int64_t>;
using IEC_USINT = IECVar<uint8_t>;
using IEC_UINT = IECVar<uint16_t>;
using IEC_UDINT = IECVar<uint32_t>;
using IEC_ULINT = IECVar<uint64_t>;
using IEC_REAL = IECVar<float>;
using IEC_LREAL = IECVar<double>;
using IEC_TIME = IECVar<int64_t>; // ns

template <class T> double number(const IECVar<T> &variable) { return static_cast<double>(variable.get()); }
inline void put_time(IEC_TIME &variable, double seconds) { variable = static_cast<int64_t>(seconds * 1e9); }
template <std::size_t Size> void put_text(IECStringVar<Size> &variable, const char *text) { variable = text; }

} // namespace strucpp
