#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"
#include "tests/drivers/microstrain_mip/reference_decoder.h"

namespace abcal::test {

/// A clock that advances only when a caller waits.
class WaitingClock final : public Clock {
 public:
  Instant now() const override { return now_; }
  UtcTime utc_now() const override { return UtcTime(now_.time_since_epoch()); }
  void sleep_until(Instant instant) override {
    if (instant > now_) now_ = instant;
  }

 private:
  Instant now_{std::chrono::hours(1)};
};

/// A port with a scripted MIP device. Its future bytes are in a schedule, to which commands add.
class FakeMipDevice final : public wire::ByteStream {
 public:
  struct Script {
    std::vector<std::uint16_t> descriptors{0x0101, 0x0102, 0x0103, 0x0104, 0x0106, 0x0C0E, 0x0C0F,
                                           0x0C11, 0x8004, 0x8005, 0x8014, 0x8018, 0x80D5};
    unsigned base_rate_hz = 1000;
    std::string options = "8g, 300dps      ";
    Clock::Duration answer_time = std::chrono::milliseconds(1);
    /// Called with set and descriptor of each command; true: the script dealt with it.
    std::function<bool(FakeMipDevice&, unsigned set, unsigned descriptor)> on_command;
  };

  explicit FakeMipDevice(WaitingClock& clock) : FakeMipDevice(clock, Script{}) {}
  FakeMipDevice(WaitingClock& clock, Script device_script)
      : clock_(clock), script(std::move(device_script)) {}

  WaitingClock& clock_;
  Script script;
  std::vector<std::string> commands;  ///< Whole packets written by the driver.
  std::size_t dropped = 0;
  bool unplugged = false;

  void send(std::string bytes, Clock::Duration after = {}) {
    schedule_.emplace(clock_.now() + after, std::move(bytes));
  }
  void send_at(Clock::Instant instant, std::string bytes) { schedule_.emplace(instant, std::move(bytes)); }
  void clear_schedule() { schedule_.clear(); }

  /// An acknowledgement, with a reply field if its descriptor is not 0.
  static std::string answer(unsigned set, unsigned command, unsigned code = 0, unsigned reply_field = 0,
                            std::string_view reply = {}) {
    using namespace mip_reference;
    std::string payload = field_bytes(0xF1, bytes_of(command, 1) + bytes_of(code, 1));
    if (reply_field != 0) payload += field_bytes(reply_field, reply);
    return packet(set, payload);
  }

  static std::string info_reply(std::string_view options) {
    return mip_reference::bytes_of(1103, 2) + "    3DM-GX5-25  " + "       6253-4220" + "      6253.12345" +
           "           I042Z" + std::string(options);
  }

  /// Answer of an undamaged device.
  void answer_by_default(unsigned set, unsigned descriptor) {
    using namespace mip_reference;
    std::string descriptors;
    for (const std::uint16_t each : script.descriptors) descriptors += bytes_of(each, 2);
    switch (set * 256 + descriptor) {
      case 0x0103:
        return send(answer(set, descriptor, 0, 0x81, info_reply(script.options)), script.answer_time);
      case 0x0104:
        return send(answer(set, descriptor, 0, 0x82, descriptors), script.answer_time);
      case 0x0C06:
        return send(answer(set, descriptor, 0, 0x83, bytes_of(script.base_rate_hz, 2)), script.answer_time);
      case 0x0C0E:
        return send(answer(set, descriptor, 0, 0x8E, "\x80" + bytes_of(script.base_rate_hz, 2)),
                    script.answer_time);
      default:
        return send(answer(set, descriptor), script.answer_time);
    }
  }

  bool was_sent(unsigned set, unsigned descriptor) const { return count_sent(set, descriptor) > 0; }
  int count_sent(unsigned set, unsigned descriptor) const {
    int count = 0;
    for (const std::string& command : commands) {
      count += mip_reference::byte_at(command, 2) == set && mip_reference::byte_at(command, 5) == descriptor;
    }
    return count;
  }

  // wire::ByteStream
  void write(std::string_view bytes) override {
    throw_if_unplugged();
    commands.emplace_back(bytes);
    const unsigned set = mip_reference::byte_at(bytes, 2);
    const unsigned descriptor = mip_reference::byte_at(bytes, 5);
    if (!script.on_command || !script.on_command(*this, set, descriptor)) answer_by_default(set, descriptor);
  }

  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    throw_if_unplugged();
    std::string bytes = take_due();
    if (bytes.empty()) {
      const bool in_time = !schedule_.empty() && schedule_.begin()->first <= deadline;
      clock_.sleep_until(in_time ? schedule_.begin()->first : deadline);
      bytes = take_due();
    }
    return {std::move(bytes), clock_.now()};
  }

  void discard_input() override { take_due(); }
  std::size_t dropped_bytes() const override { return dropped; }
  std::string name() const override { return "scripted"; }

 private:
  void throw_if_unplugged() const {
    if (unplugged) throw InstrumentError("scripted", Fault::kLinkLost, "unplugged");
  }

  std::string take_due() {
    std::string bytes;
    while (!schedule_.empty() && schedule_.begin()->first <= clock_.now()) {
      bytes += schedule_.begin()->second;
      schedule_.erase(schedule_.begin());
    }
    return bytes;
  }

  std::multimap<Clock::Instant, std::string> schedule_;  // Equal instants keep their order.
};

/// A data packet as the recorded device sends them: reference time, scaled accelerometer.
inline std::string data_packet(std::uint64_t reference_time_ns, float x, float y, float z,
                               std::string_view more_fields = {}) {
  using namespace mip_reference;
  return packet(0x80, field_bytes(0xD5, bytes_of(reference_time_ns, 8)) +
                          field_bytes(0x04, float_bytes(x) + float_bytes(y) + float_bytes(z)) +
                          std::string(more_fields));
}

}  // namespace abcal::test
