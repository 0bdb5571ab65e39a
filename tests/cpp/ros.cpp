// Messages of ROS, as its own headers say them, to our classes and back; ROS is 1 or 2. It says nothing where all is right.
#if ROS == 2
#include "shm_msgs_ros2/diagnostic_msgs/msg/diagnostic_status.hpp"
#include "shm_msgs_ros2/sensor_msgs/msg/joint_state.hpp"
#include "shm_msgs_ros2/std_srvs/srv/set_bool_response.hpp"
#include "shm_msgs_ros2/visualization_msgs/msg/marker.hpp"
namespace ros_sensor = sensor_msgs::msg;
namespace ros_marker = visualization_msgs::msg;
namespace ros_diagnostic = diagnostic_msgs::msg;
using Answer = std_srvs::srv::SetBool_Response;
#define NANOSECONDS nanosec
#else
#include "shm_msgs_ros1/diagnostic_msgs/msg/diagnostic_status.hpp"
#include "shm_msgs_ros1/sensor_msgs/msg/joint_state.hpp"
#include "shm_msgs_ros1/std_srvs/srv/set_bool_response.hpp"
#include "shm_msgs_ros1/visualization_msgs/msg/marker.hpp"
namespace ros_sensor = sensor_msgs;
namespace ros_marker = visualization_msgs;
namespace ros_diagnostic = diagnostic_msgs;
using Answer = std_srvs::SetBoolResponse;
#define NANOSECONDS nsec
#endif

#include <cstdio>
#include <cstdlib>
#include <ctime>

namespace sensor = shm_msgs::sensor_msgs::msg;
namespace marker = shm_msgs::visualization_msgs::msg;

#define CHECK(what) \
    if (!(what)) { \
        std::printf("line %d: %s\n", __LINE__, #what); \
        std::exit(1); \
    }

static void joints()
{
    ros_sensor::JointState theirs, back;
    theirs.header.stamp.sec = static_cast<decltype(theirs.header.stamp.sec)>(std::time(nullptr));
    theirs.header.stamp.NANOSECONDS = 250000000;
    theirs.header.frame_id = "base";
    theirs.name = {"one", "two"};
    theirs.position = {1.5, -2.5};
    sensor::JointState ours;
    ours.velocity.push_back(9.0); // what was there before goes
    CHECK(shmgen::from_ros(theirs, ours));
    CHECK(ours.name.size() == 2 && ours.name[1] == "two" && ours.position[1] == -2.5 && ours.velocity.empty());
    back = shmgen::to_ros(ours);
    CHECK(back == theirs);

    theirs.name.assign(100, "x");
    CHECK(!shmgen::from_ros(theirs, ours) && !ours.name.fits());
    theirs.name.assign(1, std::string(1000, 'x'));
    CHECK(!shmgen::from_ros(theirs, ours) && ours.name.fits() && !ours.name[0].fits());
    theirs.name.clear();
    CHECK(shmgen::from_ros(theirs, ours) && ours.name.empty());

    theirs.header.stamp = decltype(theirs.header.stamp)(); // unset stays unset
    CHECK(shmgen::from_ros(theirs, ours));
    CHECK(shmgen::to_ros(ours) == theirs);
}

static void markers()
{
    ros_marker::Marker theirs;
    theirs.id = -3;
    theirs.frame_locked = true;
    theirs.lifetime.sec = 2;
    theirs.lifetime.NANOSECONDS = 5000000;
    theirs.color.r = 0.5f;
    theirs.pose.orientation.w = 1.0;
    theirs.points.resize(2);
    theirs.points[1].z = 7.0;
    theirs.text = "caption";
    marker::Marker ours;
    CHECK(shmgen::from_ros(theirs, ours));
    CHECK(ours.frame_locked && ours.points[1].z == 7.0 && ours.lifetime.time() == std::chrono::milliseconds(2005));
    CHECK(shmgen::to_ros(ours) == theirs);
    theirs.lifetime.sec = -1;
    CHECK(!shmgen::from_ros(theirs, ours) && ours.lifetime.time().count() == 0);
    theirs.lifetime.sec = 5000000;
    CHECK(!shmgen::from_ros(theirs, ours) && ours.lifetime.time() == std::chrono::milliseconds(4294967295));
}

#if ROS == 2
// What Lyrical's rosidl::Buffer<uint8_t> has of all this: off the CPU it throws.
struct Buffer {
    using value_type = std::uint8_t;
    std::vector<std::uint8_t> bytes;
    std::string backend = "cpu";
    bool lost = false;
    const std::vector<std::uint8_t> &here() const { return backend == "cpu" ? bytes : throw std::runtime_error(backend); }
    std::string get_backend_type() const { return backend; }
    std::size_t size() const { return bytes.size(); }
    const std::uint8_t *begin() const { return here().data(); }
    std::vector<std::uint8_t> to_vector() const { return lost ? throw std::runtime_error("lost") : bytes; }
    template <class It> void assign(It first, It last)
    {
        here();
        bytes.assign(first, last);
    }
};

static void buffers()
{
    marker::Marker ours;
    for (const char *backend : {"cpu", "cuda"}) {
        Buffer theirs{{1, 2, 3}, backend};
        CHECK(shmgen::from_ros(theirs, ours.texture.data) && ours.texture.data.size() == 3 && ours.texture.data[2] == 3);
        ours.texture.data.push_back(4);
        shmgen::to_ros(ours.texture.data, theirs);
        CHECK(theirs.backend == "cpu" && theirs.bytes.size() == 4);
        theirs = Buffer{std::vector<std::uint8_t>(1000), backend};
        CHECK(!shmgen::from_ros(theirs, ours.texture.data) && !ours.texture.data.fits());
    }
    CHECK(!shmgen::from_ros(Buffer{{1}, "cuda", true}, ours.texture.data) && !ours.texture.data.fits());
}
#endif

int main(int, [[maybe_unused]] char **argv)
{
    joints();
    markers();
    ros_diagnostic::DiagnosticStatus status;
    status.level = static_cast<decltype(status.level)>(2); // a byte is signed in one ROS alone
    status.values.resize(1);
    status.values[0].key = "volts";
    shm_msgs::diagnostic_msgs::msg::DiagnosticStatus ours;
    CHECK(shmgen::from_ros(status, ours) && ours.level == 2 && ours.values[0].key == "volts");
    CHECK(shmgen::to_ros(ours) == status);

    Answer answer;
    answer.success = true;
    answer.message = "done";
    shm_msgs::std_srvs::srv::SetBool_Response answered;
    CHECK(shmgen::from_ros(answer, answered) && answered.success && answered.message == "done");
    CHECK(shmgen::to_ros(answered).message == "done");
#if ROS == 2
    using Adapter = rclcpp::TypeAdapter<sensor::JointState, ros_sensor::JointState>;
    static_assert(Adapter::is_specialized::value, "specialised");
    static_assert(std::is_same<Adapter::ros_message_type, ros_sensor::JointState>::value, "ROS's own");
    Adapter::custom_type custom;
    Adapter::ros_message_type message;
    message.position = {4.0};
    Adapter::convert_to_custom(message, custom);
    message.position.clear();
    Adapter::convert_to_ros_message(custom, message);
    CHECK(message.position.at(0) == 4.0);
    message.name.assign(100, "x");
    Adapter::convert_to_custom(message, custom); // it must not end spin()
    CHECK(!custom.name.fits() && Adapter::misfits() == 1);
    sensor::JointStatePublisher publisher(argv[1]);
    CHECK(publisher.publish(custom) == SHMGEN_COUNT_EXCEEDED && publisher.rejected() == "name");
    shmgen::adapters_throw = true;
    try {
        Adapter::convert_to_custom(message, custom);
        CHECK(false);
    } catch (const std::range_error &) {
        CHECK(Adapter::misfits() == 2);
    }
    buffers();
#endif
}
