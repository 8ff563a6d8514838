#include "app/console/last_check.h"

#include <fmt/format.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "app/document/json_text.h"
#include "app/system/output_file.h"

namespace abcal::console {
namespace {

using CheckJson = nlohmann::ordered_json;

std::filesystem::path check_file(const std::filesystem::path& runs, const std::filesystem::path& bench_file) {
  return runs / fmt::format(".{}.check.json", bench_file.stem().string());
}

}  // namespace

bool keep_check(const std::filesystem::path& runs, const std::filesystem::path& bench_file,
                const LastCheck& check) {
  const CheckJson json = {{"utc", check.utc},
                          {"by", check.by},
                          {"with_motion", check.with_motion},
                          {"good", check.good},
                          {"warnings", check.warnings},
                          {"problems", check.problems}};
  try {
    OutputFile(check_file(runs, bench_file)).write(json_text(json));
  } catch (const std::runtime_error&) {
    return false;
  }
  return true;
}

std::optional<LastCheck> last_check(const std::filesystem::path& runs,
                                    const std::filesystem::path& bench_file) {
  std::ifstream file(check_file(runs, bench_file));
  const CheckJson json = CheckJson::parse(file, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) return std::nullopt;
  try {
    return LastCheck{json.at("utc"),  json.at("by"),       json.at("with_motion"),
                     json.at("good"), json.at("warnings"), json.at("problems")};
  } catch (const CheckJson::exception&) {
    return std::nullopt;
  }
}

LastCheck count_findings(const std::vector<Finding>& findings) {
  LastCheck check;
  for (const Finding& finding : findings) {
    if (finding.grade == Finding::Grade::kGood) ++check.good;
    if (finding.grade == Finding::Grade::kWarning) ++check.warnings;
    if (finding.grade == Finding::Grade::kProblem) ++check.problems;
  }
  return check;
}

}  // namespace abcal::console
