// In place of ros2_control's manager: configures the plugin of ros2_controller.cpp, gives it readings
// from standard input, and prints torques.
//
//     ros2_manager CONTROLLER RATE ARMS JOINTS_OF_AN_ARM FORCES BARS
//
// Standard input: X_WD, alpha_d, squeeze_d, then readings, as doubles; NaN: one that cannot be had.
#include <cmath>
#include <cstdlib>

#include "controller_interface/controller_interface.hpp"

std::shared_ptr<controller_interface::ControllerInterface> load_plugin();

using controller_interface::CallbackReturn;
using hardware_interface::Interface;

int main(int, char** words) {
  std::vector<std::string> joints, sensors;
  for (int arm = 0; arm < std::atoi(words[3]); arm++) {
    sensors.push_back("wrist" + std::to_string(arm));
    for (int i = 0; i < std::atoi(words[4]); i++)
      joints.push_back("arm" + std::to_string(arm) + "_" + std::to_string(i));
  }
  const auto forces = static_cast<size_t>(std::atoi(words[5]));
  const auto bars = static_cast<size_t>(std::atoi(words[6]));
  std::vector<double> X(16), alpha(forces), squeeze(bars);
  for (auto* x : {&X, &alpha, &squeeze})
    if (std::fread(x->data(), 8, x->size(), stdin) != x->size()) return 3;
  const auto plugin = load_plugin();
  const rclcpp_lifecycle::State state;
  const auto init = plugin->init(
      {{"controller_file", words[1]},
       {"joints", joints},
       {"sensors", sensors},
       {"X_WD", X},
       {"alpha_d", alpha},
       {"squeeze_d", squeeze}},
      static_cast<unsigned>(std::atoi(words[2])));
  if (init != CallbackReturn::SUCCESS) return 4;
  if (plugin->on_configure(state) != CallbackReturn::SUCCESS) return 1;
  std::vector<std::shared_ptr<Interface>> inputs, outputs;
  std::vector<hardware_interface::LoanedCommandInterface> commands;
  std::vector<hardware_interface::LoanedStateInterface> states;
  for (const auto& name : plugin->command_interface_configuration().names)
    commands.emplace_back(outputs.emplace_back(new Interface{name, {}}));
  for (const auto& name : plugin->state_interface_configuration().names)
    states.emplace_back(inputs.emplace_back(new Interface{name, {}}));
  for (const auto& one : outputs) std::fprintf(stderr, "%s ", one->name.c_str());
  for (const auto& one : inputs) std::fprintf(stderr, "%s ", one->name.c_str());
  plugin->assign_interfaces(std::move(commands), std::move(states));
  if (plugin->on_activate(state) != CallbackReturn::SUCCESS) return 5;
  std::vector<double> row(inputs.size());
  while (std::fread(row.data(), 8, row.size(), stdin) == row.size()) {
    for (size_t i = 0; i < row.size(); i++)
      inputs[i]->value = std::isnan(row[i]) ? std::nullopt : std::optional<double>(row[i]);
    if (plugin->update({}, {}) != controller_interface::return_type::OK) return 6;
    for (const auto& one : outputs) std::fwrite(&*one->value, 8, 1, stdout);
  }
  if (plugin->on_deactivate(state) != CallbackReturn::SUCCESS) return 7;
  for (const auto& one : outputs) std::fwrite(&*one->value, 8, 1, stdout);
  return 0;
}
