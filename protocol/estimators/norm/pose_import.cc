#include "protocol/estimators/norm/pose_import.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "protocol/estimators/norm/norm_fit.h"

namespace abcal {
namespace {

// ---- Table ----------------------------------------------------------------------------------------------

struct Table {
  std::vector<std::string> header;  ///< Empty: none.
  std::vector<std::vector<double>> rows;
  std::vector<int> lines;                                       ///< Line of each row, from 1.
  std::map<std::string, std::pair<int, std::string>> comments;  ///< "# KEY: VALUE": its line and value.
};

/// The text without white space and quotes at its ends.
std::string_view bare(std::string_view text) {
  return pieces::trimmed(text, " \t\r\n\"");
}

/// The cells of a line: between commas or semicolons if there are any, else between blanks.
std::vector<std::string_view> cells_of(std::string_view line) {
  std::vector<std::string_view> cells;
  for (const char separator : {',', ';'}) {
    if (line.find(separator) == std::string_view::npos) continue;
    cells = pieces::split(line, separator);
    break;
  }
  if (cells.empty()) cells = pieces::words(line, " \t");
  for (std::string_view& cell : cells) cell = bare(cell);
  return cells;
}

std::optional<double> number(std::string_view text) {
  return pieces::number<double>(text.starts_with('+') ? text.substr(1) : text);
}

Table read_table(std::istream& in, const std::string& source) {
  Table table;
  std::string line;
  std::size_t columns = 0;
  for (int number_of_line = 1; std::getline(in, line); ++number_of_line) {
    const std::string_view text = bare(line);
    if (text.empty()) continue;
    if (text.front() == '#') {
      if (const std::size_t colon = text.find(':'); colon != std::string_view::npos) {
        table.comments[std::string(bare(text.substr(1, colon - 1)))] = {
            number_of_line, std::string(bare(text.substr(colon + 1)))};
      }
      continue;
    }
    const std::vector<std::string_view> cells = cells_of(text);
    const auto where = [&] { return fmt::format("{}, line {}", source, number_of_line); };
    if (columns == 0) {
      columns = cells.size();
      if (!std::all_of(cells.begin(), cells.end(), [](auto cell) { return number(cell).has_value(); })) {
        for (const std::string_view cell : cells) table.header.push_back(pieces::lower(cell));
        continue;
      }
    }
    if (cells.size() != columns) {
      throw std::invalid_argument(fmt::format("{}: {} columns; {} as in the first line are required", where(),
                                              cells.size(), columns));
    }
    std::vector<double> row;
    for (const std::string_view cell : cells) {
      // An empty cell is an absent optional number; it is refused where a number is required.
      const std::optional<double> value =
          cell.empty() ? std::numeric_limits<double>::quiet_NaN() : number(cell);
      if (!value) throw std::invalid_argument(fmt::format("{}: \"{}\" is not a number", where(), cell));
      row.push_back(*value);
    }
    table.rows.push_back(std::move(row));
    table.lines.push_back(number_of_line);
  }
  if (in.bad()) throw std::runtime_error(source + ": cannot be read");
  if (table.rows.empty()) throw std::runtime_error(source + ": no numbers in it");
  return table;
}

std::optional<std::size_t> column_named(const Table& table, std::initializer_list<std::string_view> names) {
  for (const std::string_view name : names) {
    const auto at = std::find(table.header.begin(), table.header.end(), name);
    if (at != table.header.end()) return static_cast<std::size_t>(at - table.header.begin());
  }
  return std::nullopt;
}

/// Sizes of the item's effects that the comments state; effects that are not stated are left out.
EffectSizes stated_sizes(const Table& table, const std::string& source) {
  EffectSizes sizes = linear_item();
  const auto number_of = [&](const std::string& key, double most) -> std::optional<double> {
    const auto found = table.comments.find(key);
    if (found == table.comments.end()) return std::nullopt;
    const auto& [line, text] = found->second;
    const std::optional<double> value = number(text);
    if (value && *value >= 0.0 && *value <= most) return value;
    throw std::invalid_argument(fmt::format("{}, line {}: {} is \"{}\"; a number from 0 to {:g} is required",
                                            source, line, key, text, most));
  };
  const auto text_of = [&](const std::string& key) {
    const auto found = table.comments.find(key);
    return found == table.comments.end() ? std::nullopt : std::optional(found->second.second);
  };
  read_effect_sizes(number_of, text_of, sizes);
  return sizes;
}

// ---- Static stretches -------------------------------------------------------------------------------------

/// Cumulative sums over samples: mean and spread of a window take the same time for any length.
class RunningSums {
 public:
  explicit RunningSums(const std::vector<Eigen::Vector3d>& readings)
      : shift_(readings.front()), sum_(readings.size() + 1), square_(readings.size() + 1) {
    sum_[0].setZero();
    square_[0].setZero();
    for (std::size_t i = 0; i < readings.size(); ++i) {
      const Eigen::Vector3d r = readings[i] - shift_;
      sum_[i + 1] = sum_[i] + r;
      square_[i + 1] = square_[i] + r.cwiseAbs2();
    }
  }
  Eigen::Vector3d mean(std::size_t first, std::size_t last) const {
    return shift_ + (sum_[last] - sum_[first]) / static_cast<double>(last - first);
  }
  Eigen::Vector3d spread(std::size_t first, std::size_t last) const {
    const auto n = static_cast<double>(last - first);
    const Eigen::Vector3d sum = sum_[last] - sum_[first];
    const Eigen::Vector3d squares = square_[last] - square_[first] - sum.cwiseAbs2() / n;
    return (squares / (n - 1.0)).cwiseMax(0.0).cwiseSqrt();
  }

 private:
  Eigen::Vector3d shift_;
  std::vector<Eigen::Vector3d> sum_, square_;
};

/// Standard uncertainty of the mean from the scatter of batch means: neighbouring readings of a filtered
/// output are not independent, batches that are long against the filter are.
Eigen::Vector3d batch_uncertainty(const RunningSums& sums, std::size_t first, std::size_t last) {
  constexpr std::size_t kBatches = 8;
  const std::size_t length = (last - first) / kBatches;
  if (length < 2) return sums.spread(first, last) / std::sqrt(static_cast<double>(last - first));
  const Eigen::Vector3d mean = sums.mean(first, first + kBatches * length);
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < kBatches; ++i) {
    squares += (sums.mean(first + i * length, first + (i + 1) * length) - mean).cwiseAbs2();
  }
  return (squares / static_cast<double>(kBatches * (kBatches - 1))).cwiseSqrt();
}

void check(const TimeSeries& series, const StaticSearch& search) {
  if (series.time_s.size() != series.reading.size()) {
    throw std::invalid_argument(
        fmt::format("time series: {} times and {} readings", series.time_s.size(), series.reading.size()));
  }
  for (std::size_t i = 0; i < series.time_s.size(); ++i) {
    if (!std::isfinite(series.time_s[i]) || !series.reading[i].allFinite()) {
      throw std::invalid_argument(fmt::format("time series: row {} is not finite", i + 1));
    }
    if (i > 0 && !(series.time_s[i] > series.time_s[i - 1])) {
      throw std::invalid_argument(fmt::format("time series: row {}: time {} s does not come after {} s",
                                              i + 1, series.time_s[i], series.time_s[i - 1]));
    }
  }
  const auto positive = [](double x) { return std::isfinite(x) && x > 0.0; };
  if (!positive(search.window_s) || !positive(search.threshold) || !positive(search.min_length_s) ||
      !(search.trim_s >= 0.0) || !std::isfinite(search.trim_s)) {
    throw std::invalid_argument(
        "time series: window, threshold and shortest stretch must be greater than zero, the "
        "trim zero or more");
  }
}

/// Spread below which an output is at rest: a multiple of the lowest tenth (quantile) of the running spreads.
Eigen::Vector3d spread_limit(const TimeSeries& series, const std::vector<Eigen::Vector3d>& spread,
                             double threshold) {
  const std::size_t n = spread.size();
  Eigen::Vector3d limit;
  for (Eigen::Index j = 0; j < 3; ++j) {
    std::vector<double> sorted(n);
    for (std::size_t i = 0; i < n; ++i) sorted[i] = spread[i](j);
    const auto tenth = sorted.begin() + static_cast<std::ptrdiff_t>(n / 10);
    std::nth_element(sorted.begin(), tenth, sorted.end());
    // The spread of a quiet output may be below its resolution: one step of it does not count as motion.
    double resolution = std::numeric_limits<double>::infinity();
    for (std::size_t i = 1; i < n; ++i) {
      const double step = std::abs(series.reading[i](j) - series.reading[i - 1](j));
      if (step > 0.0) resolution = std::min(resolution, step);
    }
    if (!std::isfinite(resolution)) resolution = 0.0;
    limit(j) = threshold * std::max(*tenth, resolution / std::sqrt(12.0));
  }
  return limit;
}

/// Collects stretches, and joins the parts of a pose that a knock has interrupted.
class StretchCollector {
 public:
  StretchCollector(const TimeSeries& series, const StaticSearch& search, const RunningSums& sums,
                   const Eigen::Vector3d& limit)
      : series_(series), search_(search), sums_(sums), limit_(limit) {}

  /// Samples first .. last - 1 were quiet in the short window.
  void add(std::size_t first, std::size_t last) {
    const double start = series_.time_s[first] + search_.trim_s;
    const double end = series_.time_s[last - 1] - search_.trim_s;
    // A part of a pose may be shorter than a pose: parts separated by a knock are joined.
    if (end - start < 0.25 * search_.min_length_s) return;
    StaticStretch stretch;
    stretch.first = sample_at(start);
    stretch.last = sample_at(end) + 1;
    if (stretch.last - stretch.first < 8) return;
    stretch.count = stretch.last - stretch.first;
    stretch.spread = sums_.spread(stretch.first, stretch.last);
    // Slow turning passes the short window but not the whole stretch.
    if ((stretch.spread.array() > limit_.array()).any()) return;
    stretch.mean = sums_.mean(stretch.first, stretch.last);
    stretch.u_mean = batch_uncertainty(sums_, stretch.first, stretch.last);
    stretch.start_s = series_.time_s[stretch.first];
    stretch.end_s = series_.time_s[stretch.last - 1];
    if (found_.empty() || !goes_on(found_.back(), stretch)) {
      found_.push_back(stretch);
    } else {
      join(found_.back(), stretch);
    }
  }
  std::vector<StaticStretch> take() { return std::move(found_); }

 private:
  std::size_t sample_at(double time) const {
    return static_cast<std::size_t>(std::lower_bound(series_.time_s.begin(), series_.time_s.end(), time) -
                                    series_.time_s.begin());
  }
  /// Whether a stretch continues the pose before, after a knock. Half the scatter of one reading is far below
  /// any turn by hand; the means of short parts may differ by five of their uncertainties.
  bool goes_on(const StaticStretch& before, const StaticStretch& stretch) const {
    const Eigen::Vector3d u = (stretch.u_mean.cwiseAbs2() + before.u_mean.cwiseAbs2()).cwiseSqrt();
    const Eigen::Vector3d allowed = (0.5 * limit_ / search_.threshold).cwiseMax(5.0 * u);
    const bool same = ((stretch.mean - before.mean).array().abs() <= allowed.array()).all();
    return same && stretch.start_s - before.end_s <= 2.0 * search_.window_s + 2.0 * search_.trim_s;
  }
  static void join(StaticStretch& before, const StaticStretch& stretch) {
    const auto a = static_cast<double>(before.count);
    const auto b = static_cast<double>(stretch.count);
    before.mean = (a * before.mean + b * stretch.mean) / (a + b);
    before.spread = ((a * before.spread.cwiseAbs2() + b * stretch.spread.cwiseAbs2()) / (a + b)).cwiseSqrt();
    before.u_mean =
        (a * a * before.u_mean.cwiseAbs2() + b * b * stretch.u_mean.cwiseAbs2()).cwiseSqrt() / (a + b);
    before.count += stretch.count;
    before.last = stretch.last;
    before.end_s = stretch.end_s;
  }

  const TimeSeries& series_;
  const StaticSearch& search_;
  const RunningSums& sums_;
  Eigen::Vector3d limit_;
  std::vector<StaticStretch> found_;
};

/// Reads three numbers of a row, and gives its file and line.
class TripleReader {
 public:
  TripleReader(const Table& table, const std::string& source) : table_(table), source_(source) {}
  std::string place(std::size_t row) const { return fmt::format("{}, line {}", source_, table_.lines[row]); }
  Eigen::Vector3d operator()(std::size_t row, const std::array<std::size_t, 3>& columns) const {
    Eigen::Vector3d value;
    for (std::size_t j = 0; j < 3; ++j) {
      value(static_cast<Eigen::Index>(j)) = table_.rows[row][columns[j]];
    }
    if (!value.allFinite()) {
      throw std::invalid_argument(fmt::format("{}: a number is missing or not finite", place(row)));
    }
    return value;
  }

 private:
  const Table& table_;
  const std::string& source_;
};

/// Columns of readings, uncertainties and time; without a time the rows are poses.
struct PoseColumns {
  std::array<std::size_t, 3> reading{};
  std::array<std::optional<std::size_t>, 3> uncertainty{};
  std::optional<std::size_t> time;
};

PoseColumns columns_of(const Table& table, const std::string& source) {
  PoseColumns out;
  if (table.header.empty()) {
    const std::size_t columns = table.rows.front().size();
    if (columns == 3) {
      out.reading = {0, 1, 2};
    } else if (columns == 4) {
      out.time = 0;
      out.reading = {1, 2, 3};
    } else {
      throw std::invalid_argument(
          fmt::format("{}: {} columns without a header; 3 (poses u, v, w) or 4 (t, u, v, w) are required",
                      source, columns));
    }
  } else if (column_named(table, {"r_u"}) && column_named(table, {"r_v"}) && column_named(table, {"r_w"})) {
    out.reading = {*column_named(table, {"r_u"}), *column_named(table, {"r_v"}),
                   *column_named(table, {"r_w"})};
    out.uncertainty = {column_named(table, {"u_u"}), column_named(table, {"u_v"}),
                       column_named(table, {"u_w"})};
    // With a column t the rows are samples; a column time_s belongs to averaged readings.
    out.time = column_named(table, {"t"});
  } else if (const auto t = column_named(table, {"t", "time", "time_s"}); t && table.header.size() == 4) {
    out.time = t;
    std::size_t next = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      if (i != *t) out.reading[next++] = i;
    }
  } else {
    throw std::invalid_argument(
        fmt::format("{}: columns {}; r_u, r_v, r_w (poses), or t and three others (time series) are required",
                    source, fmt::join(table.header, ", ")));
  }
  return out;
}

/// The averaged readings of a pose from one row.
DwellRecord pose_of(const TripleReader& triple, const PoseColumns& columns, std::size_t row) {
  const auto& [u, v, w] = columns.uncertainty;
  DwellRecord dwell;
  dwell.n = static_cast<int>(row) + 1;
  dwell.mean = triple(row, columns.reading);
  if (!u || !v || !w) return dwell;
  dwell.u_mean = triple(row, {*u, *v, *w});
  if (!(dwell.u_mean->minCoeff() >= 0.0)) {
    throw std::invalid_argument(fmt::format("{}: a negative uncertainty", triple.place(row)));
  }
  return dwell;
}

}  // namespace

std::vector<StaticStretch> static_stretches(const TimeSeries& series, const StaticSearch& search) {
  check(series, search);
  const std::size_t n = series.time_s.size();
  const auto nothing = [&] {
    return std::runtime_error(fmt::format("time series: no stretch of {} s without motion among {} samples",
                                          search.min_length_s, n));
  };
  if (n < 16) throw nothing();
  const double period = (series.time_s.back() - series.time_s.front()) / static_cast<double>(n - 1);
  const auto half = std::max<std::size_t>(2, static_cast<std::size_t>(0.5 * search.window_s / period));
  if (n < 2 * half + 1) throw nothing();

  const RunningSums sums(series.reading);
  std::vector<Eigen::Vector3d> spread(n);
  for (std::size_t i = 0; i < n; ++i) {
    spread[i] = sums.spread(i < half ? 0 : i - half, std::min(n, i + half + 1));
  }
  const Eigen::Vector3d limit = spread_limit(series, spread, search.threshold);
  StretchCollector collector(series, search, sums, limit);
  std::size_t first = 0;
  bool still = false;
  for (std::size_t i = 0; i <= n; ++i) {
    const bool now = i < n && (spread[i].array() <= limit.array()).all();
    if (now && !still) first = i;
    if (!now && still) collector.add(first, i);
    still = now;
  }
  std::vector<StaticStretch> found = collector.take();
  std::erase_if(found, [&](const StaticStretch& stretch) {
    return static_cast<double>(stretch.count) * period < search.min_length_s;
  });
  if (found.empty()) throw nothing();
  return found;
}

ImportedPoses import_poses(std::istream& in, const std::string& source, const StaticSearch& search) {
  const Table table = read_table(in, source);
  const PoseColumns columns = columns_of(table, source);
  const TripleReader triple(table, source);
  ImportedPoses out;
  out.record.source = source;
  out.record.tolerances = stated_sizes(table, source);
  if (!columns.time) {
    for (std::size_t row = 0; row < table.rows.size(); ++row)
      out.record.dwells.push_back(pose_of(triple, columns, row));
    return out;
  }

  out.from_time_series = true;
  TimeSeries series;
  for (std::size_t row = 0; row < table.rows.size(); ++row) {
    series.time_s.push_back(table.rows[row][*columns.time]);
    series.reading.push_back(triple(row, columns.reading));
  }
  out.samples = table.rows.size();
  out.stretches = static_stretches(series, search);
  for (const StaticStretch& stretch : out.stretches) {
    DwellRecord dwell;
    dwell.n = static_cast<int>(out.record.dwells.size()) + 1;
    dwell.mean = stretch.mean;
    dwell.spread = stretch.spread;
    dwell.count = static_cast<std::int64_t>(stretch.count);
    dwell.time_s = 0.5 * (stretch.start_s + stretch.end_s);
    // u_mean is left absent on purpose: the noise within a stretch does not show how well poses placed by
    // hand agree with each other, so the norm fit takes its uncertainties from that agreement.
    out.record.dwells.push_back(std::move(dwell));
  }
  return out;
}

ImportedPoses import_poses(const std::filesystem::path& path, const StaticSearch& search) {
  std::ifstream in(path);
  if (!in) throw std::runtime_error(path.string() + ": cannot be opened");
  return import_poses(in, path.string(), search);
}

}  // namespace abcal
