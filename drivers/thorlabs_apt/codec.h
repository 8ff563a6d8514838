#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/wire/frame.h"
#include "drivers/wire/readable_bytes.h"

/// The wire format of Thorlabs' APT protocol (Kinesis controllers): bytes to messages and back, no port, no
/// clock. Source: docs/protocols/thorlabs_apt.md. [unverified against a device]
namespace abcal::thorlabs_apt {

inline constexpr std::uint8_t kHost = 0x01;
inline constexpr std::uint8_t kRack = 0x11;  ///< Address of a controller with bays; the bays are 0x21 and on.
inline constexpr std::uint8_t kUnit = 0x50;  ///< A controller without bays.

enum Id : std::uint16_t {
  kRequestInfo = 0x0005,
  kInfo = 0x0006,
  kNothing = 0x0018,  ///< Prepare for no flash programming.
  kResponse = 0x0080,
  kRichResponse = 0x0081,
  kEnableChannel = 0x0210,
  kSetVelocity = 0x0413,
  kRequestVelocity = 0x0414,
  kVelocity = 0x0415,
  kRequestStatusBits = 0x0429,
  kStatusBits = 0x042A,
  kHome = 0x0443,
  kMoveAbsolute = 0x0453,
  kStop = 0x0465,
  kRequestStatus = 0x0480,
  kStatus = 0x0481,
  kRequestServoStatus = 0x0490,
  kServoStatus = 0x0491,
  kRequestStageParameters = 0x04F1,
  kStageParameters = 0x04F2,
};

struct Message {
  std::uint16_t id = 0;
  std::array<std::uint8_t, 2> parameters{};  ///< Parameters of a message without data.
  std::uint8_t source = 0;
  std::string data;  ///< Empty: a message of six bytes.
};

std::string short_message(std::uint16_t id, std::uint8_t first, std::uint8_t second,
                          std::uint8_t destination);
std::string long_message(std::uint16_t id, std::uint8_t destination, std::string_view data);

/// The first message to the host in the bytes; or, as a frame of their own, the bytes before it.
wire::FrameVerdict check_message(std::string_view bytes);

/// A whole message to the host; nullopt if the frame is not one.
std::optional<Message> parse_message(std::string_view frame);

struct HardwareInfo {
  std::uint32_t serial_number = 0;
  std::string model;
  std::string firmware;  ///< "1.2.3"
};
std::optional<HardwareInfo> parse_info(const Message& message);

/// Status of a channel.
struct Status {
  std::int32_t position = 0;  ///< Encoder counts, or microsteps.
  std::uint32_t bits = 0;

  bool moving() const;  ///< Also homing.
  bool homed() const;
  std::string_view fault() const;  ///< In words; empty: none.
};
std::optional<Status> parse_status(const Message& message);

struct Velocity {
  std::int32_t minimum = 0;
  std::int32_t acceleration = 0;
  std::int32_t maximum = 0;
};
std::optional<Velocity> parse_velocity(const Message& message);
std::string set_velocity(std::uint8_t destination, std::uint8_t channel, const Velocity& velocity);
std::string move_absolute(std::uint8_t destination, std::uint8_t channel, std::int32_t position);

/// The stage that a channel reports: "DDR100".
std::optional<std::string> parse_stage_name(const Message& message);

/// A controller's refusal of a command.
struct Refusal {
  int code = 0;
  std::string text;
};
std::optional<Refusal> parse_refusal(const Message& message);

/// Counts of one degree of a rotary stage; absent: not known.
std::optional<double> counts_per_degree(std::string_view stage);
std::string known_stages();

/// Properties of a controller, by its model.
struct Controller {
  bool servo = false;                 ///< Brushless or brushed: its own kind of status.
  double velocity_per_count_s = 0.0;  ///< The velocity parameter of one count per second.
};
std::optional<Controller> find_controller(std::string_view model);

}  // namespace abcal::thorlabs_apt
