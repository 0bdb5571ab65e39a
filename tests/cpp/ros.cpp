// Converts messages of ROS 1 or ROS 2 (the macro ROS) to shmgen's classes and back. Prints nothing if all checks pass.
#if ROS == 2
#include "shm_msgs_ros2/diagnostic_msgs/msg/diagnostic_status.hpp"
#include "shm_msgs_ros2/sensor_msgs/msg/joint_state.hpp"
#include "shm_msgs_ros2/std_srvs/srv/set_bool_response.hpp"
#include "shm_msgs_ros2/visualization_msgs/msg/marker.hpp"
namespace ros_sensor = sensor_msgs::msg;
namespace ros_marker = visualization_msgs::msg;
namespace ros_diagnostic = diagnostic_msgs::msg;
using RosResponse = std_srvs::srv::SetBool_Response;
#define NANOSECONDS nanosec
#else
#include "shm_msgs_ros1/diagnostic_msgs/msg/diagnostic_status.hpp"
#include "shm_msgs_ros1/sensor_msgs/msg/joint_state.hpp"
#include "shm_msgs_ros1/std_srvs/srv/set_bool_response.hpp"
#include "shm_msgs_ros1/visualization_msgs/msg/marker.hpp"
namespace ros_sensor = sensor_msgs;
namespace ros_marker = visualization_msgs;
namespace ros_diagnostic = diagnostic_msgs;
using RosResponse = std_srvs::SetBoolResponse;
#define NANOSECONDS nsec
#endif

#include <cstdio>
#include <cstdlib>
#include <ctime>

namespace sensor = shm_msgs::sensor_msgs::msg;
namespace marker = shm_msgs::visualization_msgs::msg;

#define CHECK(condition) \
    if (!(condition)) { \
        std::printf("line %d: %s\n", __LINE__, #condition); \
        std::exit(1); \
    }

static void test_joint_states()
{
    ros_sensor::JointState ros_message, converted_back;
    ros_message.header.stamp.sec = static_cast<decltype(ros_message.header.stamp.sec)>(std::time(nullptr));
    ros_message.header.stamp.NANOSECONDS = 250000000;
    ros_message.header.frame_id = "base";
    ros_message.name = {"one", "two"};
    ros_message.position = {1.5, -2.5};
    sensor::JointState message;
    message.velocity.push_back(9.0); // from_ros() must overwrite this value
    CHECK(shmgen::from_ros(ros_message, message));
    CHECK(message.name.size() == 2 && message.name[1] == "two" && message.position[1] == -2.5 && message.velocity.empty());
    converted_back = shmgen::to_ros(message);
    CHECK(converted_back == ros_message);

    ros_message.name.assign(100, "x");
    CHECK(!shmgen::from_ros(ros_message, message) && !message.name.fits());
    ros_message.name.assign(1, std::string(1000, 'x'));
    CHECK(!shmgen::from_ros(ros_message, message) && message.name.fits() && !message.name[0].fits());
    ros_message.name.clear();
    CHECK(shmgen::from_ros(ros_message, message) && message.name.empty());

    ros_message.header.stamp = decltype(ros_message.header.stamp)(); // an unset stamp stays unset
    CHECK(shmgen::from_ros(ros_message, message));
    CHECK(shmgen::to_ros(message) == ros_message);
}

static void test_markers()
{
    ros_marker::Marker ros_message;
    ros_message.id = -3;
    ros_message.frame_locked = true;
    ros_message.lifetime.sec = 2;
    ros_message.lifetime.NANOSECONDS = 5000000;
    ros_message.color.r = 0.5f;
    ros_message.pose.orientation.w = 1.0;
    ros_message.points.resize(2);
    ros_message.points[1].z = 7.0;
    ros_message.text = "caption";
    marker::Marker message;
    CHECK(shmgen::from_ros(ros_message, message));
    CHECK(message.frame_locked && message.points[1].z == 7.0 && message.lifetime.time() == std::chrono::milliseconds(2005));
    CHECK(shmgen::to_ros(message) == ros_message);
    ros_message.lifetime.sec = -1;
    CHECK(!shmgen::from_ros(ros_message, message) && message.lifetime.time().count() == 0);
    ros_message.lifetime.sec = 5000000;
    CHECK(!shmgen::from_ros(ros_message, message) && message.lifetime.time() == std::chrono::milliseconds(4294967295));
}

#if ROS == 2
// A stand-in for rosidl::Buffer<uint8_t> of ROS 2 Lyrical. Access to the bytes throws if the backend is not the CPU.
struct Buffer {
    using value_type = std::uint8_t;
    std::vector<std::uint8_t> bytes;
    std::string backend = "cpu";
    bool is_lost = false;
    const std::vector<std::uint8_t> &cpu_bytes() const { return backend == "cpu" ? bytes : throw std::runtime_error(backend); }
    std::string get_backend_type() const { return backend; }
    std::size_t size() const { return bytes.size(); }
    const std::uint8_t *begin() const { return cpu_bytes().data(); }
    std::vector<std::uint8_t> to_vector() const { return is_lost ? throw std::runtime_error("lost") : bytes; }
    template <class It> void assign(It first, It last)
    {
        cpu_bytes();
        bytes.assign(first, last);
    }
};

static void test_buffers()
{
    marker::Marker message;
    for (const char *backend : {"cpu", "cuda"}) {
        Buffer ros_message{{1, 2, 3}, backend};
        CHECK(shmgen::from_ros(ros_message, message.texture.data) && message.texture.data.size() == 3 && message.texture.data[2] == 3);
        message.texture.data.push_back(4);
        shmgen::to_ros(message.texture.data, ros_message);
        CHECK(ros_message.backend == "cpu" && ros_message.bytes.size() == 4);
        ros_message = Buffer{std::vector<std::uint8_t>(1000), backend};
        CHECK(!shmgen::from_ros(ros_message, message.texture.data) && !message.texture.data.fits());
    }
    CHECK(!shmgen::from_ros(Buffer{{1}, "cuda", true}, message.texture.data) && !message.texture.data.fits());
}
#endif

int main(int, [[maybe_unused]] char **argv)
{
    test_joint_states();
    test_markers();
    ros_diagnostic::DiagnosticStatus status;
    status.level = static_cast<decltype(status.level)>(2); // the type `byte` is signed in ROS 1 only
    status.values.resize(1);
    status.values[0].key = "volts";
    shm_msgs::diagnostic_msgs::msg::DiagnosticStatus message;
    CHECK(shmgen::from_ros(status, message) && message.level == 2 && message.values[0].key == "volts");
    CHECK(shmgen::to_ros(message) == status);

    RosResponse ros_response;
    ros_response.success = true;
    ros_response.message = "done";
    shm_msgs::std_srvs::srv::SetBool_Response response;
    CHECK(shmgen::from_ros(ros_response, response) && response.success && response.message == "done");
    CHECK(shmgen::to_ros(response).message == "done");
#if ROS == 2
    using Adapter = rclcpp::TypeAdapter<sensor::JointState, ros_sensor::JointState>;
    static_assert(Adapter::is_specialized::value, "TypeAdapter is specialized");
    static_assert(std::is_same<Adapter::ros_message_type, ros_sensor::JointState>::value, "the message type of ROS");
    Adapter::custom_type custom;
    Adapter::ros_message_type ros_message;
    ros_message.position = {4.0};
    Adapter::convert_to_custom(ros_message, custom);
    ros_message.position.clear();
    Adapter::convert_to_ros_message(custom, ros_message);
    CHECK(ros_message.position.at(0) == 4.0);
    ros_message.name.assign(100, "x");
    Adapter::convert_to_custom(ros_message, custom); // the conversion must not throw, because an exception would end spin()
    CHECK(!custom.name.fits() && Adapter::misfits() == 1);
    sensor::JointStatePublisher publisher(argv[1]);
    CHECK(publisher.publish(custom) == SHMGEN_COUNT_EXCEEDED && publisher.rejected() == "name");
    shmgen::adapters_throw = true;
    try {
        Adapter::convert_to_custom(ros_message, custom);
        CHECK(false);
    } catch (const std::range_error &) {
        CHECK(Adapter::misfits() == 2);
    }
    test_buffers();
#endif
}
