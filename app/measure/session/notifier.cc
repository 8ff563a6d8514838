#include "app/measure/session/notifier.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/document/json_text.h"
#include "app/system/detached_process.h"
#include "app/system/helper_program.h"

namespace abcal {
namespace {

using Json = nlohmann::json;

/// Makes the message of an event; most events have none.
struct MessageOf {
  std::optional<Json> operator()(const PortLostEvent& event) const {
    return Json{{"event", "port_lost"}, {"text", event.text}};
  }
  std::optional<Json> operator()(const PortBackEvent& event) const {
    return Json{{"event", "port_back"}, {"text", event.text}};
  }
  std::optional<Json> operator()(const NoticeEvent& event) const {
    if (event.kind != "watchdog") return std::nullopt;
    return Json{{"event", "watchdog"}, {"text", event.text}};
  }
  std::optional<Json> operator()(const FinishedEvent& event) const {
    const std::string text = event.complete
                                 ? (event.verdict.empty() ? "complete" : "complete: " + event.verdict)
                                 : "ended early: " + event.reason;
    return Json{{"event", "finished"},      {"text", text},           {"complete", event.complete},
                {"verdict", event.verdict}, {"reason", event.reason}, {"measured", event.measured},
                {"planned", event.planned}};
  }
  template <class Other>
  std::optional<Json> operator()(const Other&) const {
    return std::nullopt;
  }
};

/// The answer of abcal-transfer; nullopt if it ended without one.
std::optional<std::string> answer_on(int socket) {
  std::array<char, 4096> answer{};
  const ssize_t count = ::recv(socket, answer.data(), answer.size(), 0);
  if (count <= 0) return std::nullopt;
  return std::string(answer.data(), static_cast<std::size_t>(count));
}

}  // namespace

std::optional<Json> message_of(const SessionEvent& event) {
  return std::visit(MessageOf{}, event);
}

Notifier::~Notifier() {
  for (const ConnectedProcess& sending : sendings_) {
    ::close(sending.socket);
    ::waitpid(sending.process, nullptr, WNOHANG);
  }
}

void Notifier::send(const SessionEvent& event, const std::string& utc) {
  if (!config_.anybody()) return;
  if (const auto* began = std::get_if<RunBeganEvent>(&event)) {
    bench_ = began->bench;
    item_ = began->item;
    operator_ = began->operator_name;
    file_ = std::filesystem::path(began->file).filename().string();
    simulated_ = began->simulated_time;
  }
  std::optional<Json> message = message_of(event);
  if (!message) return;
  message->update(Json{{"schema", "abcal.message/1"},
                       {"utc", utc},
                       {"bench", bench_},
                       {"item", item_},
                       {"operator", operator_},
                       {"run", file_},
                       {"simulated", simulated_}});
  try {
    start(*message);
  } catch (const std::exception& error) {
    failures_.push_back(fmt::format("a message to those in [notify] was not sent: {}", error.what()));
  }
}

void Notifier::start(const Json& message) {
  const std::string packet = json_text({{"webhook", config_.webhook},
                                        {"mail_to", config_.mail_to},
                                        {"mail_from", config_.mail_from},
                                        {"mail_server", config_.mail_server},
                                        {"message", message}});
  const ConnectedProcess sender = start_connected(helper_program("abcal-transfer", "[notify] needs"));
  sendings_.push_back(sender);
  // The socket holds the packet until the program has started and reads it.
  if (::send(sender.socket, packet.data(), packet.size(), MSG_NOSIGNAL) < 0)
    throw std::runtime_error(std::strerror(errno));
}

std::vector<std::string> Notifier::failures(std::chrono::milliseconds longest) {
  const auto deadline = std::chrono::steady_clock::now() + longest;
  std::vector<ConnectedProcess> open;
  for (const ConnectedProcess& sending : sendings_) {
    const auto left =
        std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    pollfd answer{.fd = sending.socket, .events = POLLIN, .revents = 0};
    if (::poll(&answer, 1, static_cast<int>(std::max<std::int64_t>(left.count(), 0))) == 0) {
      if (longest.count() == 0) {
        open.push_back(sending);
        continue;
      }
      failures_.emplace_back(
          "a message to those in [notify] is not confirmed yet; abcal-transfer goes on with it");
    } else if (const std::optional<std::string> words = answer_on(sending.socket); words != "sent") {
      failures_.push_back(fmt::format("a message to those in [notify] did not arrive: {}",
                                      words.value_or("abcal-transfer has ended")));
    }
    ::close(sending.socket);
    ::waitpid(sending.process, nullptr, WNOHANG);
  }
  sendings_ = std::move(open);
  return std::exchange(failures_, {});
}

}  // namespace abcal
