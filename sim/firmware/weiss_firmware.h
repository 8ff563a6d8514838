#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sim/firmware/firmware.h"
#include "sim/firmware/reply_queue.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct WeissSettings {
  bool simserv = true;  ///< False: it speaks ASCII-2 only.
  bool ascii2 = true;
  std::string model = "LabEvent T/110/70/5";
  std::string serial_number = "58226211230010";
  int address = 1;
  double least_set_degc = -77.0;
  double most_set_degc = 182.0;
  int pause_output = 3;       ///< Digital channel that pauses the compressor.
  bool external_mode = true;  ///< Enabled at the panel; else nothing is carried out.
  Clock::Duration reply_delay = std::chrono::milliseconds(5);
};

/// A Weiss or Voetsch chamber: S!MPAC simserv and ASCII-2 on one port (docs/protocols/weiss_simserv.md;
/// [unverified against a device]), heating and cooling the air of a SimBench.
class WeissFirmware final : public Firmware {
 public:
  explicit WeissFirmware(std::shared_ptr<SimBench> bench, WeissSettings settings = {});

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override { return replies_.take(now); }
  std::optional<Clock::Instant> next_due() const override { return replies_.next_due(); }
  void session_starts() override;
  std::shared_ptr<Firmware> another_session() override;
  void power(bool on, Clock::Instant now) override;

 private:
  struct State {
    double set_degc = 23.0;
    double set_humidity = 0.0;
    double up = 0.0, down = 0.0;  ///< K/min; 0: as fast as it can.
    std::string channels = std::string(32, '0');
  };
  using Words = std::vector<std::string>;

  std::string answer(const std::string& line, Clock::Instant now);
  std::string simserv(const Words& words, Clock::Instant now);
  std::string ask_simserv(int number, int which, Clock::Instant now) const;
  std::string set_simserv(int number, const Words& words, Clock::Instant now);
  std::string ascii2(const std::string& line, Clock::Instant now);
  std::string set_ascii2(const std::string& line, Clock::Instant now);
  std::string description() const;
  bool is_on(int channel) const { return state_->channels.at(static_cast<std::size_t>(channel)) == '1'; }
  void command(Clock::Instant now);

  std::shared_ptr<SimBench> bench_;
  WeissSettings settings_;
  std::shared_ptr<State> state_;
  ReplyQueue replies_;
  std::string received_;
};

}  // namespace abcal::sim
