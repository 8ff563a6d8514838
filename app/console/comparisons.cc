#include "app/console/comparisons.h"

#include <algorithm>
#include <exception>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "app/console/run_index.h"
#include "app/document/document_html.h"
#include "app/laboratory/pilot/pilot_document.h"
#include "app/system/read_file.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_file.h"

namespace abcal::console {

using Path = std::filesystem::path;

Comparisons::Comparisons(std::vector<Path> folders, std::string register_location)
    : folders_(std::move(folders)), register_location_(std::move(register_location)) {}

namespace {

bool is_protocol(const Path& file) {
  if (!is_own_file(file, ".toml")) return false;
  try {
    return read_file(file).find(kComparisonSchema) != std::string::npos;
  } catch (const std::exception&) {
    return false;  // A file that cannot be read is not known to be a protocol.
  }
}

}  // namespace

std::vector<Path> Comparisons::files() const {
  std::vector<Path> found;
  for (const Path& folder : folders_) {
    std::error_code unreadable;
    for (const auto& entry : std::filesystem::directory_iterator(folder, unreadable)) {
      const Path& file = entry.path();
      if (std::ranges::find(found, file.filename(), &Path::filename) == found.end() && is_protocol(file))
        found.push_back(file);
    }
  }
  std::ranges::sort(found, {}, [](const Path& file) { return file.filename(); });
  return found;
}

std::optional<Path> Comparisons::find(const std::string& name) const {
  if (Path(name).filename() != name) return std::nullopt;  // It would lead out of the folder.
  for (const Path& folder : folders_)
    if (is_protocol(folder / name)) return folder / name;
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
