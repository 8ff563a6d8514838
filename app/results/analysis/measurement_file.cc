#include "app/results/analysis/measurement_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <utility>

#include "app/results/analysis/other_file.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSchema = "abcal.measurement/1";
constexpr std::size_t kLargestFile = 1'000'000;  // bytes: a thousand runs

std::filesystem::path folder_of(const std::filesystem::path& measurement) {
  return std::filesystem::absolute(measurement).lexically_normal().parent_path();
}

Json part_json(const MeasurementPart& part, const std::filesystem::path& folder) {
  const std::filesystem::path file = std::filesystem::absolute(part.path).lexically_normal();
  return {{"file", file.lexically_relative(folder).generic_string()}, {"sha256", part.sha256}};
}

/// The files of a folder by their SHA-256, hashed when one is looked for.
class FolderByHash {
 public:
  explicit FolderByHash(std::filesystem::path folder) : folder_(std::move(folder)) {}

  std::optional<std::filesystem::path> find(const std::string& sha256, const std::string& extension) {
    if (hashed_.insert(extension).second) hash(extension);
    const auto found = files_.find(sha256);
    return found == files_.end() ? std::nullopt : std::optional(found->second);
  }

 private:
  void hash(const std::string& extension) {
    std::error_code error;
    const std::filesystem::path where = folder_.empty() ? "." : folder_;
    for (const auto& entry : std::filesystem::directory_iterator(where, error))
      if (entry.is_regular_file(error) && entry.path().extension() == extension)
        files_.emplace(sha256_of_file(entry.path()), folder_ / entry.path().filename());
  }

  std::filesystem::path folder_;
  std::set<std::string> hashed_;  ///< Extensions.
  std::map<std::string, std::filesystem::path> files_;
};

/// Finds where a part is now, if it was renamed.
/// @param folder  of the measurement
/// @param problems  receives the problem of a part that is not found
void find_part(MeasurementPart& part, const std::filesystem::path& folder, FolderByHash& others,
               std::vector<std::string>& problems) {
  std::error_code error;
  const bool is_there = std::filesystem::is_regular_file(part.path, error);
  if (is_there && sha256_of_file(part.path) == part.sha256) return;
  const std::string extension = part.path.extension().string();
  if (const auto found = others.find(part.sha256, extension)) {
    part.path = *found;
    return;
  }
  const std::string name = part.path.lexically_relative(folder).generic_string();
  problems.push_back(
      is_there ? fmt::format("{} was changed after the measurement was made: its SHA-256 is not {}", name,
                             part.sha256)
               : fmt::format("{} is not there, nor is another file with its SHA-256 ({}) in {}", name,
                             part.sha256, folder.empty() ? std::string("this folder") : folder.string()));
}

[[noreturn]] void refuse(const std::filesystem::path& path, const std::string& why) {
  throw std::runtime_error(fmt::format("{}: {}", path.string(), why));
}

Json parsed(const std::filesystem::path& path) {
  return Json::parse(read_file(path, kLargestFile), nullptr, false);
}

constexpr const char* kAsWritten = "required: the file that abcal combine wrote";

/// All but the files.
MeasurementFile read_header(const std::filesystem::path& path, const Json& json) {
  MeasurementFile measurement;
  try {
    if (const auto schema = json.at("schema").get<std::string>(); schema != kSchema)
      refuse(path,
             fmt::format("schema {}; required: {}, which this version of abcal reads", schema, kSchema));
    measurement.created_utc = json.at("created_utc").get<std::string>();
    measurement.program_version = json.at("program_version").get<std::string>();
    measurement.items = json.at("items").get<int>();
  } catch (const nlohmann::json::exception& error) {
    refuse(path, fmt::format("is no complete measurement: {}; {}", error.what(), kAsWritten));
  }
  return measurement;
}

}  // namespace

bool looks_like_measurement(const std::filesystem::path& path) {
  const std::string start = beginning_of_file(path);
  return start.starts_with('{') && start.find("\"abcal.measurement/") < 64;
}

MeasurementFile listed_measurement(const std::filesystem::path& path) {
  const Json json = parsed(path);
  MeasurementFile measurement = read_header(path, json);
  const std::filesystem::path folder = path.parent_path();  // As the user names it.
  const auto part_of = [&](const Json& part) {
    return MeasurementPart{folder / part.at("file").get<std::string>(), part.at("sha256").get<std::string>()};
  };
  try {
    for (const Json& run : json.at("runs")) measurement.runs.push_back(part_of(run));
    if (const auto record = json.find("stage_record"); record != json.end())
      measurement.stage_record = part_of(*record);
  } catch (const nlohmann::json::exception& error) {
    refuse(path, fmt::format("is no complete measurement: {}; {}", error.what(), kAsWritten));
  }
  return measurement;
}

MeasurementFile read_measurement(const std::filesystem::path& path) {
  MeasurementFile measurement = listed_measurement(path);
  std::vector<std::string> problems;
  FolderByHash others(path.parent_path());
  for (MeasurementPart& run : measurement.runs) find_part(run, path.parent_path(), others, problems);
  if (measurement.stage_record) find_part(*measurement.stage_record, path.parent_path(), others, problems);
  if (!problems.empty())
    refuse(path, fmt::format("{}; required: each file as it was, in that place or beside the measurement",
                             fmt::join(problems, "; ")));
  if (measurement.runs.size() < 2) refuse(path, "names fewer than two runs; required: two or more");
  return measurement;
}

std::vector<std::string> runs_of_file(const std::string& file) {
  if (!looks_like_measurement(file)) return {file};
  std::vector<std::string> runs;
  for (const MeasurementPart& part : read_measurement(file).runs) runs.push_back(part.path.string());
  return runs;
}

bool write_measurement(const std::filesystem::path& path, const MeasurementFile& measurement) {
  const std::filesystem::path folder = folder_of(path);
  Json json{{"schema", kSchema},
            {"created_utc", measurement.created_utc},
            {"program_version", measurement.program_version},
            {"items", measurement.items},
            {"runs", Json::array()}};
  for (const MeasurementPart& run : measurement.runs) json["runs"].push_back(part_json(run, folder));
  if (measurement.stage_record) json["stage_record"] = part_json(*measurement.stage_record, folder);
  std::error_code error;
  if (!std::filesystem::exists(path, error)) {
    OutputFile(path).write_new(json.dump(2) + "\n");
    return true;
  }
  const auto hashes = [](const MeasurementFile& of) {
    std::vector<std::string> list;
    for (const MeasurementPart& run : of.runs) list.push_back(run.sha256);
    list.push_back(of.stage_record ? of.stage_record->sha256 : "");
    return list;
  };
  if (!looks_like_measurement(path) || hashes(read_measurement(path)) != hashes(measurement))
    throw std::invalid_argument(fmt::format(
        "-o {}: exists and is not the measurement of these runs; required: a new file, as nothing is written "
        "over",
        path.string()));
  return false;
}

}  // namespace abcal
