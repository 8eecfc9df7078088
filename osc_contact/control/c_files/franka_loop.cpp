/* A Franka arm held by a controller without Python, over libfranka 0.15 or later:
 *
 *     franka_loop HOST CONTROLLER SECONDS [norealtime]
 *
 * The robot adds the weight of its model and of its load by itself, and its estimate of the wrench is
 * without weight: the controller is made of a chain without gravity. One that compensates weight is
 * refused. World, object and wrist sensor of its chain are the robot's base O, end effector EE and
 * stiffness frame K. */
#include "osc_controller.h"

#include <franka/robot.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <limits>
#include <memory>
#include <stdexcept>

namespace {

constexpr double kTorqueStep = 0.99;     // N m; the robot refuses changes by 1 N m in a millisecond
constexpr double kWeightless = 0.1;      // N m
constexpr double kLift = 0.02;           // m, of the motion
constexpr double kAngularRate = 1.5708;  // rad/s, of the motion

using Controller = std::unique_ptr<osc_controller, decltype(&osc_destroy)>;
using Joints = std::array<double, 7>;

void require(int error) {
  if (error != OSC_DONE) throw std::runtime_error(osc_error_text(error));
}

Controller load(const char* path) {
  osc_controller* made = nullptr;
  require(osc_create(path, &made));
  Controller c(made, &osc_destroy);
  osc_dimensions n;
  require(osc_get_dimensions(made, &n));
  if (n.joints != 7 || n.motors != 7 || n.arms != 1 || n.forces != 0 || std::abs(n.period - 1e-3) > 1e-9)
    throw std::runtime_error("a Franka needs a controller of one arm of 7 joints, 1 kHz, no contacts");
  return c;
}

// The end effector rises and returns, from where it was at the start.
struct Motion {
  explicit Motion(const std::array<double, 16>& O_T_EE) {
    for (size_t i = 0; i < 16; i++) X[4 * (i % 4) + i / 4] = O_T_EE[i];  // columns become rows
    height = X[11];
  }

  osc_reference at(double t) {
    const double w = kAngularRate;
    X[11] = height + kLift * (1.0 - std::cos(w * t)) / 2.0;
    V[2] = kLift * w * std::sin(w * t) / 2.0;
    A[2] = kLift * w * w * std::cos(w * t) / 2.0;
    return {{X.data(), 16}, {V.data(), 6}, {A.data(), 6}, {nullptr, 0}, {nullptr, 0}, {nullptr, 0}};
  }

  std::array<double, 16> X{};
  std::array<double, 6> V{}, A{};
  double height;
};

osc_command tick(osc_controller* c, const franka::RobotState& state, const osc_reference& r, Joints& tau) {
  const osc_measurement m = {
      {state.q.data(), 7}, {state.dq.data(), 7}, {state.K_F_ext_hat_K.data(), 6}, {nullptr, 0}, 0, 0, 0, 0};
  osc_command out = {tau.data(), tau.size(), 0, 0, 0, 0, 0, 0};
  require(osc_tick(c, &m, &r, &out));
  return out;
}

// A tick without a reference is held: at rest its torques are the weight of the controller's model.
void require_weightless(const char* path, franka::RobotState state) {
  state.dq = {};
  const Controller c = load(path);
  Joints tau{};
  Motion nowhere(state.O_T_EE);
  nowhere.height = std::numeric_limits<double>::quiet_NaN();
  tick(c.get(), state, nowhere.at(0.0), tau);
  for (double x : tau)
    if (!(std::abs(x) < kWeightless))
      throw std::runtime_error("the controller compensates weight, which the robot adds by itself");
}

// Towards the torques, on a line and as far as the robot permits.
void step_from(const Joints& last, Joints& tau) {
  double most = kTorqueStep;
  for (size_t i = 0; i < 7; i++) most = std::max(most, std::abs(tau[i] - last[i]));
  for (size_t i = 0; i < 7; i++) tau[i] = last[i] + (tau[i] - last[i]) * kTorqueStep / most;
}

void run(const char* host, const char* path, double seconds, franka::RealtimeConfig realtime) {
  const Controller c = load(path);
  franka::Robot robot(host, realtime);
  robot.setCollisionBehavior({{40, 40, 40, 40, 40, 40, 40}}, {{40, 40, 40, 40, 40, 40, 40}},
                             {{60, 60, 60, 20, 20, 20}}, {{60, 60, 60, 20, 20, 20}});
  const franka::RobotState start = robot.readOnce();
  require_weightless(path, start);
  Motion motion(start.O_T_EE);
  double t = 0.0;
  osc_command last = {};
  robot.control(
      [&](const franka::RobotState& now, franka::Duration period) -> franka::Torques {
        Joints tau{};
        t += period.toSec();  // longer where packets were lost
        last = tick(c.get(), now, motion.at(t), tau);
        step_from(now.tau_J_d, tau);
        const franka::Torques torques(tau);
        const bool ends = t >= seconds || last.state == OSC_STATE_SAFE_STOP;
        return ends ? franka::MotionFinished(torques) : torques;
      },
      false, franka::kMaxCutoffFrequency);  // no filter: the steps are limited above
  if (last.state != OSC_STATE_SAFE_STOP) std::printf("%.3f s, done\n", t);
  else std::printf("%.3f s, safe stop; cause %d of enum osc_reason\n", t, last.cause);
}

}  // namespace

int main(int count, char** words) {
  const bool simulated = count == 5 && std::strcmp(words[4], "norealtime") == 0;
  if (count != 4 && !simulated) {
    std::fprintf(stderr, "franka_loop HOST CONTROLLER SECONDS [norealtime]\n");
    return 2;
  }
  const auto realtime = simulated ? franka::RealtimeConfig::kIgnore : franka::RealtimeConfig::kEnforce;
  try {
    run(words[1], words[2], std::atof(words[3]), realtime);
  } catch (const std::exception& error) {  // franka::Exception is one
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
