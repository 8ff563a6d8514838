#include "app/witness/witness_service.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "app/document/json_text.h"
#include "app/system/channel.h"
#include "app/system/output.h"
#include "app/witness/witness_socket.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

using Json = nlohmann::json;

/// Longest reason of a refusal, in bytes: it may repeat what a client has sent.
constexpr std::size_t kLongestReason = 4096;

std::string refusal(const std::string& why, bool again = false) {
  Json json = {{"ok", false}, {"why", shortened_text(why, kLongestReason)}};
  if (again) json["again"] = true;
  return json_text(json);
}

std::string hexadecimal(std::string_view bytes) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string text;
  for (const char byte : bytes) {
    text += kDigits[static_cast<unsigned char>(byte) / 16];
    text += kDigits[static_cast<unsigned char>(byte) % 16];
  }
  return text;
}

std::string reply_of(const std::optional<WitnessedLine>& line) {
  if (!line) return json_text({{"ok", true}, {"none", true}});
  return json_text({{"ok", true}, {"line", line->line}, {"signature", hexadecimal(line->signature)}});
}

}  // namespace

WitnessService::WitnessService(WitnessLog& log, Options options)
    : log_(log),
      path_(std::move(options.socket)),
      users_(std::move(options.users)),
      listener_(path_.empty() ? Descriptor() : listen_as_witness(path_)) {
  if (options.owner.number() < 0) return;
  const std::uint32_t uid = peer_user(options.owner.number());
  clients_.push_back({std::move(options.owner), uid, true});
}

WitnessService::~WitnessService() {
  if (listener_.number() < 0) return;
  std::error_code ignored;
  std::filesystem::remove(path_, ignored);
}

void WitnessService::serve() {
  while (tick()) {
  }
}

/// @return false: the owner has ended
bool WitnessService::tick() {
  std::vector<pollfd> waiting;
  for (const Client& client : clients_)
    waiting.push_back({.fd = client.socket.number(), .events = POLLIN, .revents = 0});
  waiting.push_back({.fd = listener_.number(), .events = POLLIN, .revents = 0});  // -1 is passed over.
  ::poll(waiting.data(), waiting.size(), -1);
  // The order of the clients is kept: one that has asked moves to the end only after its answer.
  auto client = clients_.begin();
  for (std::size_t k = 0; k + 1 < waiting.size(); ++k) {
    const auto current = client++;
    if (waiting[k].revents == 0) continue;
    if (answer(*current)) {
      clients_.splice(clients_.end(), clients_, current);
      continue;
    }
    if (current->is_owner) return false;
    clients_.erase(current);
  }
  if (waiting.back().revents != 0) accept();
  return true;
}

void WitnessService::accept() {
  std::optional<Descriptor> socket = accept_from(listener_);
  if (!socket) return;
  if (clients_.size() >= kMostClients) {
    const auto silent = std::ranges::find_if(clients_, [](const Client& each) { return !each.is_owner; });
    clients_.erase(silent);
  }
  const std::uint32_t uid = peer_user(socket->number());
  clients_.push_back({*std::move(socket), uid});
}

/// @return false: the connection has ended
bool WitnessService::answer(const Client& client) {
  std::string reply;
  try {
    const std::optional<std::string> packet = receive_witness_packet(client.socket.number());
    if (!packet) return false;
    reply = reply_to(*packet, client.uid);
  } catch (const WitnessRefusal& refused) {
    reply = refusal(refused.what());
  } catch (const std::invalid_argument& problem) {
    reply = refusal(problem.what());
  } catch (const std::exception& problem) {  // The log cannot be written now: the client asks again.
    print_log("abcal-witness: {}\n", problem.what());
    reply = refusal(problem.what(), true);
  }
  return send_packet(client.socket.number(), reply);
}

std::string WitnessService::reply_to(const std::string& packet, std::uint32_t uid) {
  const Json json = Json::parse(packet, nullptr, false);
  const auto text = [&](const char* name) {
    const auto found = json.is_object() ? json.find(name) : json.end();
    return found != json.end() && found->is_string() ? found->get<std::string>() : std::string();
  };
  const std::string what = text("do");
  if (what == "who")
    return json_text(
        {{"ok", true}, {"public", log_.public_pem()}, {"fingerprint", fingerprint_of(log_.public_pem())}});
  if (users_ && !users_->contains(uid))
    throw WitnessRefusal(fmt::format(
        "this witness does not answer the user with the ID {}; required: one that its configuration names "
        "(/etc/default/abcal-witness)",
        uid));
  if (what == "fetch") {
    const WitnessAct act = witness_act_from(text("act"));
    const auto k = json.find("k");
    if (k == json.end()) return reply_of(log_.fetch_latest(text("run"), act));
    if (!k->is_number_integer())
      throw std::invalid_argument("\"k\": found no number; required: the number of the line");
    return reply_of(log_.fetch(text("run"), act, k->get<std::int64_t>()));
  }
  return reply_of(log_.answer(parse_witness_request(packet), uid));
}

void refuse_owner(int socket, const std::string& why) {
  while (receive_witness_packet(socket) && send_packet(socket, refusal(why))) {
  }
}

}  // namespace abcal
