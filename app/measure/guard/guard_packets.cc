#include "app/measure/guard/guard_packets.h"

#include <chrono>
#include <cstdint>

#include "app/system/channel.h"

// A duration is its number of milliseconds.
template <>
struct nlohmann::adl_serializer<std::chrono::milliseconds> {
  static void to_json(json& json, std::chrono::milliseconds time) { json = time.count(); }
  static void from_json(const json& json, std::chrono::milliseconds& time) {
    time = std::chrono::milliseconds(json.get<std::int64_t>());
  }
};

namespace abcal::wire {
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(SerialSettings, baud, rts_cts)
}

namespace abcal {

// The members that travel, each once.
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(PortRequest, name, port, serial, holder)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(LeaseRequest, name, resources, holder)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(AxisReport, state, since, detail)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(OwnerBeat, may_move, chamber, awaits)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(ReplyPart, kind, bytes, mask, least, most)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(ReplyPattern, alternatives)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(HaltRecipe::Question, bytes, reply, standing, listen)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(HaltRecipe, driver, axes, end_partial, stop, questions, reply_time,
                                   further_stops, gap, reply_end, binary, chamber)

namespace {

using Json = nlohmann::json;

Json packet_of(const char* kind, Json members) {
  members["kind"] = kind;
  return members;
}

}  // namespace

bool send_guard_packet(int socket, const Json& json, const std::vector<Descriptor>& descriptors) {
  std::string packet;
  Json::to_msgpack(json, packet);
  return send_packet(socket, packet, descriptors);
}

std::optional<GuardPacket> receive_guard_packet(int socket) {
  GuardPacket packet;
  // One that is too long is cut, and thereby malformed.
  const std::optional<Packet> received = receive_packet(socket, kLongestGuardPacket, &packet.descriptors);
  if (!received) return std::nullopt;
  packet.json = Json::from_msgpack(received->bytes);
  return packet;
}

Json to_json(const AxesReport& axes) {
  return {{"x", axes[0]}, {"z", axes[1]}};
}

AxesReport axes_report_from(const Json& json) {
  return {json.value("x", AxisReport()), json.value("z", AxisReport())};
}

Json to_json(const PortRequest& request) {
  return packet_of(to_guard::kOpen, request);
}

PortRequest port_request_from(const Json& json) {
  return json.get<PortRequest>();
}

Json to_json(const LeaseRequest& request) {
  return packet_of(to_guard::kLease, request);
}

LeaseRequest lease_request_from(const Json& json) {
  return json.get<LeaseRequest>();
}

Json to_json(const OwnerBeat& beat) {
  return packet_of(to_guard::kBeat, beat);
}

OwnerBeat owner_beat_from(const Json& json) {
  return json.get<OwnerBeat>();
}

Json to_json(const HaltRecipe& recipe) {
  Json json;
  to_json(json, recipe);
  return json;
}

HaltRecipe halt_recipe_from(const Json& json) {
  return json.get<HaltRecipe>();
}

}  // namespace abcal
