#pragma once

#include <cmath>
#include <cstdlib>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/text/text.h"
#include "sim/firmware/firmware.h"
#include "sim/firmware/reply_queue.h"
#include "sim/sim_bench.h"

namespace abcal::test {

/// The made-up controller RT-2, written from its manual and not from its description: each command, the lost
/// ones within 50 ms of a reply, servos, references, the emergency chain.
class Rt2Controller final : public sim::Firmware {
 public:
  explicit Rt2Controller(std::shared_ptr<sim::SimBench> bench) : bench_(std::move(bench)) {}

  bool chain_open = false;
  bool moves_on_servo = false;  ///< A fault: a demand that stands is moved to when the servo is switched on.
  std::size_t lost = 0;
  std::vector<std::string> commands;

  void receive(std::string_view bytes, Clock::Instant now) override {
    for (const char c : bytes) {
      if (c != '\r') {
        line_ += c;
        continue;
      }
      const std::string command = std::exchange(line_, {});
      if (last_reply_ && now < *last_reply_ + std::chrono::milliseconds(50)) {
        ++lost;
        continue;
      }
      commands.push_back(command);
      replies_.push(answer(command, now) + "\r\n", now + std::chrono::milliseconds(2));
      last_reply_ = now + std::chrono::milliseconds(2);
    }
  }
  std::string transmit(Clock::Instant now) override { return replies_.take(now); }
  std::optional<Clock::Instant> next_due() const override { return replies_.next_due(); }

  void open_chain(Clock::Instant now) {
    chain_open = true;
    for (const char axis : {'O', 'I'}) {
      bench_->halt(of(axis), now);
      servo_[axis] = false;
    }
  }

 private:
  static StageAxis of(char axis) { return axis == 'O' ? StageAxis::kX : StageAxis::kZ; }

  std::string answer(const std::string& command, Clock::Instant now) {
    const auto words = pieces::words(command);
    if (words.empty()) return "- 01 empty";
    if (command == "ID") return "+ RT-2 sn=00412 fw=3.07";
    if (command == "HA") {
      for (const char axis : {'O', 'I'}) bench_->halt(of(axis), now);
      return "+";
    }
    if (words.size() < 2 || (words[1] != "O" && words[1] != "I")) return "- 02 syntax";
    const char axis = words[1][0];
    const std::string_view what = words[0];
    const bool has_number = words.size() == 3;
    char* end = nullptr;
    const std::string third = has_number ? std::string(words[2]) : "";
    const double number = std::strtod(third.c_str(), &end);
    if (words.size() > 3 || (has_number && *end != '\0')) return "- 02 syntax";
    if (what == "SV" && has_number) {
      if (chain_open) return "- 14 emergency chain";
      servo_[axis] = number != 0.0;
      if (moves_on_servo) bench_->move(of(axis), Angle::degrees(30.0), now);
      return "+";
    }
    if (what == "RF") {
      if (!servo_[axis]) return "- 11 servo off";
      bench_->move(of(axis), Angle{}, now);
      referenced_[axis] = true;
      return "+";
    }
    if (what == "ST") return status(axis, now);
    if (what == "PO") {
      char text[32];
      double angle = bench_->encoder_angle(of(axis), now).deg();
      angle -= 360.0 * std::floor(angle / 360.0);
      std::snprintf(text, sizeof text, "+ %.4f", angle);
      return text;
    }
    sim::MotionLimits limits = bench_->motion_limits(of(axis));
    if (what == "VE" && !has_number) return "+ " + std::to_string(limits.speed_deg_per_s);
    if (what == "VE") {
      if (number < 0.01 || number > 120.0) return "- 13 out of range";
      limits.speed_deg_per_s = number;
      bench_->set_motion_limits(of(axis), limits);
      return "+";
    }
    if (what != "GO" || !has_number) return "- 02 syntax";
    if (chain_open) return "- 14 emergency chain";
    if (!servo_[axis]) return "- 11 servo off";
    if (!referenced_[axis]) return "- 12 not referenced";
    if (number < 0.0 || number >= 360.0) return "- 13 out of range";
    const double here = bench_->commanded_angle(of(axis), now).deg();
    bench_->move(of(axis), Angle::degrees(here + std::remainder(number - here, 360.0)), now);
    return "+";
  }

  std::string status(char axis, Clock::Instant now) {
    unsigned bits = 0;
    const bool moving = bench_->moving(of(axis), now);
    if (servo_[axis]) bits |= 1U;
    if (moving) bits |= 2U;
    if (referenced_[axis] && !moving) bits |= 4U;
    if (!moving) bits |= 8U;
    if (chain_open) bits |= 0x100U;
    char text[16];
    std::snprintf(text, sizeof text, "+ %04X", bits);
    return text;
  }

  std::shared_ptr<sim::SimBench> bench_;
  std::string line_;
  sim::ReplyQueue replies_;
  std::optional<Clock::Instant> last_reply_;
  std::map<char, bool> servo_, referenced_;
};

}  // namespace abcal::test
