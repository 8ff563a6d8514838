#include "app/measure/guard/guard_packets.h"

#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <utility>

namespace abcal {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMostDescriptors = 2;

/// Room for the descriptors that may arrive with a packet.
struct Ancillary {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(kMostDescriptors * sizeof(int))> bytes{};
};

Json to_json(const ReplyPattern& pattern) {
  Json alternatives = Json::array();
  for (const std::vector<ReplyPart>& alternative : pattern.alternatives) {
    Json parts = Json::array();
    for (const ReplyPart& part : alternative)
      parts.push_back(Json::array({part.kind, part.bytes, part.mask, part.least, part.most}));
    alternatives.push_back(std::move(parts));
  }
  return alternatives;
}

ReplyPattern reply_pattern_from(const Json& json) {
  ReplyPattern pattern;
  for (const Json& alternative : json) {
    std::vector<ReplyPart>& parts = pattern.alternatives.emplace_back();
    for (const Json& part : alternative)
      parts.push_back({part.at(0).get<ReplyPart::Kind>(), part.at(1).get<std::string>(),
                       part.at(2).get<std::string>(), part.at(3).get<std::uint32_t>(),
                       part.at(4).get<std::uint32_t>()});
  }
  return pattern;
}

}  // namespace

bool send_guard_packet(int socket, const Json& json, const std::vector<int>& descriptors) {
  std::vector<std::uint8_t> packet = Json::to_msgpack(json);
  iovec data{packet.data(), packet.size()};
  Ancillary ancillary;
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  if (!descriptors.empty()) {
    const std::size_t bytes = descriptors.size() * sizeof(int);
    message.msg_control = ancillary.bytes.data();
    message.msg_controllen = CMSG_SPACE(bytes);
    cmsghdr* header = CMSG_FIRSTHDR(&message);
    header->cmsg_level = SOL_SOCKET;
    header->cmsg_type = SCM_RIGHTS;
    header->cmsg_len = CMSG_LEN(bytes);
    std::memcpy(CMSG_DATA(header), descriptors.data(), bytes);
  }
  return ::sendmsg(socket, &message, MSG_NOSIGNAL | MSG_DONTWAIT) == static_cast<ssize_t>(packet.size());
}

std::optional<GuardPacket> receive_guard_packet(int socket) {
  std::vector<std::uint8_t> bytes(kLongestGuardPacket);
  iovec data{bytes.data(), bytes.size()};
  Ancillary ancillary;
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = ancillary.bytes.data();
  message.msg_controllen = ancillary.bytes.size();
  ssize_t count = 0;
  do count = ::recvmsg(socket, &message, MSG_CMSG_CLOEXEC);
  while (count < 0 && errno == EINTR);
  if (count <= 0) return std::nullopt;
  GuardPacket packet;
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr; header = CMSG_NXTHDR(&message, header)) {
    if (header->cmsg_level != SOL_SOCKET || header->cmsg_type != SCM_RIGHTS) continue;
    packet.descriptors.resize((header->cmsg_len - CMSG_LEN(0)) / sizeof(int));
    std::memcpy(packet.descriptors.data(), CMSG_DATA(header), packet.descriptors.size() * sizeof(int));
  }
  bytes.resize(static_cast<std::size_t>(count));
  packet.json = Json::from_msgpack(bytes);
  return packet;
}

Json to_json(const PortRequest& request) {
  return {{"kind", to_guard::kOpen},
          {"name", request.name},
          {"port", request.port},
          {"baud", request.serial.baud},
          {"rts_cts", request.serial.rts_cts},
          {"holder", request.holder}};
}

PortRequest port_request_from(const Json& json) {
  PortRequest request;
  request.name = json.at("name").get<std::string>();
  request.port = json.at("port").get<std::string>();
  request.serial.baud = json.at("baud").get<unsigned>();
  request.serial.rts_cts = json.at("rts_cts").get<bool>();
  request.holder = json.at("holder").get<std::string>();
  return request;
}

Json to_json(const LeaseRequest& request) {
  return {{"kind", to_guard::kLease},
          {"name", request.name},
          {"resources", request.resources},
          {"holder", request.holder}};
}

LeaseRequest lease_request_from(const Json& json) {
  return {json.at("name").get<std::string>(), json.at("resources").get<std::vector<std::string>>(),
          json.at("holder").get<std::string>()};
}

Json to_json(const OwnerBeat& beat) {
  return {{"kind", to_guard::kBeat},
          {"x", beat.may_move[0]},
          {"z", beat.may_move[1]},
          {"chamber", beat.chamber},
          {"awaits", beat.awaits}};
}

OwnerBeat owner_beat_from(const Json& json) {
  OwnerBeat beat;
  beat.may_move = {json.at("x").get<bool>(), json.at("z").get<bool>()};
  beat.chamber = json.at("chamber").get<bool>();
  beat.awaits = json.at("awaits").get<std::string>();
  return beat;
}

Json to_json(const HaltRecipe& recipe) {
  Json questions = Json::array();
  for (const HaltRecipe::Question& question : recipe.questions)
    questions.push_back({{"bytes", question.bytes},
                         {"reply", to_json(question.reply)},
                         {"standing", to_json(question.standing)},
                         {"listen_ms", question.listen.count()}});
  return {{"driver", recipe.driver},
          {"x", recipe.axes[0]},
          {"z", recipe.axes[1]},
          {"end_partial", recipe.end_partial},
          {"stop", recipe.stop},
          {"questions", std::move(questions)},
          {"reply_time_ms", recipe.reply_time.count()},
          {"reply_end", recipe.reply_end},
          {"binary", recipe.binary},
          {"chamber", recipe.chamber}};
}

HaltRecipe halt_recipe_from(const Json& json) {
  HaltRecipe recipe;
  recipe.driver = json.at("driver").get<std::string>();
  recipe.axes = {json.at("x").get<bool>(), json.at("z").get<bool>()};
  recipe.end_partial = json.at("end_partial").get<std::string>();
  recipe.stop = json.at("stop").get<std::string>();
  recipe.reply_time = std::chrono::milliseconds(json.at("reply_time_ms").get<std::int64_t>());
  recipe.reply_end = json.at("reply_end").get<std::string>();
  recipe.binary = json.at("binary").get<bool>();
  recipe.chamber = json.at("chamber").get<std::string>();
  for (const Json& each : json.at("questions"))
    recipe.questions.push_back({each.at("bytes").get<std::string>(), reply_pattern_from(each.at("reply")),
                                reply_pattern_from(each.at("standing")),
                                std::chrono::milliseconds(each.at("listen_ms").get<std::int64_t>())});
  return recipe;
}

}  // namespace abcal
