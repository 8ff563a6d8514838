#include "app/bench_file/stage_record_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <iomanip>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSchema = "abcal.stage-record/1";

Json json_of(const SizeFound& size, const char* unit) {
  Json density = Json::array();
  for (const auto& [value, log] : size.log_density) density.push_back({value, log});
  return {{"most_probable", size.most_probable},
          {"rms", size.rms},
          {"lower", size.lower},
          {"upper", size.upper},
          {"unit", unit},
          {"log_density", std::move(density)}};
}

double finite(const Json& json, const char* what) {
  const double value = json.at(what).get<double>();
  if (!std::isfinite(value)) throw std::invalid_argument(fmt::format("{} is not a finite number", what));
  return value;
}

SizeFound size_from(const Json& json) {
  SizeFound out{finite(json, "most_probable"), finite(json, "rms"), finite(json, "lower"),
                finite(json, "upper")};
  if (!(out.rms > 0.0) || !(out.upper > 0.0)) throw std::invalid_argument("a size that is not above 0");
  for (const Json& point : json.at("log_density"))
    out.log_density.emplace_back(point.at(0).get<double>(), point.at(1).get<double>());
  for (std::size_t i = 0; i < out.log_density.size(); ++i)
    if (!(out.log_density[i].first > (i == 0 ? 0.0 : out.log_density[i - 1].first)))
      throw std::invalid_argument("sizes of a density that do not ascend");
  if (out.log_density.size() == 1) throw std::invalid_argument("a density at one size");
  return out;
}

Json state_json(const StageState& state) {
  Json unknowns = Json::array(), rows = Json::array();
  for (Eigen::Index i = 0; i < state.size(); ++i) {
    Json one{{"name", state.name_of(i)}};
    if (const auto angle = i - static_cast<Eigen::Index>(state.names.size()); angle >= 0) {
      const AxisAngle& at = state.angles[static_cast<std::size_t>(angle)];
      one["axis"] = std::string(1, at.axis);
      one["microdegrees"] = at.microdegrees;
    }
    one["value"] = state.mean(i);
    one["standard_uncertainty"] = std::sqrt(state.covariance(i, i));
    unknowns.push_back(std::move(one));
    Json row = Json::array();
    for (Eigen::Index k = 0; k <= i; ++k) row.push_back(state.covariance(i, k));
    rows.push_back(std::move(row));
  }
  return {{"unknowns", std::move(unknowns)}, {"covariance_lower", std::move(rows)}};
}

StageState state_from(const Json& json) {
  StageState out;
  const Json& unknowns = json.at("unknowns");
  const auto count = static_cast<Eigen::Index>(unknowns.size());
  out.mean.resize(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Json& one = unknowns[static_cast<std::size_t>(i)];
    if (one.contains("axis")) {
      const std::string axis = one.at("axis");
      if (axis != "X" && axis != "Z") throw std::invalid_argument("an axis other than X and Z");
      out.angles.push_back({axis[0], one.at("microdegrees").get<std::int64_t>()});
    } else if (out.angles.empty()) {
      out.names.push_back(one.at("name"));
    } else {
      throw std::invalid_argument("an unknown after the fine map");
    }
    out.mean(i) = finite(one, "value");
  }
  if (!std::ranges::is_sorted(out.angles) || std::ranges::adjacent_find(out.angles) != out.angles.end())
    throw std::invalid_argument("angles of the fine map that do not ascend");
  const Json& rows = json.at("covariance_lower");
  if (rows.size() != unknowns.size()) throw std::invalid_argument("a covariance of another size");
  out.covariance.resize(count, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Json& row = rows[static_cast<std::size_t>(i)];
    if (static_cast<Eigen::Index>(row.size()) != i + 1)
      throw std::invalid_argument("a row of the covariance of another length");
    for (Eigen::Index k = 0; k <= i; ++k)
      out.covariance(i, k) = out.covariance(k, i) = row[static_cast<std::size_t>(k)].get<double>();
    if (!(out.covariance(i, i) > 0.0)) throw std::invalid_argument("a variance that is not above 0");
  }
  if (!out.covariance.allFinite()) throw std::invalid_argument("a covariance that is not finite");
  return out;
}

Json learning_json(const Learning& learning) {
  Json runs = Json::array();
  for (const TeachingRun& run : learning.runs)
    runs.push_back(
        {{"file", run.file}, {"sha256", run.sha256}, {"item", run.item}, {"mounting", run.mounting}});
  return {{"utc", learning.utc}, {"by", learning.by}, {"runs", std::move(runs)}};
}

StageRecord record_from(const Json& json) {
  if (json.at("schema") != kSchema) throw std::invalid_argument(fmt::format("its schema is not {}", kSchema));
  StageRecord out;
  const Json& stage = json.at("stage");
  out.identity = {stage.at("maker"), stage.at("model"), stage.at("serial_number"), stage.at("firmware"),
                  stage.at("axes")};
  for (const EffectSizeKey& key : effect_size_keys())
    if (key.section == "stage_uncertainty") {
      const double size = finite(json.at("sizes"), std::string(key.key).c_str());
      if (size < 0.0 || size > key.most)
        throw std::invalid_argument(fmt::format("{} = {}; required: 0 to {}", key.key, size, key.most));
      key.set(out.sizes, size);
    }
  out.state = state_from(json.at("state"));
  for (const RepeatPart part : kAllRepeatParts)
    out.repeatabilities[static_cast<std::size_t>(part)] =
        size_from(json.at("repeatability").at(std::string(to_string(part))));
  out.growth = size_from(json.at("growth"));
  for (const Json& learning : json.at("learnings")) {
    Learning one{learning.at("utc"), learning.at("by"), {}};
    for (const Json& run : learning.at("runs"))
      one.runs.push_back({run.at("file"), run.at("sha256"), run.at("item"), run.at("mounting")});
    out.learnings.push_back(std::move(one));
  }
  if (out.learnings.empty()) throw std::invalid_argument("no run taught it");
  return out;
}

std::string axis_words(char name, const StageAxisConfig& axis) {
  return fmt::format("{}: axis {}, sign {:+d}, zero {:g} degrees", name, axis.axis, axis.sign,
                     axis.zero.deg());
}

std::time_t time_of(std::string_view utc) {
  std::tm time{};
  std::istringstream(std::string(utc)) >> std::get_time(&time, "%Y-%m-%dT%H:%M:%S");
  return ::timegm(&time);
}

}  // namespace

nlohmann::ordered_json stage_record_json(const StageRecord& record) {
  Json sizes = Json::object(), repeatability = Json::object(), learnings = Json::array();
  for (const EffectSizeKey& key : effect_size_keys())
    if (key.section == "stage_uncertainty") sizes[std::string(key.key)] = key.get(record.sizes);
  for (const RepeatPart part : kAllRepeatParts)
    repeatability[std::string(to_string(part))] =
        json_of(record.repeatabilities[static_cast<std::size_t>(part)], "radian");
  for (const Learning& learning : record.learnings) learnings.push_back(learning_json(learning));
  return {{"schema", kSchema},
          {"stage",
           {{"maker", record.identity.maker},
            {"model", record.identity.model},
            {"serial_number", record.identity.serial_number},
            {"firmware", record.identity.firmware},
            {"axes", record.identity.axes}}},
          {"learnings", std::move(learnings)},
          {"sizes", std::move(sizes)},
          {"repeatability", std::move(repeatability)},
          {"growth", json_of(record.growth, "of the stated size, in one month")},
          {"state", state_json(record.state)}};
}

StageRecord parse_stage_record(const std::string& text, const std::string& source) {
  try {
    StageRecord record = record_from(Json::parse(text));
    record.sha256 = sha256_of(text);
    return record;
  } catch (const nlohmann::json::parse_error&) {
    throw std::invalid_argument(
        fmt::format("{}: not JSON; required: a stage record, made by `abcal stage learn`", source));
  } catch (const std::exception& error) {
    throw std::invalid_argument(
        fmt::format("{}: not a stage record of `abcal stage learn`: {}", source, error.what()));
  }
}

StageRecord read_stage_record(const std::filesystem::path& path) {
  return parse_stage_record(read_file(path), path.string());
}

void write_stage_record(const std::filesystem::path& path, const StageRecord& record) {
  OutputFile(path).write_new(stage_record_json(record).dump() + "\n");
}

StageIdentity stage_identity(const InstrumentIdentity& stage, const StageConfig& config) {
  return {stage.maker, stage.model, stage.serial_number, stage.firmware,
          axis_words('X', config.x) + "; " + axis_words('Z', config.z)};
}

StageIdentity stage_identity(const StoredRun& run) {
  const auto stage =
      std::ranges::find(run.header.instruments, std::string_view("stage"), &InstrumentIdentity::role);
  return stage_identity(stage == run.header.instruments.end() ? InstrumentIdentity{} : *stage,
                        parse_bench(run.header.bench_toml, "the bench file in the run").stage);
}

double months_between(std::string_view earlier_utc, std::string_view later_utc) {
  constexpr double kSecondsOfMonth = 30.44 * 86'400.0;
  return std::max(0.0, std::difftime(time_of(later_utc), time_of(earlier_utc)) / kSecondsOfMonth);
}

}  // namespace abcal
