#include "app/results/report/record_hdf5.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/document/data_tree.h"
#include "app/results/analysis/result_json.h"
#include "app/results/analysis/result_text.h"
#include "app/results/analysis/tray_results.h"
#include "protocol/estimators/checks/check_poses.h"
#include "protocol/quantities/quantity_groups.h"

namespace abcal {
namespace {

constexpr const char* kNoUnit = "1";
constexpr const char* kFaceMeaning = "1, or 2: the axis that stands is turned by 180 degrees more";

using Attributes = std::map<std::string, DataNode::Attribute>;

/// A group, and the stream for what is put into it.
struct Group {
  std::ostream& tree;
  std::string path;

  std::string path_of(const std::string& name) const { return path + "/" + name; }
};

Group group(const Group& parent, const std::string& name, const std::string& nexus_class,
            Attributes attributes = {}) {
  attributes["NX_class"] = nexus_class;
  Group made{parent.tree, parent.path_of(name)};
  write_node({made.path, DataNode::Group{}, false, std::move(attributes)}, made.tree);
  return made;
}

/// Writes a text, unless it is empty.
void put(const Group& parent, const std::string& name, const std::string& text) {
  if (!text.empty()) write_node({parent.path_of(name), text, false, {}}, parent.tree);
}

/// Unit and description of the numbers of a dataset.
struct Meaning {
  std::string unit;
  std::string long_name = {};
};

/// A unit of abcal in the spelling of UDUNITS, where "g" is the gram and standard gravity is "gravity". Units
/// per g_loc are written without it: local gravity is no unit (conditions/g_loc has its value).
std::string udunits(std::string unit) {
  constexpr std::string_view kPerLocalGravity = "/g_loc";
  if (const std::size_t at = unit.find(kPerLocalGravity); at != std::string::npos)
    unit.erase(at, kPerLocalGravity.size());
  if (unit.size() > 2 && unit.front() == '(' && unit.back() == ')') unit = unit.substr(1, unit.size() - 2);
  static const std::map<std::string, std::string> kNames{{"g", "gravity"},       {"mg", "milligravity"},
                                                         {"ug", "microgravity"}, {"m/s2", "m s-2"},
                                                         {"m/s^2", "m s-2"},     {"LSB", "count"}};
  const auto known = kNames.find(unit);
  return known == kNames.end() ? unit : known->second;
}

/// `units` for other programs, `unit` as abcal writes it everywhere else.
Attributes described(const Meaning& meaning) {
  const std::string units = udunits(meaning.unit);
  Attributes attributes{{"units", units}};
  if (units != meaning.unit) attributes["unit"] = meaning.unit;
  if (!meaning.long_name.empty()) attributes["long_name"] = meaning.long_name;
  return attributes;
}

using Shape = std::vector<std::size_t>;

/// Values row by row.
template <class Number>
void put(const Group& parent, const std::string& name, const std::vector<Number>& values, const Shape& shape,
         const Meaning& meaning) {
  write_node({parent.path_of(name), DataNode::Array<Number>{shape, values}, false, described(meaning)},
             parent.tree);
}

void put(const Group& parent, const std::string& name, double value, const Meaning& meaning) {
  put(parent, name, std::vector<double>{value}, {}, meaning);
}

void put(const Group& parent, const std::string& name, const std::vector<std::int64_t>& values,
         const std::string& long_name = {}) {
  put(parent, name, values, {values.size()}, {kNoUnit, long_name});
}

/// A dataset that grows by rows: a long run need not fit into memory.
template <class Number>
class Column {
 public:
  /// @param width  numbers of a row
  Column(const Group& parent, const std::string& name, std::size_t width, const Meaning& meaning)
      : tree_(parent.tree), path_(parent.path_of(name)), width_(width) {
    write_node({path_, rows({}), true, described(meaning)}, tree_);
  }

  void append(std::vector<Number> values) {
    if (!values.empty()) write_node({path_, rows(std::move(values)), true, {}}, tree_);
  }

 private:
  DataNode::Array<Number> rows(std::vector<Number> values) const {
    const std::size_t count = values.size() / width_;
    return {width_ > 1 ? Shape{count, width_} : Shape{count}, std::move(values)};
  }

  std::ostream& tree_;
  std::string path_;
  std::size_t width_;
};

double or_nan(const std::optional<double>& value) {
  return value.value_or(std::numeric_limits<double>::quiet_NaN());
}

/// Names the dataset of a group that programs plot, and the dataset of its axis (NeXus).
Attributes plotted(const std::string& signal, const std::string& axis) {
  return {{"signal", signal},
          {"axes", std::vector<std::string>{axis, "."}},
          {axis + "_indices", std::int64_t{0}}};  // the first dimension
}

// --- Groups ------------------------------------------------------------------------------------------------

void put_averaged(const Group& entry, const RunRecord& record) {
  const Group data = group(entry, "averaged", "NXdata", plotted("response", "alpha"));
  std::vector<double> alpha, response, errors, spread, time, settle, temperature, encoder;
  std::vector<std::int64_t> experiment, n, closing, count, lost, flags, face;
  const auto degrees = [](const std::optional<Angle>& angle) {
    return angle ? angle->deg() : std::numeric_limits<double>::quiet_NaN();
  };
  for (const DwellRecord& dwell : record.dwells) {
    experiment.push_back(dwell.experiment);
    n.push_back(dwell.n);
    closing.push_back(dwell.closing ? 1 : 0);
    count.push_back(dwell.count);
    lost.push_back(dwell.lost);
    flags.push_back(dwell.flags);
    face.push_back(dwell.face);
    alpha.push_back(dwell.alpha.deg());
    time.push_back(or_nan(dwell.time_s));
    settle.push_back(dwell.settle_time_s);
    temperature.push_back(or_nan(dwell.temperature_degc));
    encoder.push_back(degrees(dwell.encoder_x));
    encoder.push_back(degrees(dwell.encoder_z));
    for (int j = 0; j < 3; ++j) {
      response.push_back(dwell.mean[j]);
      errors.push_back(dwell.u_mean ? (*dwell.u_mean)[j] : std::numeric_limits<double>::quiet_NaN());
      spread.push_back(dwell.spread[j]);
    }
  }
  const std::size_t size = record.dwells.size();
  const std::string& unit = record.response_unit;
  put(data, "alpha", alpha, {size}, {"degree", "desired rotation angle"});
  put(data, "response", response, {size, 3}, {unit, "averaged readings of U, V, W"});
  put(data, "response_errors", errors, {size, 3}, {unit, "standard uncertainty of the averaged readings"});
  put(data, "spread", spread, {size, 3}, {unit, "standard deviation of single readings"});
  put(data, "encoder", encoder, {size, 2}, {"degree", "encoders of X and Z"});
  put(data, "time", time, {size}, {"s", "middle of the dwell from the start of the run"});
  put(data, "settle_time", settle, {size}, {"s", "from stopped to the first reading used"});
  put(data, "temperature", temperature, {size}, {"degree_Celsius", "temperature of the sensor"});
  put(data, "experiment", experiment, "rotation experiment 1, 2, 3");
  put(data, "n", n, "index of the angle from 1");
  put(data, "face", face, kFaceMeaning);
  put(data, "closing", closing, "1: the first angle measured again, not part of the fits");
  put(data, "count", count, "readings averaged");
  put(data, "lost", lost, "readings lost");
  put(data, "flags", flags, "bits, docs/report.md");
}

/// The dwells at the check poses, and their evaluation.
void put_check_poses(const Group& entry, const RunRecord& record) {
  if (record.check_poses.empty()) return;
  const Group made = group(entry, "check_poses", "NXdata", plotted("response", "time"));
  const std::string& unit = record.response_unit;
  std::vector<double> response, errors, time;
  std::vector<std::int64_t> pose, after, flags;
  for (const CheckDwell& check : record.check_poses) {
    const DwellRecord& dwell = check.dwell;
    pose.push_back(dwell.n);
    after.push_back(static_cast<std::int64_t>(check.after));
    flags.push_back(dwell.flags);
    time.push_back(or_nan(dwell.time_s));
    for (int j = 0; j < 3; ++j) {
      response.push_back(dwell.mean[j]);
      errors.push_back(dwell.u_mean ? (*dwell.u_mean)[j] : std::numeric_limits<double>::quiet_NaN());
    }
  }
  const std::size_t size = record.check_poses.size();
  put(made, "response", response, {size, 3}, {unit, "averaged readings of U, V, W"});
  put(made, "response_errors", errors, {size, 3}, {unit, "standard uncertainty of the averaged readings"});
  put(made, "time", time, {size}, {"s", "middle of the dwell from the start of the run"});
  put(made, "pose", pose, "1: gravity along (1, 1, 1), 2: against it");
  put(made, "after", after, "angles of the experiments measured before");
  put(made, "flags", flags, "bits, docs/report.md");
  const std::optional<CheckPoseStudy> study = compared_check_poses(record);
  if (!study) return;
  std::vector<double> difference, difference_errors;
  std::vector<std::int64_t> difference_pose, difference_visit;
  for (const PoseDifference& each : study->differences) {
    difference_pose.push_back(each.pose);
    difference_visit.push_back(static_cast<std::int64_t>(each.visit) + 1);
    difference.insert(difference.end(), each.value.begin(), each.value.end());
    difference_errors.insert(difference_errors.end(), each.standard_uncertainty.begin(),
                             each.standard_uncertainty.end());
  }
  const std::size_t differences = study->differences.size();
  put(made, "difference", difference, {differences, 3}, {unit, "reading minus that of the first visit"});
  put(made, "difference_errors", difference_errors, {differences, 3},
      {unit, "standard uncertainty (k = 1) of difference, of the two readings alone"});
  put(made, "difference_pose", difference_pose, "pose of each difference");
  put(made, "difference_visit", difference_visit, "visit of each difference, from 2");
  const auto trends = [&](const std::string& name, const std::array<PoseTrend, 3>& of_outputs) {
    std::vector<double> change, change_errors, smallest;
    for (const PoseTrend& trend : of_outputs) {
      change.push_back(trend.change);
      change_errors.push_back(trend.standard_uncertainty);
      smallest.push_back(trend.smallest_found);
    }
    put(made, name, change, {3},
        {kNoUnit, "of the sensitivity of U, V, W, from the first visit to the last"});
    put(made, name + "_errors", change_errors, {3}, {kNoUnit, "standard uncertainty (k = 1) of " + name});
    put(made, name + "_smallest_found", smallest, {3},
        {kNoUnit, "a change of this size between two visits would have been found"});
  };
  trends("change_of_gain", study->gain);
  trends("change_of_offset", study->offset);
}

void put_readings(const Group& entry, const ReportData& data) {
  const Group readings = group(entry, "readings", "NXdata", plotted("response", "time"));
  using Reals = Column<double>;
  using Wholes = Column<std::int64_t>;
  Reals response(readings, "response", 3, {data.record.response_unit, "single readings of U, V, W"});
  Reals time(readings, "time", 1, {"s", "arrival, from the start of the run"});
  Reals temperature(readings, "temperature", 1, {"degree_Celsius", "temperature of the sensor"});
  Wholes sequence(readings, "sequence", 1, {kNoUnit, "count of the accelerometer; a gap is a loss"});
  Wholes experiment(readings, "experiment", 1, {kNoUnit, "rotation experiment 1, 2, 3"});
  Wholes n(readings, "n", 1, {kNoUnit, "index of the angle from 1"});
  Wholes face(readings, "face", 1, {kNoUnit, kFaceMeaning});
  Wholes closing(readings, "closing", 1, {kNoUnit, "1: the first angle measured again"});
  Wholes repeat(readings, "repeat", 1, {kNoUnit, "1: measured again for comparison; the first counts"});
  RunFile::read_dwells(
      data.path,
      [&](const StoredDwell& dwell) {
        std::vector<double> outputs, times, temperatures;
        std::vector<std::int64_t> sequences;
        for (const StoredReading& reading : dwell.readings) {
          outputs.insert(outputs.end(), reading.output.begin(), reading.output.end());
          times.push_back(reading.time_s);
          temperatures.push_back(or_nan(reading.temperature_degc));
          sequences.push_back(static_cast<std::int64_t>(reading.sequence));
        }
        const auto same = [&](std::int64_t value) {
          return std::vector<std::int64_t>(dwell.readings.size(), value);
        };
        response.append(std::move(outputs));
        time.append(std::move(times));
        temperature.append(std::move(temperatures));
        sequence.append(std::move(sequences));
        experiment.append(same(dwell.experiment));
        n.append(same(dwell.n));
        face.append(same(dwell.face));
        closing.append(same(dwell.closing ? 1 : 0));
        repeat.append(same(dwell.repeat ? 1 : 0));
      },
      data.item);
}

/// Values, and their standard uncertainties as NAME_errors.
void put_quantities(const Group& parent, const std::string& name,
                    const std::vector<NamedQuantity>& quantities, const Shape& shape,
                    const std::string& long_name) {
  std::vector<double> values, errors;
  std::string unit;
  for (const auto& [symbol, q] : quantities) {
    values.push_back(q.value);
    errors.push_back(q.standard_uncertainty);
    if (unit.empty()) unit = q.unit;
  }
  if (unit.empty()) unit = kNoUnit;
  put(parent, name, values, shape, {unit, long_name});
  put(parent, name + "_errors", errors, shape, {unit, "standard uncertainty (k = 1) of " + name});
}

template <class Matrix>
void put_covariance(const Group& parent, const std::string& name, const std::optional<Matrix>& matrix,
                    const std::string& long_name) {
  if (!matrix) return;
  std::vector<double> values;
  for (Eigen::Index i = 0; i < matrix->rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix->cols(); ++j) values.push_back((*matrix)(i, j));
  }
  const auto size = static_cast<std::size_t>(matrix->rows());
  // Rows and columns have units of their own; the long name says which.
  put(parent, name, values, {size, size}, {"product of the units of row and column", long_name});
}

void put_result(const Group& entry, const CalibrationResult& result) {
  const Group made = group(entry, "result_" + result.estimator, "NXcollection");
  put(made, "verdict", std::string(to_string(result.verdict)));
  put(made, "why", result.why);
  // The complete abcal.result/1, so that nothing is left out.
  put(made, "json", result_json(result).dump());
  if (result.verdict == Verdict::kNotUsable) return;
  for (const auto& [about, values] : found_groups(result)) {
    const Shape shape = about.columns == 0   ? Shape{}
                        : about.columns == 1 ? Shape{values.size()}
                                             : Shape{values.size() / about.columns, about.columns};
    put_quantities(made, about.key, values, shape, about.meaning);
  }
  put_covariance(made, "covariance", result.covariance, "s_ux s_uy s_uz s_vx ... s_wz O_u O_v O_w");
  put_covariance(made, "covariance_intrinsic", result.covariance_intrinsic,
                 "s_u s_v s_w phi_uv phi_vw phi_wu O_u O_v O_w");
}

void put_instruments(const Group& entry, const ReportData& data) {
  const Group made = group(entry, "instrument", "NXinstrument");
  put(made, "name", data.label("bench.name"));
  for (const InstrumentIdentity& identity : data.run->header.instruments) {
    const Group one = group(made, identity.role, identity.role == "stage" ? "NXpositioner" : "NXsensor");
    put(one, "maker", identity.maker);
    put(one, "model", identity.model);
    put(one, "serial_number", identity.serial_number);
    put(one, "firmware", identity.firmware);
    put(one, "description", identity.details);
  }
}

void put_environment(const Group& entry, const std::vector<StoredEnvironment>& rows) {
  if (rows.empty()) return;
  const Group made = group(entry, "environment", "NXenvironment");
  std::vector<double> temperature, humidity, pressure;
  std::string moments, times;
  for (const StoredEnvironment& row : rows) {
    temperature.push_back(or_nan(row.temperature_degc));
    humidity.push_back(or_nan(row.humidity_percent));
    pressure.push_back(or_nan(row.pressure_hpa));
    moments += (moments.empty() ? "" : " ") + row.moment;
    times += (times.empty() ? "" : " ") + row.utc;
  }
  put(made, "moment", moments);
  put(made, "time_utc", times);
  const Shape shape{rows.size()};
  put(made, "temperature", temperature, shape, {"degree_Celsius", "of the room"});
  put(made, "relative_humidity", humidity, shape, {"percent"});
  put(made, "pressure", pressure, shape, {"hPa"});
}

void put_conditions(const Group& entry, const RunRecord& record) {
  const Group made = group(entry, "conditions", "NXcollection");
  if (record.g_loc_known) {
    put(made, "g_loc", record.g_loc.value_mps2, {"m s-2", "local gravity"});
    put(made, "g_loc_errors", record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor,
        {"m s-2", "standard uncertainty (k = 1) of g_loc"});
    put(made, "g_loc_source", record.g_loc.source);
  }
  const Tolerances& t = record.tolerances;
  put(made, "tolerance_alignment", t.alignment.deg(), {"degree", "standard uncertainty of Zx, Zy, Xz"});
  put(made, "tolerance_step", t.step.deg(), {"degree", "standard uncertainty of each rotation step"});
  put(made, "tolerance_initial_turn", t.initial_turn.deg(), {"degree"});
  put(made, "tolerance_zero", t.zero.deg(), {"degree"});
  put(made, "tolerance_drift", t.drift, {kNoUnit, "over the run, of the sensitivity"});
  for (const EffectSizeKey& key : effect_size_keys()) {
    const std::string name(key.key);
    put(made, name, key.get(t),
        {std::string(key.unit), "stated standard uncertainty: " + std::string(key.words)});
    const auto source = t.sources.find(name);
    put(made, name + "_source", source == t.sources.end() ? "default" : source->second);
  }
}

void put_process(const Group& entry, const std::string& name, const std::string& version,
                 const std::string& date, const std::string& what) {
  const Group made = group(entry, name, "NXprocess");
  put(made, "program", "abcal");
  put(made, "version", version);
  put(made, "date", date);
  put(made, "description", what);
}

void put_note(const Group& entry, const std::string& name, const std::string& type, const std::string& data) {
  const Group made = group(entry, name, "NXnote");
  put(made, "type", type);
  put(made, "data", data);
}

void put_root(const ReportData& data, const std::string& first_entry, const std::string& file_name,
              std::ostream& tree) {
  write_node({"/",
              DataNode::Group{},
              false,
              {{"NX_class", "NXroot"},
               {"default", first_entry},
               {"file_name", file_name},
               {"file_time", data.created_utc},
               {"creator", "abcal"},
               {"creator_version", data.program_version}}},
             tree);
}

void put_entry(const ReportData& data, const Group& entry) {
  put(entry, "definition", "NXabc_calibration");  // docs/NXabc_calibration.nxdl.xml
  put(entry, "title", "calibration of a triaxial accelerometer by gravity (ABC protocol)");
  put(entry, "entry_identifier", data.path.filename().string());
  put(entry, "source_sha256", data.sha256.value_or(""));
  put(entry, "start_time", data.started_utc());
  put(entry, "end_time", data.ended_utc());
  std::string warnings;
  for (const std::string& caution : cautions(data)) warnings += caution + "\n";
  put(entry, "cautions", warnings);
  put_averaged(entry, data.record);
  put_check_poses(entry, data.record);
  put_conditions(entry, data.record);
  for (const CalibrationResult& result : data.results) put_result(entry, result);
  put_process(entry, "analysis", data.program_version, data.created_utc,
              "abc, joint and norm estimators; this file");
  if (!data.run) return;
  put_process(entry, "measurement", data.run->header.program_version, data.started_utc(), "the run");
  const Group sample = group(entry, "sample", "NXsample");
  put(sample, "name", data.label("item.model"));
  for (const char* key : {"maker", "model", "serial_number", "range", "filter", "firmware", "supply"})
    put(sample, key, data.label(std::string("item.") + key));
  put(group(entry, "user", "NXuser"), "name", data.label("operator.name"));
  put_instruments(entry, data);
  put_environment(entry, data.run->environment);
  put_note(entry, "bench_file", "application/toml", data.run->header.bench_toml);
  put_readings(entry, data);
}

}  // namespace

void write_hdf5_tree(std::span<const ReportData> items, const std::string& file_name, std::ostream& tree) {
  const bool several = items.size() > 1;
  const auto name = [several](const ReportData& data) {
    return several ? fmt::format("item_{}", data.item) : std::string("entry");
  };
  put_root(items.front(), name(items.front()), file_name, tree);
  const Group root{tree, ""};
  for (const ReportData& data : items) {
    const Group entry = group(root, name(data), "NXentry", {{"default", "averaged"}});
    put_entry(data, entry);
    if (several && &data == &items.front())
      put_note(entry, "tray", "application/json", tray_json(*data.all).dump());
  }
}

}  // namespace abcal
