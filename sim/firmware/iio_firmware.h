#pragma once

#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct IioSettings {
  std::string name = "adis16485";
  std::string serial_number = "0x2a51";
  std::string version = "0.24.v0.24  ";  ///< Version reply of the iiod: its release in seven characters.
  double rate_hz = 123.0;                ///< At power on.
  double highest_rate_hz = 4000.0;
  bool knows_triggers = true;  ///< False: its server refuses GETTRIG and SETTRIG, as libtinyiiod does.
  Clock::Duration reply_delay = std::chrono::microseconds(200);
};

/// A machine with Linux whose iiod serves one inertial sensor of its Industrial I/O (docs/protocols/iiod.md):
/// accelerometer and gyroscope in one buffer with time stamps, a trigger of its own, calibbias and calibscale
/// of the accelerometer, which act on its output. Reads the world of a SimBench; its output unit R is m/s2.
/// Serves any number of clients. [unverified against a device] which rates it has: here any.
class IioFirmware final : public Firmware {
 public:
  explicit IioFirmware(std::shared_ptr<SimBench> bench, const IioSettings& settings = {});
  ~IioFirmware() override;

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void session_starts() override;
  void power(bool on, Clock::Instant now) override;
  std::shared_ptr<Firmware> another_session() override;
  UnservedCommands& unserved() override;

 private:
  class Machine;
  class Client;
  explicit IioFirmware(std::shared_ptr<Machine> machine);

  std::shared_ptr<Machine> machine_;
  std::unique_ptr<Client> client_;
};

}  // namespace abcal::sim
