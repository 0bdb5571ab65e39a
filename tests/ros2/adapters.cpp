// Two nodes of rclcpp in one process, with our messages in place of ROS's. It says nothing where all is right.
#include "shm_msgs_ros2/geometry_msgs/msg/pose_stamped.hpp"
#include "shm_msgs_ros2/sensor_msgs/msg/joint_state.hpp"

#include <rclcpp/rclcpp.hpp>

#include <cstdio>
#include <cstdlib>

using namespace std::chrono_literals;
using Pose = shm_msgs::geometry_msgs::msg::PoseStamped;
using Joints = shm_msgs::sensor_msgs::msg::JointState;
using RosPose = geometry_msgs::msg::PoseStamped;
using RosJoints = sensor_msgs::msg::JointState;
using AdaptedPose = rclcpp::TypeAdapter<Pose, RosPose>;
using AdaptedJoints = rclcpp::TypeAdapter<Joints, RosJoints>;

constexpr int COUNT = 200;

#define CHECK(what) \
    if (!(what)) { \
        std::printf("line %d: %s\n", __LINE__, #what); \
        std::_Exit(1); \
    }

struct Pair {
    rclcpp::Node::SharedPtr one, other;
    rclcpp::executors::SingleThreadedExecutor executor;
    explicit Pair(bool within)
    {
        static int number = 0;
        const auto options = rclcpp::NodeOptions().use_intra_process_comms(within);
        one = std::make_shared<rclcpp::Node>("one" + std::to_string(++number), options);
        other = std::make_shared<rclcpp::Node>("other" + std::to_string(number), options);
        executor.add_node(one);
        executor.add_node(other);
    }
    template <class Publisher> void connected(const Publisher &publisher)
    {
        for (const auto end = std::chrono::steady_clock::now() + 20s; publisher->get_subscription_count() == 0;) {
            CHECK(std::chrono::steady_clock::now() < end);
            executor.spin_some(10ms);
        }
    }
    template <class Done> void until(const Done &done)
    {
        for (const auto end = std::chrono::steady_clock::now() + 20s; !done() && std::chrono::steady_clock::now() < end;)
            executor.spin_some(10ms);
        CHECK(done());
    }
};

static double x_of(const Pose &pose) { return pose.pose.position.x; }
static double x_of(const RosPose &pose) { return pose.pose.position.x; }
static void fill(Pose &pose, int number)
{
    pose.header.frame_id = "base";
    pose.pose.position.x = number + 0.25;
}
static void fill(RosPose &pose, int number)
{
    pose.header.frame_id = "base";
    pose.pose.position.x = number + 0.25;
}

// `Sent` is published by a publisher of `Outlet`; a subscription of `Inlet` hands over `Taken`.
template <class Outlet, class Sent, class Inlet, class Taken> static void passes(bool within)
{
    Pair nodes(within);
    const rclcpp::QoS quality(COUNT);
    std::vector<double> came;
    const Sent *sent = nullptr;
    bool same = true;
    auto subscription = nodes.other->create_subscription<Inlet>("pose", quality, [&](std::unique_ptr<Taken> pose) {
        same = same && static_cast<const void *>(pose.get()) == sent;
        came.push_back(x_of(*pose));
    });
    auto publisher = nodes.one->create_publisher<Outlet>("pose", quality);
    nodes.connected(publisher);
    for (int number = 0; number < COUNT; ++number) {
        auto pose = std::make_unique<Sent>();
        fill(*pose, number);
        sent = pose.get();
        publisher->publish(std::move(pose));
        nodes.until([&] { return came.size() == static_cast<std::size_t>(number + 1); });
        CHECK(came.back() == number + 0.25);
    }
    const bool is_one_type = std::is_same_v<Outlet, Inlet> && std::is_same_v<Sent, Taken>;
    CHECK(!within || !is_one_type || same); // no copy on the way
}

template <class Outlet, class Sent> static void does_not_throw(bool within)
{
    Pair nodes(within);
    const std::uint64_t before = AdaptedJoints::misfits();
    Joints ours;
    int came = 0;
    auto subscription = nodes.other->create_subscription<AdaptedJoints>("joints", 10, [&](const Joints &joints) {
        ours = joints;
        ++came;
    });
    auto publisher = nodes.one->create_publisher<Outlet>("joints", 10);
    nodes.connected(publisher);
    Sent nine;
    nine.position.assign(9, 1.0);
    publisher->publish(nine);
    nodes.until([&] { return came == 1; });
    CHECK(AdaptedJoints::misfits() > before && !ours.position.fits());
    shm_msgs::sensor_msgs::msg::JointStatePublisher region(std::getenv("TOPIC"));
    CHECK(region.publish(ours) == SHMGEN_COUNT_EXCEEDED && region.rejected() == "position");
    nine.position.resize(8);
    publisher->publish(nine);
    nodes.until([&] { return came == 2; });
    CHECK(ours.position.size() == 8 && region.publish(ours) == SHMGEN_OK);
}

// On request, as it was once for all.
static void throws()
{
    Pair nodes(false);
    auto subscription = nodes.other->create_subscription<AdaptedJoints>("joints", 10, [](const Joints &) {});
    auto publisher = nodes.one->create_publisher<RosJoints>("joints", 10);
    nodes.connected(publisher);
    RosJoints nine;
    nine.position.assign(9, 1.0);
    publisher->publish(nine);
    shmgen::adapters_throw = true;
    bool thrown = false;
    for (const auto end = std::chrono::steady_clock::now() + 20s; !thrown && std::chrono::steady_clock::now() < end;) {
        try {
            nodes.executor.spin_some(10ms);
        } catch (const std::range_error &) {
            thrown = true;
        }
    }
    CHECK(thrown);
}

int main(int count, char **words)
{
    rclcpp::init(count, words);
    for (const bool within : {false, true}) {
        passes<AdaptedPose, Pose, AdaptedPose, Pose>(within);
        passes<AdaptedPose, Pose, RosPose, RosPose>(within);
        passes<AdaptedPose, RosPose, AdaptedPose, Pose>(within);
        passes<AdaptedPose, RosPose, RosPose, RosPose>(within);
        passes<RosPose, RosPose, AdaptedPose, Pose>(within);
        passes<RosPose, RosPose, RosPose, RosPose>(within);
        does_not_throw<RosJoints, RosJoints>(within);
        does_not_throw<AdaptedJoints, RosJoints>(within);
    }
    throws();
    std::_Exit(0);
}
