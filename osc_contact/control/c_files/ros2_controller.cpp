/* A ros2_control plugin around a controller file, for ros2_control 4.46 (Jazzy).
 *
 * Parameters: controller_file; joints and sensors in the order of the controller's chain, one
 * force-torque sensor for each arm; X_WD, the desired pose of the object, 4 × 4 by rows; alpha_d, the
 * desired forces (none: contacts are not engaged); squeeze_d, internal forces (none: 0). The set point
 * is constant: an application adds a subscriber that hands X_WD_ and its rates to update through a
 * buffer of realtime_tools. After a safe stop the torques stay safe until the next activation. */
#include "osc_controller.h"

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "hardware_interface/types/hardware_interface_type_values.hpp"
#include "pluginlib/class_list_macros.hpp"

namespace osc_contact {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::return_type;

class HybridController : public controller_interface::ControllerInterface {
 public:
  CallbackReturn on_init() override {
    auto_declare<std::string>("controller_file", "");
    auto_declare<std::vector<std::string>>("joints", {});
    auto_declare<std::vector<std::string>>("sensors", {});
    auto_declare<std::vector<double>>("X_WD", {});
    auto_declare<std::vector<double>>("alpha_d", {});
    auto_declare<std::vector<double>>("squeeze_d", {});
    return CallbackReturn::SUCCESS;
  }

  InterfaceConfiguration command_interface_configuration() const override {
    return individual(named(joints_, {hardware_interface::HW_IF_EFFORT}));
  }

  // All positions, all velocities, then each sensor's six numbers, as update reads them.
  InterfaceConfiguration state_interface_configuration() const override {
    std::vector<std::string> names = named(joints_, {hardware_interface::HW_IF_POSITION});
    const auto velocities = named(joints_, {hardware_interface::HW_IF_VELOCITY});
    const auto wrenches = named(
        sensors_, {"force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z"});
    names.insert(names.end(), velocities.begin(), velocities.end());
    names.insert(names.end(), wrenches.begin(), wrenches.end());
    return individual(std::move(names));
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State&) override {
    const auto node = get_node();
    joints_ = node->get_parameter("joints").as_string_array();
    sensors_ = node->get_parameter("sensors").as_string_array();
    X_WD_ = node->get_parameter("X_WD").as_double_array();
    alpha_d_ = node->get_parameter("alpha_d").as_double_array();
    squeeze_d_ = node->get_parameter("squeeze_d").as_double_array();
    osc_controller* made = nullptr;
    const int code = osc_create(node->get_parameter("controller_file").as_string().c_str(), &made);
    controller_.reset(made);
    if (code != OSC_DONE) return refuse(osc_error_text(code));
    osc_get_dimensions(made, &n_);
    if (n_.motors != n_.joints) return refuse("passive joints have no effort interface");
    if (joints_.size() != n_.joints || sensors_.size() != n_.arms || X_WD_.size() != 16 ||
        (!alpha_d_.empty() && alpha_d_.size() != n_.forces) ||
        (!squeeze_d_.empty() && squeeze_d_.size() != n_.bars))
      return refuse("joints, sensors, X_WD, alpha_d or squeeze_d do not fit the controller");
    if (std::abs(n_.period * get_update_rate() - 1.0) > 1e-6)
      return refuse("the update rate is not the controller's");
    readings_.assign(2 * n_.joints + 6 * n_.arms, 0.0);
    torques_.assign(n_.motors, 0.0);
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State&) override {
    osc_reset(controller_.get());
    return CallbackReturn::SUCCESS;
  }

  // What no effort means, the hardware decides: arms that do not hold themselves need their brakes.
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State&) override {
    bool sent = true;
    for (auto& effort : command_interfaces_) sent &= effort.set_value(0.0);
    return sent ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
  }

  // Readings that cannot be had are NaN: such a tick is held, with safe torques.
  return_type update(const rclcpp::Time&, const rclcpp::Duration&) override {
    for (size_t i = 0; i < readings_.size(); i++)
      readings_[i] = state_interfaces_[i].get_optional().value_or(
          std::numeric_limits<double>::quiet_NaN());
    const double* at = readings_.data();
    const osc_measurement m = {{at, n_.joints}, {at + n_.joints, n_.joints},
                               {at + 2 * n_.joints, 6 * n_.arms}, {nullptr, 0}, 0, 0, 0, -1};
    const osc_reference r = {{X_WD_.data(), 16}, {kRest, 6}, {kRest, 6},
                             {alpha_d_.data(), alpha_d_.size()},
                             {squeeze_d_.data(), squeeze_d_.size()}, {nullptr, 0}};
    osc_command out = {torques_.data(), torques_.size(), 0, 0, 0, 0, 0, 0};
    if (osc_tick(controller_.get(), &m, &r, &out) != OSC_DONE) return return_type::ERROR;
    bool sent = true;
    for (size_t i = 0; i < torques_.size(); i++) sent &= command_interfaces_[i].set_value(torques_[i]);
    return sent ? return_type::OK : return_type::ERROR;
  }

 private:
  static constexpr double kRest[6] = {};

  struct Destroy {
    void operator()(osc_controller* c) const { osc_destroy(c); }
  };

  static InterfaceConfiguration individual(std::vector<std::string> names) {
    return {controller_interface::interface_configuration_type::INDIVIDUAL, std::move(names)};
  }

  static std::vector<std::string> named(
      const std::vector<std::string>& parts, const std::vector<std::string>& interfaces) {
    std::vector<std::string> names;
    for (const auto& part : parts)
      for (const auto& one : interfaces) names.push_back(part + "/" + one);
    return names;
  }

  CallbackReturn refuse(const char* why) {
    RCLCPP_ERROR(get_node()->get_logger(), "%s", why);
    return CallbackReturn::FAILURE;
  }

  std::unique_ptr<osc_controller, Destroy> controller_;
  osc_dimensions n_{};
  std::vector<std::string> joints_, sensors_;
  std::vector<double> X_WD_, alpha_d_, squeeze_d_, readings_, torques_;
};

}  // namespace osc_contact

PLUGINLIB_EXPORT_CLASS(osc_contact::HybridController, controller_interface::ControllerInterface)
