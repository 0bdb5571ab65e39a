// From messages in shared memory to ROS's own and back, whatever they are made of: the headers beside it say what is in each.
//
// Made by shmgen; changes made here are lost.
//
//     geometry_msgs::msg::Pose theirs = shmgen::to_ros(ours);
//     shmgen::from_ros(theirs, ours);              // false: something did not fit, and publish(ours) will refuse it
//
// What is too long for its field is not lost in silence: the field remembers it, and publish() refuses the message with
// the field's path. A duration has no way to remember; where it cannot travel as it is (a TIME of the PLC goes from 0 to
// 49 days) it becomes the nearest one that can, and from_ros() says false.
#ifndef SHMGEN_ROS_HPP
#define SHMGEN_ROS_HPP

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <type_traits>
#include <utility>

#if defined(__has_include)
#if __has_include(<rclcpp/type_adapter.hpp>)
#include <rclcpp/type_adapter.hpp>
#define SHMGEN_HAS_TYPE_ADAPTER 1
#endif
#endif

namespace shmgen {

// ROS's class of a message of ours, and how it is filled: Ros<T>::type.
template <class T> struct Ros;

// Which of both a clock is.
struct time;
struct duration;

template <class T> constexpr bool is_clock =
    std::is_same<T, clock_ms>::value || std::is_same<T, clock_ns>::value || std::is_same<T, clock_pair>::value;
template <class T> constexpr bool is_number = std::is_arithmetic<T>::value || std::is_same<T, flag>::value;
template <class T> constexpr bool is_text = false;
template <std::uint32_t Capacity, Long TooLong> constexpr bool is_text<text<Capacity, TooLong>> = true;
template <std::uint32_t Capacity, Long TooLong> constexpr bool is_text<wide_text<Capacity, TooLong>> = true;
template <class T> constexpr bool is_sequence = false;
template <class T, std::uint32_t Bound, std::uint32_t Gap, class Owner>
constexpr bool is_sequence<sequence<T, Bound, Gap, Owner>> = true;
template <class T> constexpr bool is_array = false;
template <class T, std::size_t Length> constexpr bool is_array<std::array<T, Length>> = true;

// `nanosec` in ROS 2, `nsec` in ROS 1.
template <class Stamp> auto nanoseconds_of(Stamp &stamp, int) -> decltype((stamp.nanosec)) { return stamp.nanosec; }
template <class Stamp> auto nanoseconds_of(Stamp &stamp, long) -> decltype((stamp.nsec)) { return stamp.nsec; }

template <class Kind, class T, class Stamp> void clock_to_ros(const T &from, Stamp &into)
{
    auto &nanoseconds = nanoseconds_of(into, 0);
    if constexpr (std::is_same<T, clock_pair>::value) {
        into.sec = static_cast<std::decay_t<decltype(into.sec)>>(from.sec);
        nanoseconds = static_cast<std::decay_t<decltype(nanoseconds)>>(from.nanosec);
    } else {
        std::chrono::nanoseconds since = from.time();
        if (std::is_same<Kind, time>::value && since.count() != 0) // 0 is unset
            since = from.near(std::chrono::system_clock::now().time_since_epoch());
        const auto seconds = std::chrono::floor<std::chrono::seconds>(since);
        into.sec = static_cast<std::decay_t<decltype(into.sec)>>(seconds.count());
        nanoseconds = static_cast<std::decay_t<decltype(nanoseconds)>>((since - seconds).count());
    }
}

template <class Kind, class Stamp, class T> bool clock_from_ros(const Stamp &from, T &into)
{
    const std::int64_t seconds = static_cast<std::int64_t>(from.sec);
    const std::int64_t nanoseconds = static_cast<std::int64_t>(nanoseconds_of(from, 0));
    if constexpr (std::is_same<T, clock_pair>::value) {
        into.sec = static_cast<std::int32_t>(from.sec);
        into.nanosec = static_cast<std::uint32_t>(nanoseconds);
        return seconds == into.sec;
    } else {
        constexpr std::int64_t most = std::numeric_limits<std::uint32_t>::max();
        std::int64_t total = seconds * 1000000000 + nanoseconds;
        const bool negative = total < 0;
        total = negative ? 0 : total;
        into = T(std::chrono::nanoseconds(total));
        if constexpr (std::is_same<T, clock_ms>::value) {
            if (std::is_same<Kind, time>::value) {
                if (total != 0 && into.value == 0) // which would be unset
                    into.value = 1;
            } else if (total / 1000000 > most) {
                into.value = static_cast<std::uint32_t>(most);
                return false;
            }
        }
        return !negative;
    }
}

template <class Kind = void, class T, class R> void to_ros(const T &from, R &into)
{
    if constexpr (is_clock<T>) {
        clock_to_ros<Kind>(from, into);
    } else if constexpr (std::is_same<T, flag>::value) {
        into = static_cast<R>(static_cast<bool>(from));
    } else if constexpr (is_number<T>) {
        into = static_cast<R>(from);
    } else if constexpr (is_text<T>) {
        into.assign(from.view().data(), from.view().size());
    } else if constexpr (is_sequence<T> || is_array<T>) {
        using E = typename T::value_type;
        using F = typename R::value_type;
        if constexpr (is_sequence<T> && std::is_arithmetic<E>::value && std::is_same<E, F>::value) {
            into.assign(from.begin(), from.end());
        } else {
            if constexpr (is_sequence<T>)
                into.resize(from.size());
            for (std::size_t index = 0; index < from.size(); ++index) {
                if constexpr (is_number<E>) // of std::vector<bool> there is no reference to an element
                    into[index] = static_cast<F>(static_cast<std::conditional_t<std::is_same<E, flag>::value, bool, E>>(from[index]));
                else
                    to_ros<Kind>(from[index], into[index]);
            }
        }
    } else {
        Ros<T>::give(from, into);
    }
}

// False: something did not fit.
template <class Kind = void, class R, class T> bool from_ros(const R &from, T &into)
{
    if constexpr (is_clock<T>) {
        return clock_from_ros<Kind>(from, into);
    } else if constexpr (std::is_same<T, flag>::value) {
        into = static_cast<bool>(from);
        return true;
    } else if constexpr (is_number<T>) {
        into = static_cast<T>(from);
        return true;
    } else if constexpr (is_text<T>) {
        return into.assign({from.data(), from.size()});
    } else if constexpr (is_sequence<T> || is_array<T>) {
        using E = typename T::value_type;
        using F = typename R::value_type;
        bool fits = true;
        if constexpr (is_sequence<T>) {
            into.clear();
            fits = into.resize(from.size());
        }
        if constexpr (std::is_arithmetic<E>::value && std::is_same<E, F>::value) {
            std::copy_n(from.begin(), into.size(), into.begin());
        } else {
            for (std::size_t index = 0; index < into.size(); ++index) {
                if constexpr (std::is_same<F, bool>::value)
                    into[index] = static_cast<bool>(from[index]);
                else
                    fits = from_ros<Kind>(from[index], into[index]) && fits;
            }
        }
        return fits;
    } else {
        return Ros<T>::take(from, into);
    }
}

template <class T> typename Ros<T>::type to_ros(const T &from)
{
    typename Ros<T>::type into;
    Ros<T>::give(from, into);
    return into;
}

#ifdef SHMGEN_HAS_TYPE_ADAPTER
// What REP 2007 asks of a type that nodes publish and subscribe in place of ROS's own.
template <class T> struct Adapter {
    using is_specialized = std::true_type;
    using custom_type = T;
    using ros_message_type = typename Ros<T>::type;
    static void convert_to_ros_message(const custom_type &from, ros_message_type &into) { Ros<T>::give(from, into); }
    static void convert_to_custom(const ros_message_type &from, custom_type &into)
    {
        if (!Ros<T>::take(from, into))
            throw std::range_error("a value of the ROS message does not fit its field in shared memory");
    }
};
#endif

} // namespace shmgen

#endif
