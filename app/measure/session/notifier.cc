#include "app/measure/session/notifier.h"

#include <fmt/format.h>
#include <sys/wait.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/document/json_text.h"
#include "app/system/channel.h"
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

/// Longest answer of abcal-transfer that is shown, in bytes.
constexpr std::size_t kLongestAnswer = 4096;

}  // namespace

std::optional<Json> message_of(const SessionEvent& event) {
  return std::visit(MessageOf{}, event);
}

Notifier::~Notifier() {
  for (ConnectedProcess& sending : sendings_) {
    sending.socket.close();
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
  sendings_.push_back(start_connected(helper_program("abcal-transfer", "[notify] needs")));
  // The channel holds the packet until the program has started and reads it.
  if (!send_packet(sendings_.back().socket.number(), packet)) throw std::runtime_error(std::strerror(errno));
}

std::vector<std::string> Notifier::failures(std::chrono::milliseconds longest) {
  const auto deadline = std::chrono::steady_clock::now() + longest;
  std::vector<ConnectedProcess> open;
  for (ConnectedProcess& sending : sendings_) {
    if (!wait_until_readable(sending.socket.number(), deadline - std::chrono::steady_clock::now())) {
      if (longest.count() == 0) {
        open.push_back(std::move(sending));
        continue;
      }
      failures_.emplace_back(
          "a message to those in [notify] is not confirmed yet; abcal-transfer goes on with it");
    } else if (const auto answer = receive_packet(sending.socket.number(), kLongestAnswer);
               !answer || answer->bytes != "sent") {
      failures_.push_back(fmt::format("a message to those in [notify] did not arrive: {}",
                                      answer ? answer->bytes : "abcal-transfer has ended"));
    }
    sending.socket.close();
    ::waitpid(sending.process, nullptr, WNOHANG);
  }
  sendings_ = std::move(open);
  return std::exchange(failures_, {});
}

}  // namespace abcal
