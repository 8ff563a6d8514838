#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/system/descriptor.h"
#include "drivers/instrument/halt.h"
#include "drivers/wire/serial_port.h"

namespace abcal {

// The packets between a program that moves a bench and its guard, over a channel of packets. Each is one
// object in MessagePack, whose member "kind" names it; bytes of a recipe need not be UTF-8. A packet to the
// owner may carry descriptors.

/// Kinds of packets to the guard.
namespace to_guard {
inline constexpr const char* kOwner = "owner";      ///< The first: who moves the bench, and where the log is.
inline constexpr const char* kOpen = "open";        ///< Opens a port (PortRequest).
inline constexpr const char* kRecipes = "recipes";  ///< How to halt what is on a port.
inline constexpr const char* kLease = "lease";      ///< Which instrument is behind a port (LeaseRequest).
inline constexpr const char* kTakeOver =
    "take over";  ///< Halts what a guard that is gone has left on a port (PortRequest).
inline constexpr const char* kBeat = "beat";  ///< The moving thread is alive (OwnerBeat).
inline constexpr const char* kHalt = "halt";  ///< Halts all axes until that is confirmed.
inline constexpr const char* kEnd = "end";  ///< The owner moves nothing any more; halts what is not at rest.
}  // namespace to_guard

/// Kinds of packets to the owner.
namespace to_owner {
inline constexpr const char* kOpened = "opened";  ///< With two descriptors: the socket, and the port itself.
inline constexpr const char* kLeased = "leased";  ///< The leases of an instrument are taken.
inline constexpr const char* kFailed = "failed";  ///< The port could not be opened, or a lease is held.
inline constexpr const char* kTaken = "taken";    ///< The recipes of a port are taken over.
inline constexpr const char* kBeat = "beat";      ///< The guard is alive.
inline constexpr const char* kHalting = "halting";  ///< The guard has begun to halt, and why.
inline constexpr const char* kHalted = "halted";    ///< The result of the first attempt on a port.
inline constexpr const char* kEnds = "ends";  ///< It ends: all axes are at rest, or were given up after long.
}  // namespace to_owner

/// States of an axis. The page reads them, too.
namespace axis_state {
inline constexpr const char* kNotMoved = "not moved";  ///< No motion was commanded, as far as the log tells.
inline constexpr const char* kAtRest = "at rest";      ///< Its controller has confirmed it.
inline constexpr const char* kMayMove =
    "may be moving";  ///< Commanded to move, or a halt is not confirmed yet.
inline constexpr const char* kUnreachable =
    "unreachable";  ///< Its port is gone, or its controller is silent: it may be moving.
inline constexpr const char* kUnknown =
    "unknown";  ///< It was commanded to move, and nobody is left who would see it come to rest.
}  // namespace axis_state

/// The one statement on an axis: from the guard that watches it (answer to "status"), and where none answers
/// from the guards' log (read_motion()).
struct AxisReport {
  std::string state = axis_state::kNotMoved;
  std::string since;   ///< UTC. At rest: when it was confirmed. Empty: never moved.
  std::string detail;  ///< Why it cannot be reached.

  bool is_at_rest() const { return state == axis_state::kAtRest || state == axis_state::kNotMoved; }
};
using AxesReport = std::array<AxisReport, 2>;  ///< By index(StageAxis).

/// {"x": {"state", "since", "detail"}, "z": ...}
nlohmann::json to_json(const AxesReport& axes);
AxesReport axes_report_from(const nlohmann::json& json);

/// Longest packet, in bytes; recipes are one or two kilobytes each.
inline constexpr std::size_t kLongestGuardPacket = 64 * 1024;

struct GuardPacket {
  nlohmann::json json;
  std::vector<Descriptor> descriptors;
};

/// Never waits. @return false: the other end is gone, or its queue is full
bool send_guard_packet(int socket, const nlohmann::json& json,
                       const std::vector<Descriptor>& descriptors = {});

/// Waits for the next packet. @return nullopt at the end of the connection
/// @throws nlohmann::json::exception for malformed packets
std::optional<GuardPacket> receive_guard_packet(int socket);

/// A port that the guard opens.
struct PortRequest {
  std::string name;  ///< InstrumentPort::name: "stage", "stage-x".
  std::string port;  ///< As the bench file names it: "usb:...", "tcp:HOST:PORT", "/path".
  wire::SerialSettings serial;
  std::string holder;  ///< Who moves the bench, for programs that find the port in use.
};
nlohmann::json to_json(const PortRequest& request);
PortRequest port_request_from(const nlohmann::json& json);

/// The leases (wire::Lease) of the instrument behind a port, which the guard holds until its end.
struct LeaseRequest {
  std::string name;                    ///< InstrumentPort::name.
  std::vector<std::string> resources;  ///< By resources_of_instrument().
  std::string holder;                  ///< As for PortRequest.
};
nlohmann::json to_json(const LeaseRequest& request);
LeaseRequest lease_request_from(const nlohmann::json& json);

/// A beat of the thread that moves the bench.
struct OwnerBeat {
  std::array<bool, 2>
      may_move{};        ///< By index(StageAxis): commanded to move, and not known to be at rest since.
  bool chamber = false;  ///< A chamber holds a set point of this run.
  std::string awaits;    ///< The event that the thread waits for, in words.
};
nlohmann::json to_json(const OwnerBeat& beat);
OwnerBeat owner_beat_from(const nlohmann::json& json);

nlohmann::json to_json(const HaltRecipe& recipe);
HaltRecipe halt_recipe_from(const nlohmann::json& json);

}  // namespace abcal
