#include "drivers/wire/line_exchange.h"

#include <cmath>
#include <stdexcept>
#include <vector>

namespace abcal::wire {

/// The next frame that is not skipped, unchanged; absent if none is complete by the deadline.
std::optional<std::string> LineExchange::take(Clock::Instant deadline) {
  for (;;) {
    std::optional<std::string> frame = line_.take_frame(deadline);
    if (!frame || !manner_.normal(*frame).empty()) return frame;
  }
}

std::optional<std::string> LineExchange::exchange(std::string_view request, Clock::Duration patience) {
  line_.discard_input();
  line_.send(request);
  const Clock::Instant deadline = line_.deadline_after(patience);
  for (;;) {
    std::optional<std::string> frame = take(deadline);
    // A late answer to an earlier resynchronise() that gave up too soon.
    if (frame && !identity_.empty() && manner_.normal(*frame) == identity_) continue;
    return frame;
  }
}

/// Returns once the controller has answered the identity query. One whole reply before that answer is the
/// late answer to the query that had none.
std::optional<std::string> LineExchange::resynchronise(std::string_view unanswered) {
  constexpr std::size_t kMostKept = 32;  // Two are not alone; the others are for the message.
  line_.send(manner_.identity_request);
  const Clock::Instant deadline = line_.deadline_after(manner_.patience);
  std::vector<std::string> before;
  while (const std::optional<std::string> frame = take(deadline)) {
    const std::string normal = manner_.normal(*frame);
    if (normal.ends_with(identity_)) {
      in_step_ = true;
      const bool alone = normal.size() == identity_.size();  // Otherwise half a reply preceded it.
      if (alone && before.size() == 1) return before.front();
      return std::nullopt;
    }
    if (before.size() < kMostKept) before.push_back(*frame);
  }
  std::string heard;
  for (const std::string& frame : before) heard += frame;
  heard += line_.received();
  throw line_.failure(
      Fault::kNoReply,
      fmt::format("no answer to \"{}\" within {} s, and none to \"{}\" after that; {}", unanswered,
                  to_seconds(manner_.patience), manner_.identity_name,
                  heard.empty() ? std::string("nothing arrived")
                                : fmt::format("what arrived was \"{}\"", manner_.show(heard))));
}

InstrumentError LineExchange::no_answer(const std::string& reply, std::string_view shown) const {
  return line_.failure(Fault::kBadFrame,
                       fmt::format("\"{}\" is not an answer to \"{}\"", manner_.show(reply), shown));
}

void LineExchange::identify(const std::function<bool(const std::string& frame)>& accept,
                            std::string_view if_silent, std::string_view if_foreign, std::size_t most_bytes) {
  identity_.clear();
  in_step_ = true;
  std::string heard;
  for (int attempt = 1; attempt <= 2; ++attempt) {
    std::optional<std::string> frame = exchange(manner_.identity_request, manner_.patience);
    const Clock::Instant deadline = line_.deadline_after(manner_.patience);
    while (frame) {
      if (accept(*frame)) {
        identity_ = manner_.normal(*frame);
        return;
      }
      heard += *frame;
      if (heard.size() > most_bytes) break;
      frame = take(deadline);
    }
    heard += line_.received();
  }
  if (heard.empty()) {
    throw line_.failure(Fault::kNoReply,
                        fmt::format("no answer to \"{}\" within {} s, asked twice; {}", manner_.identity_name,
                                    to_seconds(manner_.patience), if_silent));
  }
  throw line_.failure(Fault::kWrongIdentity,
                      fmt::format("\"{}\" is not an answer of {} to \"{}\": another instrument is on this "
                                  "port, or the baud rate is wrong",
                                  manner_.show(heard), if_foreign, manner_.identity_name));
}

void LineExchange::identify_twice(const std::function<bool(const std::string& frame)>& accept,
                                  std::string_view if_silent, std::string_view if_foreign,
                                  std::size_t most_bytes) {
  constexpr int kTries = 4;
  std::string last;
  for (int n = 0; n < kTries; ++n) {
    identify(accept, if_silent, if_foreign, most_bytes);
    if (identity_ == last) return;
    last = identity_;
  }
  throw line_.failure(Fault::kBadFrame,
                      fmt::format("\"{}\" was answered differently each time, last with \"{}\"",
                                  manner_.identity_name, manner_.show(last)));
}

int LineExchange::error_in(std::optional<std::string> reply, std::string_view after) {
  if (!reply) {
    in_step_ = false;
    reply = resynchronise(fmt::format("{} after {}", manner_.error_name, after));
    if (!reply) {
      throw line_.failure(
          Fault::kNoReply,
          fmt::format(
              "no answer to \"{}\" after \"{}\" within {} s; whether that command was accepted is unknown",
              manner_.error_name, after, to_seconds(manner_.patience)));
    }
  }
  const auto code = errors_.code_of(*reply);
  if (!code) {
    in_step_ = false;
    throw no_answer(*reply, fmt::format("{}\" after \"{}", manner_.error_name, after));
  }
  return *code;
}

int LineExchange::ask_error(std::string_view after) {
  ensure_in_step(manner_.error_name);
  return error_in(exchange(manner_.error_request, manner_.patience), after);
}

int LineExchange::execute(std::string_view command, std::string_view shown) {
  ensure_in_step(shown);
  // Otherwise an old error would be taken for the answer to this command.
  if (error_may_wait_) errors_.read("an earlier command");
  error_may_wait_ = true;
  return error_in(exchange(std::string(command) + manner_.error_request, manner_.patience), shown);
}

void check_stage_settings(std::string_view maker, std::string_view axis_words, const ByteStream* stream,
                          const StageSettings& settings) {
  const auto& names = settings.axis_names;
  if (stream == nullptr) throw std::invalid_argument(fmt::format("{} stage: no stream", maker));
  if (names[0].empty() && names[1].empty()) {
    throw std::invalid_argument(
        fmt::format("{} stage: no axis is named; required: {} of X, Z or both", maker, axis_words));
  }
  if (names[0] == names[1]) {
    throw std::invalid_argument(
        fmt::format("{} stage: X and Z are both axis \"{}\"; required: two different axes", maker, names[0]));
  }
  for (const auto& speed : settings.speed_deg_per_s) {
    if (speed && !(std::isfinite(*speed) && *speed > 0.0)) {
      throw std::invalid_argument(
          fmt::format("{} stage: speed {} deg/s; required: a positive number", maker, *speed));
    }
  }
}

}  // namespace abcal::wire
