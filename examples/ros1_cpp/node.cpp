// A ROS 1 node that forwards the robot's position to the PLC and the belt's speed to ROS, like the node in the paper.
#include "shm_msgs/geometry_msgs/msg/point_stamped.hpp"
#include "shm_msgs/std_msgs/msg/float64.hpp"

#include <geometry_msgs/PointStamped.h>
#include <ros/ros.h>
#include <std_msgs/Float64.h>

namespace {

constexpr char ROBOT[] = "/shmgen_node/robot"; // the name of the region and of the ROS topic
constexpr char SPEED[] = "/shmgen_node/speed";

shm_msgs::geometry_msgs::msg::PointStamped for_plc(const geometry_msgs::PointStamped &from)
{
    shm_msgs::geometry_msgs::msg::PointStamped to;
    to.header.stamp = std::chrono::nanoseconds(from.header.stamp.toNSec());
    to.header.frame_id = from.header.frame_id;
    to.point.x = from.point.x;
    to.point.y = from.point.y;
    to.point.z = from.point.z;
    return to;
}

} // namespace

int main(int count, char **words)
{
    ros::init(count, words, "cell");
    ros::NodeHandle node;
    shm_msgs::geometry_msgs::msg::PointStampedPublisher to_plc(ROBOT);
    shm_msgs::std_msgs::msg::Float64Subscriber from_plc(SPEED);

    const ros::Publisher speed = node.advertise<std_msgs::Float64>(SPEED, 1, true);
    const ros::Subscriber robot = node.subscribe<geometry_msgs::PointStamped>(
        ROBOT, 10, [&to_plc](const geometry_msgs::PointStamped::ConstPtr &message) {
            if (const shmgen::Status status = to_plc.publish(for_plc(*message)); !status)
                ROS_WARN_THROTTLE(1.0, "%s %s", to_plc.rejected().data(), status.text());
        });

    ROS_INFO("running");
    for (ros::Rate rate(200); ros::ok(); rate.sleep()) {
        ros::spinOnce();
        if (const auto sample = from_plc.read()) {
            std_msgs::Float64 message;
            message.data = sample->data;
            speed.publish(message);
        }
    }
}
