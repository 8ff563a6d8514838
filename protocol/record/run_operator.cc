#include "protocol/record/run_operator.h"

#include <fmt/format.h>

#include <algorithm>

namespace abcal {
namespace {

/// Kinds of events. Their text is the name, for a verified one with the register's identity after the
/// separator.
constexpr std::string_view kVerifiedEvent = "operator logged in";
constexpr std::string_view kStatedEvent = "operator stated";
constexpr std::string_view kSeparator = ", register ";

}  // namespace

void note_operator(RunFile& file, const RunOperator& who, const std::string& utc) {
  if (who.name.empty()) return;
  if (who.verified()) {
    file.append_event(utc, kVerifiedEvent,
                      Message::bare(who.name + std::string(kSeparator) + who.register_identity));
  } else {
    file.append_event(utc, kStatedEvent, Message::bare(who.name));
  }
}

std::vector<RunOperator> operators_of(const StoredRun& run) {
  std::vector<RunOperator> operators;
  const auto add = [&](RunOperator who) {
    if (std::find(operators.begin(), operators.end(), who) == operators.end())
      operators.push_back(std::move(who));
  };
  for (const RunEvent& event : run.events) {
    const std::string text = event.text;
    if (event.kind == kStatedEvent) add({text, {}});
    if (event.kind != kVerifiedEvent) continue;
    const std::size_t at = text.rfind(kSeparator);
    if (at != std::string::npos) add({text.substr(0, at), text.substr(at + kSeparator.size())});
  }
  const auto stated = run.header.labels.find("operator.name");
  if (operators.empty() && stated != run.header.labels.end()) add({stated->second, {}});
  return operators;
}

std::string describe(const std::vector<RunOperator>& operators) {
  std::string words;
  for (const RunOperator& who : operators) {
    words += (words.empty() ? "" : ", ") + who.name;
    if (!who.verified()) words += fmt::format(" ({})", kNotVerified);
  }
  return words;
}

}  // namespace abcal
