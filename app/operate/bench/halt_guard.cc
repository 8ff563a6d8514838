#include "app/operate/bench/halt_guard.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <thread>
#include <utility>

#include "app/ground/system/detached_process.h"
#include "app/ground/system/helper_program.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/halt_recipe.h"

namespace abcal {
namespace {

using Json = nlohmann::json;

/// A packet of the socket; recipes are one or two kilobytes each.
constexpr std::size_t kLongestPacket = 64 * 1024;
constexpr int kAnswerTimeMs = 5000;
/// The guard tries so long to have the halt acknowledged.
constexpr std::chrono::seconds kHaltTime{20};

// Bytes of a recipe need not be UTF-8: MessagePack, not text.

Json pattern_json(const ReplyPattern& pattern) {
  Json alternatives = Json::array();
  for (const std::vector<ReplyPart>& alternative : pattern.alternatives) {
    Json parts = Json::array();
    for (const ReplyPart& part : alternative)
      parts.push_back(Json::array({part.kind, part.bytes, part.mask, part.least, part.most}));
    alternatives.push_back(std::move(parts));
  }
  return alternatives;
}

ReplyPattern pattern_from(const Json& json) {
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

Json recipe_json(const HaltRecipe& recipe) {
  Json questions = Json::array();
  for (const HaltRecipe::Question& question : recipe.questions)
    questions.push_back({{"bytes", question.bytes},
                         {"reply", pattern_json(question.reply)},
                         {"standing", pattern_json(question.standing)},
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

HaltRecipe recipe_from(const Json& json) {
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
    recipe.questions.push_back({each.at("bytes").get<std::string>(), pattern_from(each.at("reply")),
                                pattern_from(each.at("standing")),
                                std::chrono::milliseconds(each.at("listen_ms").get<std::int64_t>())});
  return recipe;
}

/// Room for the one descriptor that may come with a packet.
struct Ancillary {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> bytes{};
};

bool send_packet(int socket, const std::vector<std::uint8_t>& packet, int descriptor) {
  iovec data{const_cast<std::uint8_t*>(packet.data()), packet.size()};
  Ancillary ancillary;
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = ancillary.bytes.data();
  message.msg_controllen = ancillary.bytes.size();
  cmsghdr* header = CMSG_FIRSTHDR(&message);
  header->cmsg_level = SOL_SOCKET;
  header->cmsg_type = SCM_RIGHTS;
  header->cmsg_len = CMSG_LEN(sizeof(int));
  std::memcpy(CMSG_DATA(header), &descriptor, sizeof(int));
  return ::sendmsg(socket, &message, MSG_NOSIGNAL) == static_cast<ssize_t>(packet.size());
}

struct Packet {
  std::vector<std::uint8_t> bytes;
  int descriptor = -1;  ///< -1: none came with it.
};

/// Waits for the next packet. @return nothing at the end of the connection
std::optional<Packet> receive_packet(int socket) {
  std::vector<std::uint8_t> bytes(kLongestPacket);
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
  bytes.resize(static_cast<std::size_t>(count));
  Packet packet{std::move(bytes), -1};
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr; header = CMSG_NXTHDR(&message, header))
    if (header->cmsg_level == SOL_SOCKET && header->cmsg_type == SCM_RIGHTS)
      std::memcpy(&packet.descriptor, CMSG_DATA(header), sizeof(int));
  return packet;
}

/// A port in the hands of the guard.
struct HeldPort {
  GuardedPort port;
  int descriptor = -1;

  std::string halt(Clock& clock) const {
    wire::DescriptorStream stream(descriptor, port.name, clock);
    std::string words;
    for (const HaltRecipe& recipe : port.recipes) {
      const bool halted = wire::carry_out(recipe, stream, clock, clock.now() + kHaltTime);
      if (!recipe.chamber.empty())
        words = halted ? recipe.chamber
                       : "did not acknowledge its set point, is left as it is and may be heating or cooling";
      for (const StageAxis axis : kStageAxes) {
        if (!recipe.axes[index(axis)]) continue;
        words += fmt::format("{}axis {}: {}", words.empty() ? "" : "; ", to_string(axis),
                             halted ? "halted" : "did not acknowledge the halt, may be moving");
      }
    }
    return fmt::format("{}: {}", port.name, words);
  }
};

}  // namespace

std::vector<std::uint8_t> packet_of(const GuardedPort& port) {
  Json recipes = Json::array();
  for (const HaltRecipe& recipe : port.recipes) recipes.push_back(recipe_json(recipe));
  return Json::to_msgpack({{"port", port.name}, {"recipes", std::move(recipes)}});
}

std::optional<GuardedPort> port_of(const std::vector<std::uint8_t>& packet) {
  const Json json = Json::from_msgpack(packet);
  if (json.contains("at_rest")) return std::nullopt;
  GuardedPort port{.name = json.at("port").get<std::string>(), .recipes = {}};
  for (const Json& recipe : json.at("recipes")) port.recipes.push_back(recipe_from(recipe));
  return port;
}

HaltGuard::~HaltGuard() {
  end();
}

void HaltGuard::end() {
  if (socket_ < 0) return;
  const std::vector<std::uint8_t> at_rest = Json::to_msgpack({{"at_rest", true}});
  if (::send(socket_, at_rest.data(), at_rest.size(), MSG_NOSIGNAL) > 0) {
    pollfd ended{.fd = socket_, .events = POLLIN, .revents = 0};
    ::poll(&ended, 1, kAnswerTimeMs);  // So that the next owner finds the ports free.
  }
  collect();
}

void HaltGuard::collect() {
  ::close(std::exchange(socket_, -1));
  ::waitpid(std::exchange(process_, -1), nullptr, 0);
}

int HaltGuard::generation() {
  if (socket_ >= 0) {
    char byte = 0;
    // It says nothing unless it was given a port: an end of its own is its death.
    if (::recv(socket_, &byte, 1, MSG_DONTWAIT | MSG_PEEK) == 0) collect();
  }
  if (socket_ < 0) start();
  return generation_;
}

void HaltGuard::start() {
  const ConnectedProcess guard =
      start_connected(helper_program("abcal-guard", "halting a stage whose program has died needs"));
  process_ = guard.process;
  socket_ = guard.socket;
  ++generation_;
}

void HaltGuard::hold(const GuardedPort& port, int descriptor) {
  (void)generation();
  pollfd answer{.fd = socket_, .events = POLLIN, .revents = 0};
  char taken = 0;
  if (!send_packet(socket_, packet_of(port), descriptor) || ::poll(&answer, 1, kAnswerTimeMs) != 1 ||
      ::recv(socket_, &taken, 1, 0) != 1)
    throw std::runtime_error(fmt::format("the guard did not take over {}", port.name));
}

std::vector<std::string> guard_until_owner_dies(int socket, Clock& clock) {
  std::map<std::string, HeldPort> held;
  while (const std::optional<Packet> packet = receive_packet(socket)) {
    std::optional<GuardedPort> port = port_of(packet->bytes);
    if (!port) return {};
    const std::string name = port->name;
    const auto before = held.find(name);
    if (before != held.end()) ::close(before->second.descriptor);
    held.insert_or_assign(name, HeldPort{std::move(*port), packet->descriptor});
    constexpr char kTaken = 1;
    (void)::send(socket, &kTaken, 1, MSG_NOSIGNAL);
  }
  // Each port has a thread: one that does not answer must not keep the other axis moving.
  std::vector<std::string> words(held.size());
  {
    std::vector<std::jthread> threads;
    for (const auto& [name, port] : held)
      threads.emplace_back(
          [&clock, &held_port = port, &word = words[threads.size()]] { word = held_port.halt(clock); });
  }
  return words;
}

}  // namespace abcal
