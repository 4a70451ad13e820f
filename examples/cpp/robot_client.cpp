// SPDX-License-Identifier: Apache-2.0
// Use the pose of a bone while it is valid and accurate enough: replace start and stop by a motion.
#include <memory>
#include <string>
#include "gsdf_registration_msgs/msg/registration_result.hpp"
#include "rclcpp/rclcpp.hpp"
using gsdf_registration_msgs::msg::RegistrationResult;
class Robot : public rclcpp::Node
{
public:
  Robot()
  : Node("robot"), max_tre_(declare_parameter("max_tre", 0.001)),     // m
    grades_(declare_parameter("grades", std::string("AB")))
  {
    const auto qos = rclcpp::QoS(1).reliable().transient_local().liveliness(  // notices a kill
      rclcpp::LivelinessPolicy::Automatic).liveliness_lease_duration(std::chrono::seconds(3));
    rclcpp::SubscriptionOptions options;
    options.event_callbacks.liveliness_callback =
      [this](auto & event) {if (event.alive_count == 0) {stop("the registration node is gone");}};
    timer_ = create_wall_timer(std::chrono::milliseconds(100), [this]() {
        if (count_publishers("registration/result") == 0) {stop("the registration node is gone");}
      });
    subscription_ = create_subscription<RegistrationResult>(
      "registration/result", qos, [this](const RegistrationResult & result) {
        const std::string reason = problem(result);
        stop(reason.empty() ? "the bone was registered again" : reason);
        if (reason.empty()) {start(result);}
      }, options);
  }
private:
  std::string problem(const RegistrationResult & result) const
  {
    if (!result.valid) {return result.message;}
    const bool graded = !result.grade.empty() && grades_.find(result.grade) != std::string::npos;
    if (!graded) {return "grade \"" + result.grade + "\" is not one of " + grades_;}
    bool good = !result.target_tre.empty() || result.tre_max <= max_tre_;
    for (const double error : result.target_tre) {good = good && error <= max_tre_;}  // not if NaN
    return good ? "" : "the predicted error at a target exceeds max_tre";
  }
  void start(const RegistrationResult & result)
  {
    moving_ = true;
    RCLCPP_INFO(get_logger(), "start: registration %u", result.registration_id);
  }
  void stop(const std::string & reason)
  {
    if (moving_) {RCLCPP_INFO(get_logger(), "stop: %s", reason.c_str());}
    moving_ = false;
  }
  double max_tre_;
  std::string grades_;
  bool moving_ = false;
  rclcpp::Subscription<RegistrationResult>::SharedPtr subscription_;
  rclcpp::TimerBase::SharedPtr timer_;
};
int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<Robot>());
}
