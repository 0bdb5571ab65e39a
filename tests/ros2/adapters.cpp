// Two nodes of rclcpp in one process that use shmgen's messages instead of those of ROS. Prints nothing if all checks pass.
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

#define CHECK(condition) \
    if (!(condition)) { \
        std::printf("line %d: %s\n", __LINE__, #condition); \
        std::_Exit(1); \
    }

struct NodePair {
    rclcpp::Node::SharedPtr first, second;
    rclcpp::executors::SingleThreadedExecutor executor;
    explicit NodePair(bool intra_process)
    {
        static int number = 0;
        const auto options = rclcpp::NodeOptions().use_intra_process_comms(intra_process);
        first = std::make_shared<rclcpp::Node>("first" + std::to_string(++number), options);
        second = std::make_shared<rclcpp::Node>("second" + std::to_string(number), options);
        executor.add_node(first);
        executor.add_node(second);
    }
    template <class Publisher> void wait_for_subscription(const Publisher &publisher)
    {
        for (const auto deadline = std::chrono::steady_clock::now() + 20s; publisher->get_subscription_count() == 0;) {
            CHECK(std::chrono::steady_clock::now() < deadline);
            executor.spin_some(10ms);
        }
    }
    template <class Condition> void spin_until(const Condition &is_done)
    {
        for (const auto deadline = std::chrono::steady_clock::now() + 20s; !is_done() && std::chrono::steady_clock::now() < deadline;)
            executor.spin_some(10ms);
        CHECK(is_done());
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

// A publisher of `PublishedType` publishes `Sent`. The callback of a subscription of `SubscribedType` receives `Received`.
template <class PublishedType, class Sent, class SubscribedType, class Received> static void test_poses_arrive(bool intra_process)
{
    NodePair nodes(intra_process);
    const rclcpp::QoS qos(COUNT);
    std::vector<double> received;
    const Sent *sent = nullptr;
    bool is_same_object = true;
    auto subscription = nodes.second->create_subscription<SubscribedType>("pose", qos, [&](std::unique_ptr<Received> pose) {
        is_same_object = is_same_object && static_cast<const void *>(pose.get()) == sent;
        received.push_back(x_of(*pose));
    });
    auto publisher = nodes.first->create_publisher<PublishedType>("pose", qos);
    nodes.wait_for_subscription(publisher);
    for (int number = 0; number < COUNT; ++number) {
        auto pose = std::make_unique<Sent>();
        fill(*pose, number);
        sent = pose.get();
        publisher->publish(std::move(pose));
        nodes.spin_until([&] { return received.size() == static_cast<std::size_t>(number + 1); });
        CHECK(received.back() == number + 0.25);
    }
    const bool is_one_type = std::is_same_v<PublishedType, SubscribedType> && std::is_same_v<Sent, Received>;
    CHECK(!intra_process || !is_one_type || is_same_object); // the message was not copied
}

template <class PublishedType, class Sent> static void test_misfit_does_not_throw(bool intra_process)
{
    NodePair nodes(intra_process);
    const std::uint64_t misfits_before = AdaptedJoints::misfits();
    Joints message;
    int received = 0;
    auto subscription = nodes.second->create_subscription<AdaptedJoints>("joints", 10, [&](const Joints &joints) {
        message = joints;
        ++received;
    });
    auto publisher = nodes.first->create_publisher<PublishedType>("joints", 10);
    nodes.wait_for_subscription(publisher);
    Sent joints;
    joints.position.assign(9, 1.0);
    publisher->publish(joints);
    nodes.spin_until([&] { return received == 1; });
    CHECK(AdaptedJoints::misfits() > misfits_before && !message.position.fits());
    shm_msgs::sensor_msgs::msg::JointStatePublisher region(std::getenv("TOPIC"));
    CHECK(region.publish(message) == SHMGEN_COUNT_EXCEEDED && region.rejected() == "position");
    joints.position.resize(8);
    publisher->publish(joints);
    nodes.spin_until([&] { return received == 2; });
    CHECK(message.position.size() == 8 && region.publish(message) == SHMGEN_OK);
}

// With adapters_throw, a misfit throws an exception.
static void test_misfit_throws_on_request()
{
    NodePair nodes(false);
    auto subscription = nodes.second->create_subscription<AdaptedJoints>("joints", 10, [](const Joints &) {});
    auto publisher = nodes.first->create_publisher<RosJoints>("joints", 10);
    nodes.wait_for_subscription(publisher);
    RosJoints joints;
    joints.position.assign(9, 1.0);
    publisher->publish(joints);
    shmgen::adapters_throw = true;
    bool has_thrown = false;
    for (const auto deadline = std::chrono::steady_clock::now() + 20s; !has_thrown && std::chrono::steady_clock::now() < deadline;) {
        try {
            nodes.executor.spin_some(10ms);
        } catch (const std::range_error &) {
            has_thrown = true;
        }
    }
    CHECK(has_thrown);
}

int main(int argc, char **argv)
{
    rclcpp::init(argc, argv);
    for (const bool intra_process : {false, true}) {
        test_poses_arrive<AdaptedPose, Pose, AdaptedPose, Pose>(intra_process);
        test_poses_arrive<AdaptedPose, Pose, RosPose, RosPose>(intra_process);
        test_poses_arrive<AdaptedPose, RosPose, AdaptedPose, Pose>(intra_process);
        test_poses_arrive<AdaptedPose, RosPose, RosPose, RosPose>(intra_process);
        test_poses_arrive<RosPose, RosPose, AdaptedPose, Pose>(intra_process);
        test_poses_arrive<RosPose, RosPose, RosPose, RosPose>(intra_process);
        test_misfit_does_not_throw<RosJoints, RosJoints>(intra_process);
        test_misfit_does_not_throw<AdaptedJoints, RosJoints>(intra_process);
    }
    test_misfit_throws_on_request();
    std::_Exit(0);
}
