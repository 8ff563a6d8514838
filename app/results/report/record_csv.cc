#include "app/results/report/record_csv.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <optional>
#include <sstream>
#include <stdexcept>

#include "app/system/output.h"
#include "drivers/text/letters.h"
#include "protocol/estimators/checks/check_poses.h"
#include "protocol/record/limits_entries.h"

namespace abcal {
namespace {

/// The shortest text that reads back to the same number; empty for none.
std::string csv_number(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? fmt::format("{}", *value) : "";
}

std::string comment(const std::string& key, const std::string& value) {
  if (value.empty()) return {};
  return fmt::format("# {}: {}\n", printable_line(key), printable_line(value));
}

/// The lines above the header line; keys as in the run file.
std::string comments(const ReportData& data, const std::string& what) {
  const RunRecord& record = data.record;
  std::string text = comment("abcal", data.program_version) + comment("content", what) +
                     comment("source", data.path.filename().string()) +
                     comment("source_sha256", data.sha256.value_or("")) +
                     comment("written_utc", data.created_utc);
  for (const std::string& caution : cautions(data)) text += comment("caution", caution);
  if (data.run) {
    text += comment("state", std::string(to_string(data.run->state))) +
            comment("created_utc", data.run->header.created_utc) +
            comment("measured_with", data.run->header.program_version);
    for (const auto& [key, value] : data.run->header.labels) text += comment(key, value);
  }
  text += comment("response_unit", record.response_unit);
  if (record.g_loc_known) {
    text += comment("g_loc.value_mps2", csv_number(record.g_loc.value_mps2)) +
            comment("g_loc.expanded_uncertainty_mps2", csv_number(record.g_loc.expanded_uncertainty_mps2)) +
            comment("g_loc.coverage_factor", csv_number(record.g_loc.coverage_factor)) +
            comment("g_loc.source", record.g_loc.source);
  }
  if (record.u_up) text += comment(std::string(kPoseUncertaintyKey), csv_number(record.u_up->deg()));
  for (const auto& [name, value] : effect_size_entries(record.tolerances)) text += comment(name, value);
  for (const auto& [name, value] : limits_entries(record.limits, record.expected))
    text += comment(name, value);
  const MeasuredAlignment& a = record.measured_alignment;
  for (const auto& [name, measured] : {std::pair{"zx", &a.zx}, {"zy", &a.zy}, {"xz", &a.xz}}) {
    if (!*measured) continue;
    text += comment(fmt::format("alignment.{}", name), csv_number((*measured)->value)) +
            comment(fmt::format("alignment.u_{}", name), csv_number((*measured)->standard_uncertainty));
  }
  if (record.axes_order) text += comment("protocol.axes_order", std::string(to_string(*record.axes_order)));
  if (record.approach) text += comment("protocol.approach_deg", csv_number(record.approach->deg()));
  return text + comment("protocol.step_deg", csv_number(record.step.deg())) +
         comment("protocol.steps", std::to_string(record.steps)) +
         comment("continuations", std::to_string(record.continuations));
}

}  // namespace

namespace {

/// Comments of one of several items, distinguished by their keys: "# item-2.response_unit: g".
std::string of_item(const std::string& comments, int item) {
  std::istringstream lines(comments);
  std::string text;
  for (std::string line; std::getline(lines, line);)
    text += fmt::format("# item-{}.{}\n", item, line.substr(2));
  return text;
}

/// The cell of the first column for an item, "2,"; empty: no such column.
std::string item_column(const ReportData& data, bool with_item) {
  return with_item ? fmt::format("{},", data.item) : std::string();
}

/// The cell of the last column, which only runs of two faces have.
std::string face_cell(bool with_face, int face) {
  return with_face ? fmt::format(",{}", face) : std::string();
}

/// @param left_out  increased by the number of angles without a finite mean
std::string averaged_rows(const ReportData& data, bool with_item, int& left_out) {
  const bool with_face = has_two_faces(data.record);
  std::string rows;
  for (const DwellRecord* each : dwells_in_time(data.record)) {
    const DwellRecord& dwell = *each;
    if (!dwell.mean.allFinite()) {
      ++left_out;
      continue;
    }
    rows += item_column(data, with_item);
    if (has_angles(data.record))
      rows += fmt::format("{},{},{},{},", dwell.experiment, dwell.n, dwell.closing ? 1 : 0,
                          csv_number(dwell.alpha.deg()));
    if (states_directions(data.record))
      rows += fmt::format("{},{},{},", csv_number(dwell.up->x()), csv_number(dwell.up->y()),
                          csv_number(dwell.up->z()));
    rows += fmt::format("{},{},{}", csv_number(dwell.mean[0]), csv_number(dwell.mean[1]),
                        csv_number(dwell.mean[2]));
    for (int j = 0; j < 3; ++j) rows += "," + (dwell.u_mean ? csv_number((*dwell.u_mean)[j]) : "");
    const auto degrees = [](const std::optional<Angle>& angle) {
      return angle ? csv_number(angle->deg()) : std::string();
    };
    rows += fmt::format(",{},{},{},{},{},{},{},{},{}{}\n", csv_number(dwell.time_s),
                        dwell.count > 0 ? std::to_string(dwell.count) : "",
                        csv_number(dwell.temperature_degc), dwell.flags, degrees(dwell.encoder_x),
                        degrees(dwell.encoder_z), csv_number(dwell.spread[0]), csv_number(dwell.spread[1]),
                        csv_number(dwell.spread[2]), face_cell(with_face, dwell.face));
  }
  return rows;
}

std::string check_pose_comments(const ReportData& data) {
  std::string text;
  if (const auto study = compared_check_poses(data.record)) {
    const auto add = [&](const char* name, const std::array<PoseTrend, 3>& trends) {
      for (std::size_t j = 0; j < 3; ++j) {
        const std::string key = fmt::format("check_poses.change_of_{}_{}", name, kOutputNames[j]);
        text += comment(key, csv_number(trends[j].change)) +
                comment(key + ".standard_uncertainty", csv_number(trends[j].standard_uncertainty));
      }
    };
    add("gain", study->gain);
    add("offset", study->offset);
  }
  if (!data.record.check_poses.empty())
    text += comment("experiment 0", "a check pose, n = 1 or 2: gravity along (1, 1, 1) or against it");
  return text;
}

/// Whether rows and comments say of which item they are.
bool tells_items(std::span<const ReportData> items) {
  return items.size() > 1;
}

}  // namespace

std::string averaged_csv(std::span<const ReportData> items) {
  if (is_at_constant_rate(items.front().record))
    throw std::invalid_argument(
        fmt::format("{}: the stage turned at constant rates, for which the columns of this CSV have no "
                    "place; required: a run in steps. The run file itself is SQLite, and HDF5 has all of it",
                    items.front().path.string()));
  const bool with_item = tells_items(items);
  std::string flags;
  for (std::uint32_t bit = 1; bit <= kAllFlags; bit *= 2)
    flags += fmt::format("{}{} {}", flags.empty() ? "" : ", ", bit, describe_flags(bit));
  std::string text, rows;
  for (const ReportData& data : items) {
    int left_out = 0;
    rows += averaged_rows(data, with_item, left_out);
    std::string own =
        comments(data, "averaged readings, their standard uncertainty (u_), times from the start");
    if (left_out > 0) own += comment("left_out", fmt::format("{} angles without a finite mean", left_out));
    own += check_pose_comments(data);
    text += with_item ? of_item(own, data.item) : own;
  }
  return text +
         comment("units", "alpha_deg and encoder_*_deg degree; r_*, u_*, spread_* response_unit; time_s s") +
         comment("flags", "sum of " + flags) + (with_item ? "item," : "") +
         (has_angles(items.front().record) ? "experiment,n,closing,alpha_deg," : "") +
         (states_directions(items.front().record) ? "up_x,up_y,up_z," : "") +
         "r_u,r_v,r_w,u_u,u_v,u_w,time_s,count,temperature_degc,flags,encoder_"
         "x_deg,encoder_z_deg,spread_u,spread_v,spread_w" +
         (has_two_faces(items.front().record) ? ",face\n" : "\n") + rows;
}

void write_raw_csv(std::span<const ReportData> items, const std::filesystem::path& path) {
  const bool with_item = tells_items(items);
  const ReportData& first = items.front();
  if (!first.run) {
    throw std::invalid_argument(
        fmt::format("{}: the single readings of a table are in it", first.path.string()));
  }
  const bool with_face = has_two_faces(first.record);
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  for (const ReportData& data : items) {
    const std::string own = comments(data, "single readings as the accelerometer delivered them");
    file << (with_item ? of_item(own, data.item) : own);
  }
  file << comment("units", "alpha_deg degree; time_s s from the start; r_* response_unit")
       << (with_item ? "item," : "")
       << "experiment,n,closing,alpha_deg,repeat,sequence,time_s,r_u,r_v,r_w,temperature_degc"
       << (with_face ? ",face\n" : "\n");
  RunFile::read_dwells(
      first.path,
      [&](const StoredDwell& dwell) {
        for (const StoredReading& r : dwell.readings) {
          if (with_item) file << dwell.item << ',';
          file << fmt::format("{},{},{},{},{},{},{},{},{},{},{}{}\n", dwell.experiment, dwell.n,
                              dwell.closing ? 1 : 0, csv_number(dwell.alpha.deg()), dwell.repeat ? 1 : 0,
                              r.sequence, csv_number(r.time_s), csv_number(r.output[0]),
                              csv_number(r.output[1]), csv_number(r.output[2]),
                              csv_number(r.temperature_degc), face_cell(with_face, dwell.face));
        }
      },
      with_item ? 0 : first.item);
  file.close();
  if (!file)
    throw std::runtime_error(fmt::format("{}: cannot be written (is the disk full?)", path.string()));
}

}  // namespace abcal
