#include "protocol/record/import_table.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>

#include "protocol/plan/effect_sizes.h"
#include "protocol/record/import_circles.h"
#include "protocol/record/table_cells.h"
#include "protocol/record/table_comments.h"
#include "protocol/record/table_time.h"

namespace abcal {
namespace {

constexpr std::size_t kMostRows = 4'000'000;
constexpr std::size_t kMostPoses = 100'000;
/// Changes from row to row that are this many times larger are those from pose to pose.
constexpr double kApart = 3.0;
constexpr const char* kRowsArePoses =
    "or, where every row is a pose, --columns that leave the time out: \"-,x,y,z\"";

/// Rows first .. last - 1 of one direction.
struct Group {
  std::size_t first = 0, last = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), spread = Eigen::Vector3d::Zero();
};

Group group_of(std::span<const Eigen::Vector3d> readings, std::size_t first, std::size_t last) {
  Group group{first, last, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  const auto count = static_cast<double>(last - first);
  for (std::size_t i = first; i < last; ++i) group.mean += readings[i] / count;
  for (std::size_t i = first; i < last; ++i) group.spread += (readings[i] - group.mean).cwiseAbs2();
  group.spread = (group.spread / std::max(1.0, count - 1.0)).cwiseSqrt();
  return group;
}

/// The largest change from row to row that does not lead to another pose: the largest gap of the sorted
/// changes in their upper half; 0: no change stays within a pose.
double largest_change_within(std::span<const Eigen::Vector3d> readings) {
  std::vector<double> changes;
  for (std::size_t i = 1; i < readings.size(); ++i) changes.push_back((readings[i] - readings[i - 1]).norm());
  std::ranges::sort(changes);
  double within = 0.0, largest = kApart;
  for (std::size_t i = changes.size() / 2; i + 1 < changes.size(); ++i) {
    const double gap = changes[i + 1] / std::max(changes[i], 1e-300);
    if (gap <= largest) continue;
    largest = gap;
    within = std::max(changes[i], 1e-300);
  }
  return within;
}

/// Neighbouring rows of one direction; empty where the file has no such, and each row is a pose.
std::vector<Group> groups_of(std::span<const Eigen::Vector3d> readings) {
  const double within = largest_change_within(readings);
  std::vector<Group> groups;
  for (std::size_t first = 0, last = 0; first < readings.size() && groups.size() <= kMostPoses;
       first = last) {
    last = first + 1;
    while (last < readings.size() && (readings[last] - readings[last - 1]).norm() <= within) ++last;
    groups.push_back(group_of(readings, first, last));
    // A slow turn has small changes too, but leaves the direction.
    const auto leaves = [&](const Eigen::Vector3d& reading) {
      return (reading - groups.back().mean).norm() > within;
    };
    if (last > first + 1 && std::ranges::any_of(readings.subspan(first, last - first), leaves)) return {};
  }
  return groups.size() < readings.size() ? groups : std::vector<Group>();
}

/// Whether rows are readings of a series: they change less from one to the next than from part to part.
bool are_in_series(std::span<const Eigen::Vector3d> readings) {
  constexpr std::size_t kLeastRows = 200;
  constexpr double kMuchLess = 0.2;
  if (readings.size() < kLeastRows) return false;
  const auto median_change = [&](std::size_t apart) {
    std::vector<double> changes;
    for (std::size_t i = apart; i < readings.size(); ++i)
      changes.push_back((readings[i] - readings[i - apart]).norm());
    const auto middle = changes.begin() + static_cast<std::ptrdiff_t>(changes.size() / 2);
    std::ranges::nth_element(changes, middle);
    return *middle;
  };
  return median_change(1) < kMuchLess * median_change(readings.size() / 3);
}

/// Reads a table without angles.
class PoseImporter {
 public:
  PoseImporter(TableReader& table, const TableColumns& columns, TableProblems& problems,
               const TableOptions& options, const StaticSearch& search)
      : table_(table), columns_(columns), problems_(problems), options_(options), search_(search) {
    const auto has = [&](const char* name) { return columns.has(name); };
    are_averages_ = columns.kind == TableKind::kPoses && (has("u_u") || has("count") || has("time_s"));
  }

  ImportedTable import() {
    out_.kind = columns_.kind;
    read_rows();
    RunRecord& record = out_.record;
    // The item is linear but for what is stated.
    for (const EffectSizeKey& key : effect_size_keys())
      if (key.section == "item_uncertainty") key.set(record.tolerances, 0.0);
    read_comments(table_, problems_, record);
    if (problems_.count() > 0) problems_.fail();
    if (columns_.kind == TableKind::kTimeSeries) {
      add_stretches();
    } else if (!are_averages_) {
      add_groups();
    }
    const Tolerances& sizes = record.tolerances;
    const bool depends_on_order = sizes.drift > 0.0 || sizes.sensitivity_drift > 0.0 ||
                                  sizes.cyclic_drift > 0.0 || sizes.hysteresis > 0.0;
    const bool timed =
        std::ranges::all_of(record.dwells, [](const DwellRecord& dwell) { return dwell.time_s.has_value(); });
    record.order_assumed = record.order_assumed && depends_on_order && !timed;
    return std::move(out_);
  }
  /// How the poses were found; empty: each row is one.
  const std::string& words() const { return words_; }

 private:
  void read_rows() {
    TableCells cells(table_, columns_, problems_);
    while (cells.next()) {
      if (++out_.rows > (are_averages_ ? kMostPoses : kMostRows)) {
        problems_.add(
            fmt::format("line {}", cells.line()), "another row",
            fmt::format("at most {} rows: parts of the file, or every second row of it", out_.rows - 1));
        problems_.fail();
      }
      const Eigen::Vector3d reading = cells.readings();
      const std::optional<Eigen::Vector3d> up = cells.up();
      if (are_averages_) {
        add_average(cells, reading);
        out_.record.dwells.back().up = up;
      } else if (reading.allFinite() && (columns_.kind != TableKind::kTimeSeries || take_time(cells))) {
        readings_.push_back(reading);
        if (up) ups_.push_back(*up);
        lines_.push_back(cells.line());
      }
    }
    if (out_.rows == 0) problems_.add("the file", "no rows of numbers", "readings");
  }

  void add_average(TableCells& cells, const Eigen::Vector3d& reading) {
    DwellRecord& dwell = add_dwell(cells.line(), cells.line());
    dwell.mean = reading;
    dwell.u_mean = cells.uncertainties();
    dwell.time_s = cells.optional_number("time_s");
    if (cells.has("count"))
      dwell.count = cells.whole_number("count", 1, 1e15, "a whole number of at least 1").value_or(0);
  }

  /// @return whether the time comes after that of the row before
  bool take_time(TableCells& cells) {
    std::optional<double> time = seconds_of_iso(cells.text("t"));
    if (time) {
      is_iso_ = true;
    } else {
      time = cells.number("t", "a time: a number, or 2026-01-31T12:00:00.5");
      if (!time) return false;
    }
    if (!times_.empty() && !(*time > times_.back())) {
      if (left_out_++ == 0) first_left_out_ = cells.line();
      return false;
    }
    times_.push_back(*time);
    return true;
  }

  /// A pose of the rows first .. last - 1.
  DwellRecord& add_pose(std::size_t first, std::size_t last) {
    DwellRecord& dwell = add_dwell(lines_[first], lines_[last - 1]);
    if (ups_.empty()) return dwell;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::size_t i = first; i < last; ++i) sum += ups_[i];
    dwell.up = last == first + 1 ? ups_[first] : sum.normalized();
    return dwell;
  }

  DwellRecord& add_dwell(std::size_t first_line, std::size_t last_line) {
    std::vector<DwellRecord>& dwells = out_.record.dwells;
    DwellRecord& dwell = dwells.emplace_back();
    dwell.n = static_cast<int>(dwells.size());
    dwell.first_line = first_line;
    dwell.last_line = last_line;
    return dwell;
  }

  /// Stretches at rest of a series whose times nobody states, with the largest of some numbers of rows for a
  /// second that finds enough of them in most of the rows; false: it is none.
  bool add_untimed_stretches() {
    constexpr std::size_t kLeastStretches = 6;
    for (const double rows_in_second : {100.0, 50.0, 20.0, 10.0}) {
      TimeSeries series{{}, readings_};
      for (std::size_t i = 0; i < readings_.size(); ++i)
        series.time_s.push_back(static_cast<double>(i) / rows_in_second);
      std::vector<StaticStretch> found = static_stretches(series, search_);
      std::size_t at_rest = 0;
      for (const StaticStretch& stretch : found) at_rest += stretch.count;
      if (found.size() < kLeastStretches || 3 * at_rest < readings_.size()) continue;
      for (const StaticStretch& stretch : found) {
        DwellRecord& dwell = add_pose(stretch.first, stretch.last);
        dwell.mean = stretch.mean;
        dwell.spread = stretch.spread;
        dwell.count = static_cast<std::int64_t>(stretch.count);
      }
      out_.stretches = std::move(found);
      words_ =
          fmt::format("rows in their order without a time, at least {:g} rows at rest are a pose: {} poses",
                      search_.min_length_s * rows_in_second, out_.stretches.size());
      return true;
    }
    return false;
  }

  void add_groups() {
    std::vector<Group> groups = groups_of(readings_);
    const bool several_rows = !groups.empty();
    // Readings in motion are directions of their own; where they are many, the stretches between them count.
    const auto alone =
        std::ranges::count_if(groups, [](const Group& group) { return group.last == group.first + 1; });
    const bool is_in_motion = !several_rows || 4 * static_cast<std::size_t>(alone) > groups.size();
    if (is_in_motion && are_in_series(readings_) && add_untimed_stretches()) return;
    if (!several_rows && readings_.size() <= kMostPoses)
      for (std::size_t i = 0; i < readings_.size(); ++i) groups.push_back(group_of(readings_, i, i + 1));
    if (groups.empty() || groups.size() > kMostPoses) {
      problems_.add("the file", fmt::format("{} rows, most of them poses of their own", readings_.size()),
                    fmt::format("at most {} poses; a time series needs a column of time", kMostPoses));
      problems_.fail();
    }
    for (const Group& group : groups) {
      DwellRecord& dwell = add_pose(group.first, group.last);
      dwell.mean = group.mean;
      dwell.spread = group.spread;
      dwell.count = static_cast<std::int64_t>(group.last - group.first);
    }
    if (several_rows)
      words_ = fmt::format("{} rows: neighbouring rows of one direction are one pose, {} poses", out_.rows,
                           groups.size());
  }

  /// The unit of the times: stated, or from their spacing.
  TimeUnit time_unit() {
    std::string stated = options_.time_unit, by = options_.time_unit_by;
    for (const TableComment& comment : table_.comments())
      if (comment.key == "time_unit" && stated.empty()) {
        stated = comment.value;
        by = "as the file states";
      }
    if (stated.empty() && !columns_.time_unit.empty()) {
      stated = columns_.time_unit;
      by = "as the header states";
    }
    if (is_iso_) return {"s", 1.0, "dates"};
    if (!stated.empty()) {
      if (const UnitOfTime* unit = unit_of_time(stated)) return {stated, unit->in_a_second, by};
      problems_.add("unit of time", as_quoted(stated), "s, ms, us or ns");
      problems_.fail();
    }
    if (const auto found = unit_from_spacing(times_)) return *found;
    problems_.add("the column of time",
                  fmt::format("times that are {:.3g} apart, without a unit: several would be possible",
                              median_spacing(times_)),
                  "--time-unit s, ms, us or ns");
    problems_.fail();
  }

  void add_stretches() {
    if (times_.size() < 2 || left_out_ > times_.size()) {
      problems_.add("the column of time",
                    fmt::format("{} of {} rows do not come after the row before, the first on line {}",
                                left_out_, out_.rows, first_left_out_),
                    fmt::format("times that ascend, {}", kRowsArePoses));
      problems_.fail();
    }
    out_.rows = times_.size();
    const TimeUnit unit = time_unit();
    TimeSeries series{std::move(times_), std::move(readings_)};
    for (double& time : series.time_s) time /= unit.in_a_second;
    const double period = median_spacing(series.time_s);
    if (period > search_.window_s) {
      problems_.add(
          "the column of time",
          fmt::format("a row each {:.3g} s ({}, {})", period, unit.name, unit.known_from),
          fmt::format("at least one each {:g} s, so that rest is seen; or the right --time-unit, {}",
                      search_.window_s, kRowsArePoses));
      problems_.fail();
    }
    out_.stretches = static_stretches(series, search_);
    if (out_.stretches.empty())
      problems_.add("the time series",
                    fmt::format("no stretch of {:g} s without motion in {:.3g} s", search_.min_length_s,
                                series.time_s.back() - series.time_s.front()),
                    fmt::format("rest at each pose, {}", kRowsArePoses));
    for (const StaticStretch& stretch : out_.stretches) {
      DwellRecord& dwell = add_pose(stretch.first, stretch.last);
      dwell.mean = stretch.mean;
      dwell.spread = stretch.spread;
      dwell.count = static_cast<std::int64_t>(stretch.count);
      dwell.time_s = 0.5 * (stretch.start_s + stretch.end_s) - series.time_s.front();
      // u_mean is left absent on purpose: the noise within a stretch does not show how well poses placed by
      // hand agree with each other, so the norm fit takes its uncertainties from that agreement.
    }
    words_ = fmt::format("time in {} ({}): {:.4g} rows a second; {} poses at rest", unit.name,
                         unit.known_from, 1.0 / period, out_.stretches.size());
    if (left_out_ > 0)
      words_ += fmt::format("; {} rows left out whose time repeats or goes back, the first on line {}",
                            left_out_, first_left_out_);
  }

  TableReader& table_;
  const TableColumns& columns_;
  TableProblems& problems_;
  const TableOptions& options_;
  const StaticSearch& search_;
  ImportedTable out_;
  std::vector<Eigen::Vector3d> readings_, ups_;
  std::vector<double> times_;
  std::vector<std::size_t> lines_;
  std::size_t left_out_ = 0, first_left_out_ = 0;
  bool is_iso_ = false, are_averages_ = false;
  std::string words_;
};

/// How the table was understood: at most three lines.
std::vector<std::string> words_of(const ImportedTable& imported, const TableColumns& columns,
                                  const TableReader& table, std::string poses) {
  const char* const what = imported.kind == TableKind::kCircles ? "averages at angles"
                           : imported.kind == TableKind::kPoses ? "poses"
                                                                : "a time series";
  const std::string& unit = imported.record.response_unit;
  std::vector<std::string> words{fmt::format(
      "read as {}: {} rows, readings {} in {}; {} between the cells{}", what, imported.rows, columns.readings,
      unit == RunRecord().response_unit ? "a unit that is not stated (--unit)" : unit,
      table.separator_words(), table.has_decimal_commas() ? ", decimal commas" : "")};
  if (table.first_line() > 1)
    words.front() += fmt::format("; the table begins on line {}", table.first_line());
  if (states_directions(imported.record))
    words.front() +=
        imported.record.u_up
            ? fmt::format("; directions of the poses, each to {:g} degree", imported.record.u_up->deg())
            : "; directions of the poses (# pose_uncertainty_deg states how well)";
  if (!poses.empty()) words.push_back(std::move(poses));
  constexpr std::size_t kMostNames = 8;
  const std::vector<std::string>& names = columns.ignored;
  if (!names.empty())
    words.push_back(fmt::format(
        "columns that are ignored: {}{}",
        fmt::join(names.begin(),
                  names.begin() + static_cast<std::ptrdiff_t>(std::min(names.size(), kMostNames)), ", "),
        names.size() > kMostNames ? fmt::format(" and {} more", names.size() - kMostNames) : ""));
  return words;
}

}  // namespace

ImportedTable import_table(std::istream& input, const std::string& source, const TableOptions& options,
                           const StaticSearch& search) {
  TableProblems problems(source);
  TableReader table(input, problems);
  const TableColumns columns = find_columns(table, options, problems);
  ImportedTable imported;
  std::string poses;
  if (columns.kind == TableKind::kCircles) {
    imported.kind = columns.kind;
    import_circles(table, columns, problems, imported.record);
    imported.rows = imported.record.dwells.size() + imported.record.check_poses.size();
  } else {
    PoseImporter importer(table, columns, problems, options, search);
    imported = importer.import();
    poses = importer.words();
  }
  if (problems.count() > 0) problems.fail();
  RunRecord& record = imported.record;
  record.source = source;
  if (!columns.unit.empty() && record.response_unit == RunRecord().response_unit)
    record.response_unit = columns.unit;
  if (!options.unit.empty()) record.response_unit = options.unit;
  if (record.estimator.empty()) record.estimator = columns.kind == TableKind::kCircles ? "joint" : "norm";
  record.read_as = words_of(imported, columns, table, std::move(poses));
  return imported;
}

ImportedTable import_table(const std::filesystem::path& path, const TableOptions& options) {
  errno = 0;
  std::ifstream file(path, std::ios::binary);
  if (!file || std::filesystem::is_directory(path)) {
    const char* reason = std::filesystem::is_directory(path) ? "it is a folder" : std::strerror(errno);
    throw std::runtime_error(fmt::format("cannot read {}: {}", path.string(), reason));
  }
  return import_table(file, path.string(), options);
}

}  // namespace abcal
