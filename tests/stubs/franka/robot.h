// What franka_loop.cpp uses of libfranka 0.15.0, with its signatures. This robot plays the states of
// the file that its address names: q, dq, O_T_EE, K_F_ext_hat_K, 36 numbers each, one a millisecond.
// The torques it gets are appended to the same name with .torques, each with motion_finished.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

namespace franka {

constexpr double kMaxCutoffFrequency = 1000.0;
constexpr double kDefaultCutoffFrequency = 100.0;

enum class RealtimeConfig { kEnforce, kIgnore };

class Duration {
 public:
  explicit Duration(uint64_t milliseconds) noexcept : milliseconds_(milliseconds) {}
  double toSec() const noexcept { return 1e-3 * static_cast<double>(milliseconds_); }

 private:
  uint64_t milliseconds_;
};

struct Finishable {
  bool motion_finished = false;
};

class Torques : public Finishable {
 public:
  Torques(const std::array<double, 7>& torques) noexcept : tau_J(torques) {}
  std::array<double, 7> tau_J{};
};

inline Torques MotionFinished(Torques command) noexcept {
  command.motion_finished = true;
  return command;
}

struct RobotState {
  std::array<double, 16> O_T_EE{};
  std::array<double, 7> tau_J_d{};
  std::array<double, 7> q{};
  std::array<double, 7> dq{};
  std::array<double, 6> K_F_ext_hat_K{};
};

class Robot {
 public:
  explicit Robot(const std::string& franka_address,
                 RealtimeConfig = RealtimeConfig::kEnforce, size_t = 50)
      : name_(franka_address) {
    std::FILE* stream = std::fopen(name_.c_str(), "rb");
    std::array<double, 36> row;
    while (stream != nullptr && std::fread(row.data(), sizeof row, 1, stream) == 1) rows_.push_back(row);
    if (stream != nullptr) std::fclose(stream);
    if (rows_.empty()) throw std::runtime_error("no robot at this address");
  }

  void setCollisionBehavior(const std::array<double, 7>&, const std::array<double, 7>&,
                            const std::array<double, 6>&, const std::array<double, 6>&) {}

  virtual RobotState readOnce() { return state(0); }
  virtual ~Robot() noexcept = default;

  void control(std::function<Torques(const RobotState&, franka::Duration)> control_callback,
               bool limit_rate = false, double cutoff_frequency = kDefaultCutoffFrequency) {
    if (limit_rate || cutoff_frequency < kMaxCutoffFrequency)
      throw std::invalid_argument("this robot has no filters");
    std::FILE* stream = std::fopen((name_ + ".torques").c_str(), "wb");
    bool finished = false;
    for (size_t i = 0; i < rows_.size() && !finished; i++) {
      const Torques sent = control_callback(state(i), Duration(i > 0));
      last_ = sent.tau_J;
      finished = sent.motion_finished;
      const double end = finished;
      std::fwrite(last_.data(), sizeof last_, 1, stream);
      std::fwrite(&end, sizeof end, 1, stream);
    }
    std::fclose(stream);
    if (!finished) throw std::runtime_error("the motion did not end");
  }

 private:
  RobotState state(size_t i) const {
    RobotState s;
    const double* at = rows_[i].data();
    std::copy_n(at, 7, s.q.begin());
    std::copy_n(at + 7, 7, s.dq.begin());
    std::copy_n(at + 14, 16, s.O_T_EE.begin());
    std::copy_n(at + 30, 6, s.K_F_ext_hat_K.begin());
    s.tau_J_d = last_;
    return s;
  }

  std::string name_;
  std::vector<std::array<double, 36>> rows_;
  std::array<double, 7> last_{};
};

}  // namespace franka
