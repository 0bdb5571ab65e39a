// A ROS 1 node that forwards the robot's position to the PLC and the belt's speed to ROS. The ROS node in the paper
// "Bridging Automation and Robotics" does the same.
#include "shm_msgs/geometry_msgs/msg/point_stamped.hpp"
#include "shm_msgs/std_msgs/msg/float64.hpp"

#include <geometry_msgs/PointStamped.h>
#include <ros/ros.h>
#include <std_msgs/Float64.h>

namespace {

constexpr char ROBOT_TOPIC[] = "/shmgen_node/robot"; // the name of the ROS topic and of the region in shared memory
constexpr char SPEED_TOPIC[] = "/shmgen_node/speed";

shm_msgs::geometry_msgs::msg::PointStamped to_plc_message(const geometry_msgs::PointStamped &ros_message)
{
    shm_msgs::geometry_msgs::msg::PointStamped plc_message;
    plc_message.header.stamp = std::chrono::nanoseconds(ros_message.header.stamp.toNSec());
    plc_message.header.frame_id = ros_message.header.frame_id;
    plc_message.point.x = ros_message.point.x;
    plc_message.point.y = ros_message.point.y;
    plc_message.point.z = ros_message.point.z;
    return plc_message;
}

} // namespace

int main(int argc, char **argv)
{
    ros::init(argc, argv, "cell");
    ros::NodeHandle node;
    shm_msgs::geometry_msgs::msg::PointStampedPublisher to_plc(ROBOT_TOPIC);
    shm_msgs::std_msgs::msg::Float64Subscriber from_plc(SPEED_TOPIC);

    const ros::Publisher to_ros = node.advertise<std_msgs::Float64>(SPEED_TOPIC, 1, true);
    const ros::Subscriber from_ros = node.subscribe<geometry_msgs::PointStamped>(
        ROBOT_TOPIC, 10, [&to_plc](const geometry_msgs::PointStamped::ConstPtr &message) {
            if (const shmgen::Status status = to_plc.publish(to_plc_message(*message)); !status)
                ROS_WARN_THROTTLE(1.0, "%s %s", to_plc.rejected().data(), status.text());
        });

    ROS_INFO("running");
    for (ros::Rate rate(200); ros::ok(); rate.sleep()) { // Hz
        ros::spinOnce();
        if (const auto sample = from_plc.read()) {
            std_msgs::Float64 message;
            message.data = sample->data;
            to_ros.publish(message);
        }
    }
}
