#include "app/console/comparisons.h"

#include <algorithm>
#include <exception>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "app/document/document_html.h"
#include "app/laboratory/pilot/pilot_document.h"
#include "app/system/read_file.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_file.h"

namespace abcal::console {

using Path = std::filesystem::path;

Comparisons::Comparisons(std::vector<Path> folders, std::string register_location)
    : folders_(std::move(folders)), register_location_(std::move(register_location)) {}

std::vector<Path> Comparisons::files() const {
  std::vector<Path> found;
  for (const Path& folder : folders_) {
    std::error_code unreadable;
    for (const auto& entry : std::filesystem::directory_iterator(folder, unreadable)) {
      const Path& file = entry.path();
      if (file.extension() != ".toml" || !entry.is_regular_file(unreadable) ||
          std::ranges::find(found, file.filename(), &Path::filename) != found.end())
        continue;
      try {
        if (read_file(file).find(kComparisonSchema) != std::string::npos) found.push_back(file);
      } catch (const std::exception&) {
        continue;  // A file that cannot be read is not known to be a protocol.
      }
    }
  }
  std::ranges::sort(found, {}, [](const Path& file) { return file.filename(); });
  return found;
}

std::optional<Path> Comparisons::find(const std::string& name) const {
  for (const Path& file : files())
    if (file.filename() == name) return file;
  return std::nullopt;
}

nlohmann::ordered_json Comparisons::list() const {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const Path& file : files()) {
    nlohmann::ordered_json one;
    try {
      const ComparisonProtocol protocol = read_comparison_protocol(file);
      one = pilot_status_json(protocol, ComparisonChain(protocol));
    } catch (const std::exception& error) {
      one = {{"error", error.what()}};
    }
    one["file"] = file.filename().string();
    list.push_back(std::move(one));
  }
  return list;
}

nlohmann::ordered_json Comparisons::outcome(const Path& protocol, Clock::UtcTime now) const {
  const PilotAnalysis analysis = analyse_comparison(protocol, register_location_, now);
  const Message verdict = analysis.verdict();
  return {
      {"agree", analysis.agree()}, {"verdict", verdict.english()}, {"messages", messages_json({verdict})}};
}

std::string Comparisons::draft(const Path& protocol, Clock::UtcTime now) const {
  return document_html(
      pilot_document(analyse_comparison(protocol, register_location_, now), PilotDraft::kA, format_utc(now)));
}

}  // namespace abcal::console
