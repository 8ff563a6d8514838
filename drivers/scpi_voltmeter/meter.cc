#include "drivers/scpi_voltmeter/meter.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "drivers/wire/readable_bytes.h"

namespace abcal::scpi {
namespace {

// [unverified against a device] The slowest thing asked for is *RST, a second or two.
constexpr std::chrono::seconds kAnswerTime{5};
constexpr int kTries = 2;
// [unverified against a device] An error queue holds 10 to 32 of them.
constexpr std::size_t kMostErrors = 40;

/// -400 to -499: a reply was not fetched, or cut off. Asking for the identity out of turn may cause one.
bool is_query_error(int code) {
  return code <= -400 && code > -500;
}

std::string shown(std::string_view bytes) {
  constexpr std::size_t kLongest = 80;
  return wire::bytes_as_text(bytes.substr(0, kLongest)) + (bytes.size() > kLongest ? "..." : "");
}

}  // namespace

Meter::Meter(std::unique_ptr<wire::ByteStream> stream, Clock& clock)
    : stream_(std::move(stream)), clock_(clock), instrument_("voltmeter on " + stream_->name()) {}

void Meter::fail(Fault fault, std::string_view detail) const {
  throw InstrumentError(instrument_, fault, detail);
}

void Meter::send(std::string_view command) {
  stream_->write(std::string(command) + "\n");
}

/// The next reply, with its terminator; absent if none is complete by the deadline (its first bytes are
/// kept).
std::optional<std::string> Meter::take_reply(Clock::Instant deadline) {
  for (;;) {
    const wire::FrameVerdict verdict = check_reply(received_);
    if (verdict.check == wire::FrameCheck::kInvalid) return std::exchange(received_, {});
    if (verdict.check == wire::FrameCheck::kComplete) {
      std::string reply = received_.substr(0, verdict.length);
      received_.erase(0, verdict.length);
      return reply;
    }
    const bool last_look = clock_.now() >= deadline;  // A stream that never pauses must not hold us.
    const wire::ReceivedBytes more = stream_->read_until(deadline);
    if (!more.bytes.empty()) last_arrival_ = more.arrival;
    received_ += more.bytes;
    if (more.bytes.empty() || (last_look && check_reply(received_).check == wire::FrameCheck::kNeedMore))
      return std::nullopt;
  }
}

/// Sends a query and returns the value that `parse` reads from its answer. Replies that it cannot parse are
/// skipped: they are noise, or late answers to another query.
template <class Parse>
auto Meter::query(std::string_view command, Parse parse) {
  send(command);
  const Clock::Instant deadline = clock_.now() + kAnswerTime;
  std::string heard;
  while (const auto reply = take_reply(deadline)) {
    if (auto answer = parse(text_of(*reply))) return *std::move(answer);
    skip(*reply);
    if (heard.size() < kLongestReply) heard += *reply;  // The message shows fewer bytes than this.
    if (clock_.now() >= deadline) break;
  }
  heard += received_;
  const std::string asked = fmt::format("no answer to \"{}\" within {} s", command, kAnswerTime.count());
  if (heard.empty()) fail(Fault::kNoReply, asked);
  fail(Fault::kBadFrame, fmt::format("{}; what arrived was \"{}\"", asked, shown(heard)));
}

Identity Meter::identify() {
  const Clock::Duration busy =
      std::exchange(stage_, Stage::kIdle) == Stage::kIdle ? Clock::Duration{} : plan_.patience;
  std::string heard;
  received_.clear();
  stream_->discard_input();
  for (int tries = 0; tries < kTries; ++tries) {
    send("*IDN?");
    const Clock::Instant deadline = clock_.now() + kAnswerTime + busy;
    while (const auto reply = take_reply(deadline)) {
      const std::string_view text = text_of(*reply);
      if (auto identity = parse_identity(text)) {
        identity_text_ = text;
        instrument_ = fmt::format("voltmeter {} (SN {}) on {}", identity->model, identity->serial_number,
                                  stream_->name());
        return *std::move(identity);
      }
      if (heard.size() < kLongestReply) heard += *reply;
      if (clock_.now() >= deadline) break;
    }
  }
  heard += received_;
  const std::string asked =
      fmt::format("no answer to \"*IDN?\" within {:g} s, asked twice", to_seconds(kAnswerTime + busy));
  if (heard.empty()) {
    fail(Fault::kNoReply, asked +
                              ", and not one byte arrived: is it switched on and set to this interface, and "
                              "is the baud rate that of the instrument?");
  }
  fail(Fault::kWrongIdentity,
       fmt::format(
           "{}; what arrived was \"{}\": another instrument is on this port, or the baud rate is wrong",
           asked, shown(heard)));
}

/// Reads the errors until there is none.
std::vector<ErrorReport> Meter::take_errors() {
  std::vector<ErrorReport> errors;
  while (errors.size() < kMostErrors) {
    const ErrorReport report = query("SYST:ERR?", parse_error);
    if (report.code == 0) break;
    errors.push_back(report);
  }
  return errors;
}

void Meter::refuse(const std::vector<ErrorReport>& errors, std::string_view command) const {
  std::string words;
  for (const ErrorReport& error : errors)
    words += fmt::format("{}error {} (\"{}\")", words.empty() ? "" : ", ", error.code, error.words);
  fail(Fault::kRefused, fmt::format("{} to \"{}\"", words, command));
}

void Meter::configure(const std::vector<std::string>& commands) {
  for (const std::string& command : commands) {
    send(command);
    if (const std::vector<ErrorReport> errors = take_errors(); !errors.empty()) refuse(errors, command);
  }
}

std::vector<int> Meter::scan_list() {
  return query("ROUT:SCAN?", [](std::string_view text) -> std::optional<std::vector<int>> {
    const auto list = parse_block(text);
    return list ? parse_channel_list(*list) : std::nullopt;
  });
}

// ---- Scans

void Meter::begin_scan() {
  send("READ?");
  stage_ = Stage::kScanning;
  give_up_at_ = clock_.now() + plan_.patience;
}

std::optional<ScanOutcome> Meter::await_scan(Clock::Instant deadline) {
  while (stage_ != Stage::kIdle) {
    if (const auto reply = take_reply(std::min(deadline, give_up_at_)))
      if (auto outcome = interpret(*reply)) return outcome;
    if (check_reply(received_).check == wire::FrameCheck::kComplete) continue;
    const Clock::Instant now = clock_.now();
    if (now >= give_up_at_) run_out_of_time();
    if (now >= deadline) return std::nullopt;
  }
  return ScanOutcome{{}, clock_.now(), Fault::kNotReady, "an error ended the scan"};
}

/// The readings of a reply in the order of the plan: some voltmeters scan in the order of the channel
/// numbers, not of the list [unverified against a device].
std::optional<std::vector<ChannelReading>> Meter::decode_scan(std::string_view text,
                                                              std::string& complaint) const {
  const auto complain = [&](std::string_view what) {
    complaint = fmt::format("\"{}\" arrived in answer to \"READ?\", {}", shown(text), what);
    return std::nullopt;
  };
  const bool with_channels = !plan_.channels.empty();
  auto readings = parse_readings(text, with_channels);
  if (!readings) return complain("which is not a list of readings");
  const std::size_t wanted = with_channels ? plan_.channels.size() : 1;
  if (readings->size() != wanted)
    return complain(fmt::format("{} readings; required: {}", readings->size(), wanted));
  if (!with_channels) return readings;
  std::vector<ChannelReading> ordered;
  for (const int channel : plan_.channels) {
    const auto found = std::find_if(readings->begin(), readings->end(),
                                    [channel](const ChannelReading& r) { return r.channel == channel; });
    if (found == readings->end()) {
      return complain(
          fmt::format("which has no channel {}; required: {}", channel, channel_list(plan_.channels)));
    }
    ordered.push_back(*found);
  }
  return ordered;
}

/// The scan under way is lost. From here on everything up to the answer to *IDN? is discarded.
void Meter::resynchronise(Fault fault, std::string complaint) {
  fault_ = fault;
  complaint_ = std::move(complaint);
  stage_ = Stage::kAwaitingIdentity;
  identity_asked_ = 1;
  send("*IDN?");
  give_up_at_ = clock_.now() + kAnswerTime + plan_.patience;  // It may be measuring still.
}

void Meter::run_out_of_time() {
  skip(std::exchange(received_, {}));
  switch (stage_) {
    case Stage::kIdle:
      return;
    case Stage::kScanning:
      return resynchronise(Fault::kNoReply,
                           fmt::format("no reply to \"READ?\" within {:g} s", to_seconds(plan_.patience)));
    case Stage::kAwaitingErrors:
    case Stage::kAwaitingIdentity:
      if (stage_ == Stage::kAwaitingIdentity && identity_asked_ < kTries) {
        ++identity_asked_;
        send("*IDN?");
        give_up_at_ = clock_.now() + kAnswerTime;
        return;
      }
      stage_ = Stage::kAwaitingIdentity;
      identity_asked_ = 0;  // The next call asks again.
      fail(Fault::kNoReply, complaint_ + ", and no answer to \"*IDN?\" and \"SYST:ERR?\" after that");
  }
}

std::optional<ScanOutcome> Meter::interpret(const std::string& reply) {
  const std::string_view text = text_of(reply);
  switch (stage_) {
    case Stage::kIdle:
      break;
    case Stage::kScanning: {
      if (text == identity_text_) break;  // Late answer to an identity query that was sent twice.
      std::string complaint;
      if (auto readings = decode_scan(text, complaint)) {
        stage_ = Stage::kIdle;
        return ScanOutcome{*std::move(readings), last_arrival_, Fault::kNoReply, {}};
      }
      ++bad_frames_;
      resynchronise(Fault::kBadFrame, std::move(complaint));
      break;
    }
    case Stage::kAwaitingIdentity:
      if (text != identity_text_) break;
      stage_ = Stage::kAwaitingErrors;
      send("SYST:ERR?");
      give_up_at_ = clock_.now() + kAnswerTime;
      return std::nullopt;
    case Stage::kAwaitingErrors: {
      const auto report = parse_error(text);
      if (!report) break;
      if (report->code == 0) {
        stage_ = Stage::kIdle;
        return ScanOutcome{{}, last_arrival_, fault_, complaint_};
      }
      if (!is_query_error(report->code)) {
        stage_ = Stage::kIdle;
        refuse({*report}, "READ?");
      }
      send("SYST:ERR?");
      give_up_at_ = clock_.now() + kAnswerTime;
      return std::nullopt;
    }
  }
  skip(reply);
  return std::nullopt;
}

void Meter::leave(const std::vector<std::string>& commands) noexcept {
  try {
    for (const std::string& command : commands) send(command);
  } catch (...) {
    // On the way out: by the interface, failure is not reported.
  }
}

}  // namespace abcal::scpi
