// What ros2_controller.cpp uses of ros2_control 4.46.0 and rclcpp 28.3, with its signatures. Besides
// them, `init` takes the parameters and interfaces are plain numbers that may be missing.
#pragma once
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#define RCLCPP_ERROR(logger, ...) \
  (std::fprintf(stderr, "%s: ", (logger).get_name()), std::fprintf(stderr, __VA_ARGS__))

namespace rclcpp {
class Time {};
class Duration {};
class Logger {
 public:
  const char* get_name() const { return "test"; }
};
using ParameterValue = std::variant<std::string, std::vector<std::string>, std::vector<double>>;
class Parameter {
 public:
  explicit Parameter(const ParameterValue& value) : value_(value) {}
  template <typename T>
  decltype(auto) get_value() const { return std::get<T>(value_); }
  const std::string& as_string() const { return std::get<0>(value_); }
  const std::vector<std::string>& as_string_array() const { return std::get<1>(value_); }
  const std::vector<double>& as_double_array() const { return std::get<2>(value_); }

 private:
  ParameterValue value_;
};
}  // namespace rclcpp

namespace rclcpp_lifecycle {
class State {};
class LifecycleNode {
 public:
  std::map<std::string, rclcpp::ParameterValue> overrides, declared;
  rclcpp::Logger get_logger() const { return {}; }
  bool has_parameter(const std::string& name) const { return declared.count(name) > 0; }
  rclcpp::Parameter get_parameter(const std::string& name) const {
    return rclcpp::Parameter(declared.at(name));
  }
  template <typename ParameterT>
  auto declare_parameter(const std::string& name, const ParameterT& default_value) {
    const auto given = overrides.find(name);
    declared[name] = given == overrides.end() ? rclcpp::ParameterValue(default_value) : given->second;
    return std::get<ParameterT>(declared[name]);
  }
};
namespace node_interfaces {
class LifecycleNodeInterface {
 public:
  enum class CallbackReturn : uint8_t { SUCCESS = 97, FAILURE = 98, ERROR = 99 };
  virtual CallbackReturn on_configure(const State&) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_cleanup(const State&) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_activate(const State&) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_deactivate(const State&) { return CallbackReturn::SUCCESS; }
  virtual ~LifecycleNodeInterface() {}
};
}  // namespace node_interfaces
}  // namespace rclcpp_lifecycle

namespace hardware_interface {
struct Interface {
  std::string name;
  std::optional<double> value;
};
class LoanedStateInterface {
 public:
  explicit LoanedStateInterface(std::shared_ptr<const Interface> state) : state_(std::move(state)) {}
  LoanedStateInterface(const LoanedStateInterface&) = delete;
  LoanedStateInterface(LoanedStateInterface&&) = default;
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int = 10) const { return state_->value; }

 private:
  std::shared_ptr<const Interface> state_;
};
class LoanedCommandInterface {
 public:
  explicit LoanedCommandInterface(std::shared_ptr<Interface> command) : command_(std::move(command)) {}
  LoanedCommandInterface(const LoanedCommandInterface&) = delete;
  LoanedCommandInterface(LoanedCommandInterface&&) = default;
  template <typename T>
  [[nodiscard]] bool set_value(const T& value, unsigned int = 10) {
    command_->value = value;
    return true;
  }

 private:
  std::shared_ptr<Interface> command_;
};
}  // namespace hardware_interface

namespace controller_interface {
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;
enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class interface_configuration_type : std::uint8_t {
  ALL = 0,
  INDIVIDUAL = 1,
  NONE = 2,
  INDIVIDUAL_BEST_EFFORT = 3,
  REGEX = 10
};
struct InterfaceConfiguration {
  interface_configuration_type type = interface_configuration_type::NONE;
  std::vector<std::string> names = {};
};

class ControllerInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface {
 public:
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual void assign_interfaces(
      std::vector<hardware_interface::LoanedCommandInterface>&& command_interfaces,
      std::vector<hardware_interface::LoanedStateInterface>&& state_interfaces) {
    command_interfaces_ = std::move(command_interfaces);
    state_interfaces_ = std::move(state_interfaces);
  }
  virtual CallbackReturn on_init() = 0;
  virtual return_type update(const rclcpp::Time& time, const rclcpp::Duration& period) = 0;
  CallbackReturn init(std::map<std::string, rclcpp::ParameterValue> parameters, unsigned int rate) {
    node_->overrides = std::move(parameters);
    update_rate_ = rate;
    return on_init();
  }
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }
  unsigned int get_update_rate() const { return update_rate_; }
  template <typename ParameterT>
  auto auto_declare(const std::string& name, const ParameterT& default_value) {
    if (!get_node()->has_parameter(name))
      return get_node()->template declare_parameter<ParameterT>(name, default_value);
    return ParameterT(get_node()->get_parameter(name).template get_value<ParameterT>());
  }

 protected:
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

 private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ =
      std::make_shared<rclcpp_lifecycle::LifecycleNode>();
  unsigned int update_rate_ = 0;
};
}  // namespace controller_interface
