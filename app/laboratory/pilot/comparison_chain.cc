#include "app/laboratory/pilot/comparison_chain.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/file.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "app/system/output_file.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

std::string link_of(const std::string& previous, const ChainEntry& entry) {
  return next_link(previous, {entry.act, entry.utc, entry.participant, std::to_string(entry.measurement),
                              entry.sha256, entry.file, entry.text});
}

nlohmann::ordered_json line_of(const ChainEntry& entry) {
  return {{"act", entry.act},
          {"utc", entry.utc},
          {"participant", entry.participant},
          {"measurement", entry.measurement},
          {"sha256", entry.sha256},
          {"file", entry.file},
          {"text", entry.text},
          {"link", entry.link}};
}

ChainEntry entry_of(const nlohmann::json& line) {
  return {.act = line.at("act"),
          .utc = line.at("utc"),
          .participant = line.at("participant"),
          .measurement = line.at("measurement"),
          .sha256 = line.at("sha256"),
          .file = line.at("file"),
          .text = line.at("text"),
          .link = line.at("link")};
}

/// Waits until no other process has the file.
Descriptor locked(const std::string& path) {
  Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  int result = -1;
  if (file.number() >= 0) {
    do result = ::flock(file.number(), LOCK_EX);
    while (result != 0 && errno == EINTR);
  }
  if (result != 0)
    throw ChainError(fmt::format(
        "{}: cannot be locked ({}), so that two results could be added at once and one of them be lost; "
        "required: a file system with locks",
        path, std::generic_category().message(errno)));
  return file;
}

}  // namespace

ComparisonChain::ComparisonChain(const ComparisonProtocol& protocol)
    : protocol_(protocol),
      file_(protocol.path + ".chain"),
      lock_(locked(protocol.path)),
      states_(protocol.schedule.size()) {
  std::ifstream file(file_);
  std::string line, previous;
  while (std::getline(file, line)) {
    const std::size_t number = entries_.size() + 1;
    try {
      const ChainEntry entry = entry_of(nlohmann::json::parse(line));
      if (entry.link != link_of(previous, entry))
        throw std::invalid_argument("its link is not that of its content");
      previous = entry.link;
      apply(entry);
      entries_.push_back(entry);
    } catch (const std::exception& error) {
      throw ChainError(fmt::format(
          "{}: entry {} was changed, moved or damaged ({}); required: the file as the program wrote it",
          file_.string(), number, error.what()));
    }
  }
}

std::size_t ComparisonChain::committed() const {
  return static_cast<std::size_t>(std::ranges::count_if(states_, [](const MeasurementState& state) {
    return !state.sha256.empty() || !state.withdrawn.empty();
  }));
}

void ComparisonChain::apply(const ChainEntry& entry) {
  if (entry.act == "protocol") accepted_ = entry.sha256;
  if (entry.act == "agree")
    agreed_.insert(entry.participant);
  else if (entry.act != "statement")
    agreed_.clear();
  if (entry.measurement == 0) return;
  MeasurementState& state = states_.at(static_cast<std::size_t>(entry.measurement) - 1);
  if (entry.act == "withdraw") {
    state.withdrawn = entry.text;
    return;
  }
  if (entry.act != "open")
    state = {.sha256 = entry.sha256, .file = {}, .committed_utc = entry.utc, .withdrawn = {}};
  state.file = entry.file;
}

void ComparisonChain::append(ChainEntry entry, Clock::UtcTime now) {
  entry.utc = format_utc(now);
  entry.link = link_of(head(), entry);
  apply(entry);
  entries_.push_back(std::move(entry));
  std::string text;
  for (const ChainEntry& each : entries_) text += line_of(each).dump() + "\n";
  OutputFile(file_).write(text);
}

void ComparisonChain::require_known(const std::string& participant) const {
  if (std::ranges::find(protocol_.participants, participant, &ProtocolParticipant::name) ==
      protocol_.participants.end()) {
    std::string known;
    for (const ProtocolParticipant& one : protocol_.participants)
      known += (known.empty() ? "" : ", ") + one.name;
    throw ChainError(
        fmt::format("{} is no participant of {}; required: one of {}", participant, protocol_.path, known));
  }
}

void ComparisonChain::require_new(const std::string& sha256) const {
  for (std::size_t k = 0; k < states_.size(); ++k)
    if (states_[k].sha256 == sha256)
      throw ChainError(fmt::format(
          "this result is that of measurement {} by {} already: a file counts once; required: the result of "
          "this measurement",
          k + 1, protocol_.schedule[k].participant));
}

void ComparisonChain::require_protocol() const {
  if (!accepted_.empty() && accepted_ != protocol_.sha256)
    throw ChainError(fmt::format(
        "{}: changed since the comparison began; required: the protocol as it was, or `abcal pilot add {} "
        "--protocol-change REASON`, which the report states",
        protocol_.path, protocol_.path));
}

std::string ComparisonChain::relative(const std::filesystem::path& file) const {
  if (file.empty()) return {};
  const std::filesystem::path folder = std::filesystem::absolute(file_).parent_path();
  const std::filesystem::path near =
      std::filesystem::absolute(file).lexically_normal().lexically_relative(folder.lexically_normal());
  return near.empty() ? std::filesystem::absolute(file).string() : near.generic_string();
}

std::filesystem::path ComparisonChain::path_of(const std::string& file) const {
  return file_.parent_path() / file;
}

int ComparisonChain::add_result(const std::string& participant, const std::string& sha256,
                                const std::filesystem::path& file, Clock::UtcTime now) {
  require_known(participant);
  require_protocol();
  if (accepted_.empty()) accept_protocol("", now);
  int number = 0;
  for (std::size_t k = 0; k < states_.size(); ++k) {
    if (protocol_.schedule[k].participant != participant) continue;
    const MeasurementState& state = states_[k];
    const int here = static_cast<int>(k) + 1;
    if (state.sha256 == sha256 && state.file.empty() && !file.empty()) {
      append({.act = "open",
              .participant = participant,
              .measurement = here,
              .sha256 = sha256,
              .file = relative(file)},
             now);
      return here;
    }
    if (number == 0 && state.sha256.empty() && state.withdrawn.empty()) number = here;
  }
  require_new(sha256);
  if (number == 0) {
    const bool waits = std::ranges::any_of(states_, [&](const MeasurementState& state) {
      const auto k = static_cast<std::size_t>(&state - states_.data());
      return protocol_.schedule[k].participant == participant && !state.sha256.empty() && state.file.empty();
    });
    throw ChainError(fmt::format(
        "{0}: all its measurements of the schedule have a result, and each counts once; {1}", participant,
        waits
            ? "this file has another SHA-256 than the one that was committed. Required: the committed file, "
              "or --replace REASON, which the report states"
            : "required: --replace REASON, which the report states as a late change"));
  }
  append({.act = "commit",
          .participant = participant,
          .measurement = number,
          .sha256 = sha256,
          .file = relative(file)},
         now);
  return number;
}

int ComparisonChain::replace_result(const std::string& participant, const std::string& sha256,
                                    const std::filesystem::path& file, const std::string& reason,
                                    Clock::UtcTime now) {
  require_known(participant);
  require_protocol();
  require_new(sha256);
  for (std::size_t k = states_.size(); k-- > 0;) {
    if (protocol_.schedule[k].participant != participant || states_[k].sha256.empty()) continue;
    append({.act = "replace",
            .participant = participant,
            .measurement = static_cast<int>(k) + 1,
            .sha256 = sha256,
            .file = relative(file),
            .text = fmt::format("{} (when {} of {} results were committed)", reason, committed(),
                                states_.size())},
           now);
    return static_cast<int>(k) + 1;
  }
  throw ChainError(participant + ": has no result that could be replaced");
}

void ComparisonChain::withdraw(const std::string& participant, const std::string& reason,
                               Clock::UtcTime now) {
  require_known(participant);
  for (std::size_t k = 0; k < states_.size(); ++k)
    if (protocol_.schedule[k].participant == participant && states_[k].withdrawn.empty())
      append({.act = "withdraw",
              .participant = participant,
              .measurement = static_cast<int>(k) + 1,
              .sha256 = states_[k].sha256,
              .file = states_[k].file,
              .text = reason},
             now);
}

void ComparisonChain::add_statement(const std::string& participant, const std::string& text,
                                    Clock::UtcTime now) {
  require_known(participant);
  append({.act = "statement", .participant = participant, .text = text}, now);
}

void ComparisonChain::agree(const std::string& participant, Clock::UtcTime now) {
  require_known(participant);
  require_protocol();
  if (!complete())
    throw ChainError(
        fmt::format("{}: {} of {} results are committed, so that there is no Draft A to agree with; "
                    "required: all results",
                    protocol_.path, committed(), states_.size()));
  const std::vector<std::string> waiting = not_agreed();
  if (std::ranges::find(waiting, participant) == waiting.end())
    throw ChainError(participant + (agreed_.contains(participant) ? ": has agreed already"
                                                                  : ": has no result that counts"));
  append({.act = "agree", .participant = participant}, now);
}

std::vector<std::string> ComparisonChain::not_agreed() const {
  std::vector<std::string> names;
  for (const ProtocolParticipant& one : protocol_.participants) {
    bool takes_part = false;
    for (std::size_t k = 0; k < states_.size(); ++k)
      takes_part =
          takes_part || (protocol_.schedule[k].participant == one.name && states_[k].withdrawn.empty());
    if (takes_part && !agreed_.contains(one.name)) names.push_back(one.name);
  }
  return names;
}

void ComparisonChain::require_agreement() const {
  const std::vector<std::string> names = not_agreed();
  if (!names.empty())
    throw ChainError(
        fmt::format("{0}: Draft B needs the agreement of all participants with Draft A; missing: {1}; "
                    "required: `abcal pilot "
                    "add {0} --participant NAME --agree` for each, when it has read Draft A",
                    protocol_.path, fmt::join(names, ", ")));
}

void ComparisonChain::accept_protocol(const std::string& reason, Clock::UtcTime now) {
  append({.act = "protocol", .sha256 = protocol_.sha256, .text = reason}, now);
}

std::vector<std::string> ComparisonChain::changes() const {
  std::vector<std::string> sentences;
  bool first = true;
  for (const ChainEntry& entry : entries_) {
    const std::string day = entry.utc.substr(0, 10);
    if (entry.act == "protocol" && !std::exchange(first, false))
      sentences.push_back(fmt::format("{}: the protocol was changed: {}", day, entry.text));
    if (entry.act == "replace")
      sentences.push_back(fmt::format("{}: {} replaced its result of measurement {}: {}", day,
                                      entry.participant, entry.measurement, entry.text));
    if (entry.act == "withdraw")
      sentences.push_back(
          fmt::format("{}: the result of measurement {} by {} was withdrawn and does not count: {}", day,
                      entry.measurement, entry.participant, entry.text));
  }
  return sentences;
}

}  // namespace abcal
