#include "protocol/record/table_columns.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <iterator>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "protocol/plan/response_unit.h"
#include "protocol/record/table_time.h"

namespace abcal {
namespace {

constexpr std::array<std::string_view, 31> kOwn{"experiment",    "n",
                                                "alpha_deg",     "r_u",
                                                "r_v",           "r_w",
                                                "u_u",           "u_v",
                                                "u_w",           "time_s",
                                                "count",         "flags",
                                                "closing",       "temperature_degc",
                                                "face",          "item",
                                                "encoder_x_deg", "encoder_z_deg",
                                                "spread_u",      "spread_v",
                                                "spread_w",      "up_x",
                                                "up_y",          "up_z",
                                                "pose_roll_deg", "pose_pitch_deg",
                                                "pose_yaw_deg",  "pose_qw",
                                                "pose_qx",       "pose_qy",
                                                "pose_qz"};
/// The ways to state the directions of poses; yaw turns about the vertical and need not be there.
constexpr std::array<std::array<std::string_view, 4>, 3> kDirections{
    {{"up_x", "up_y", "up_z", ""},
     {"pose_roll_deg", "pose_pitch_deg", "", ""},
     {"pose_qw", "pose_qx", "pose_qy", "pose_qz"}}};
constexpr std::array<std::string_view, 3> kReadingNames{"r_u", "r_v", "r_w"};
/// Names of a time, without its unit, and of an acceleration, without its axis; letters and digits alone.
constexpr std::string_view kTimes[] = {
    "t",           "time",        "timestamp",  "timestamps",     "stamp",      "datetime", "utc",
    "elapsed",     "elapsedtime", "unixtime",   "headerstamp",    "sampletime", "epoch",    "epoc",
    "epochtime",   "ts",          "systemtime", "secondselapsed", "clock",      "chiptime", "zeit",
    "zeitstempel", "temps",       "tiempo",     "tempo"};
constexpr std::string_view kAccelerations[] = {"",
                                               "a",
                                               "ac",
                                               "acc",
                                               "accel",
                                               "accelerometer",
                                               "acceleration",
                                               "linearacceleration",
                                               "imuacc",
                                               "imu",
                                               "rawacc",
                                               "out",
                                               "accraw",
                                               "accelraw",
                                               "axis",
                                               "imulinearacceleration",
                                               "fieldlinearacceleration",
                                               "arss",
                                               "beschleunigung",
                                               "acclration",
                                               "aceleracin",
                                               "aceleracion",
                                               "accelerazione"};
constexpr const char* kWhatIsRead =
    "a header \"experiment,n,alpha_deg,r_u,r_v,r_w\" (averages with angles), \"r_u,r_v,r_w\" (poses) or "
    "\"t,r_u,r_v,r_w\" (a time series), or --columns with such names, \"-\" for a column to be ignored";

bool is_own(std::string_view name) {
  return std::ranges::find(kOwn, name) != kOwn.end();
}

/// A name of a header: "Accel X (m/s^2)" is "accelx" in "m/s2".
struct HeaderName {
  std::string letters;  ///< Lower case, letters and digits alone.
  std::string unit;
};

std::string letters_of(std::string_view text) {
  std::string letters = pieces::lower(text);
  std::erase_if(letters, [](char c) { return !pieces::is_digit(c) && (c < 'a' || c > 'z'); });
  return letters;
}

/// "m/s2" for the ways to write it; any other unit of the table of units as it stands; else empty.
std::string unit_named(std::string_view text) {
  std::string unit(pieces::trimmed(text));
  for (const char* name : {"m/s^2", "m/s\xC2\xB2", "m/s/s", "mps2", "m/s**2", "ms2", "ms-2", "m s^-2",
                           "m/(s^2)", "m.s^-2", "m*s^-2"})
    if (pieces::lower(unit) == name) return "m/s2";
  if (unit == "G") return "g";
  return find_unit(unit) ? unit : std::string();
}

HeaderName parts_of(std::string_view text) {
  std::string unit;
  if (const std::size_t open = text.find_first_of("([");
      open != std::string_view::npos && open > 0 && text.find_first_of(")]") == text.size() - 1) {
    unit = text.substr(open + 1, text.size() - open - 2);
    if (std::ranges::all_of(unit, pieces::is_digit)) unit.clear();  // An index.
    text = text.substr(0, open);
  } else if (const std::size_t last = text.find_last_of("_ "); last != std::string_view::npos) {
    const std::string_view end = text.substr(last + 1);
    if (end.size() > 1 ? unit_of_time(end) != nullptr || !unit_named(end).empty()
                       : end == "s" || end == "g") {
      unit = end;
      text = text.substr(0, last);
    }
  }
  return {letters_of(text), std::move(unit)};
}

bool is_known_time(std::string_view letters) {
  return std::ranges::find(kTimes, letters) != std::end(kTimes);
}

/// "millis", "timems": the unit is in the name.
std::string unit_in_name_of_time(std::string_view letters) {
  if (letters == "millis" || letters == "micros") return std::string(letters);
  for (const UnitOfTime& unit : kUnitsOfTime)
    if (unit.name.size() > 1 && letters.ends_with(unit.name) &&
        is_known_time(letters.substr(0, letters.size() - unit.name.size())))
      return std::string(unit.name);
  return {};
}

bool is_time(const HeaderName& name) {
  return is_known_time(name.letters) || !unit_in_name_of_time(name.letters).empty();
}

/// The axis of an acceleration, 0 to 2, and its letters without it: "accx", "xacc".
std::optional<std::pair<std::size_t, std::string>> axis_of(const std::string& letters) {
  if (letters.empty()) return std::nullopt;
  for (const std::string_view axes : {"xyz", "uvw"}) {
    const auto known = [&](char axis, const std::string& stem) {
      return axes.find(axis) != std::string_view::npos &&
             std::ranges::find(kAccelerations, stem) != std::end(kAccelerations);
    };
    if (const std::string stem = letters.substr(0, letters.size() - 1); known(letters.back(), stem))
      return std::pair{axes.find(letters.back()), stem + std::string(axes)};
    if (const std::string stem = letters.substr(1); !stem.empty() && known(letters.front(), stem))
      return std::pair{axes.find(letters.front()), std::string(axes) + stem};
  }
  return std::nullopt;
}

/// A name in its words, in small letters: "Accel_LN_X" is "accel", "ln", "x".
std::vector<std::string> words_of_name(std::string_view name) {
  std::vector<std::string> words(1);
  for (const char c : pieces::lower(name)) {
    if (pieces::is_digit(c) || (c >= 'a' && c <= 'z')) {
      words.back() += c;
    } else if (!words.back().empty()) {
      words.emplace_back();
    }
  }
  return words;
}

/// The axis of a name in words, one of which is that of an acceleration and one the axis:
/// "Shimmer_5E2F_Accel_LN_X_CAL", "accelerometer_m_s2[0]"; and the other words.
std::optional<std::pair<std::size_t, std::string>> axis_in_words(std::string_view name) {
  std::vector<std::string> words = words_of_name(name);
  if (std::ranges::none_of(words, [](const std::string& word) { return word.starts_with("acc"); }))
    return std::nullopt;
  for (const char* axes : {"xyz", "uvw", "012"}) {
    const auto axis_of_word = [&](const std::string& word) {
      return word.size() == 1 ? std::string_view(axes).find(word.front()) : std::string_view::npos;
    };
    const auto found = std::find_if(words.rbegin(), words.rend(), [&](const std::string& word) {
      return axis_of_word(word) != std::string_view::npos;
    });
    if (found == words.rend()) continue;
    const std::size_t axis = axis_of_word(*found);
    *found = axes;
    return std::pair{axis, fmt::format("{}", fmt::join(words, " "))};
  }
  return std::nullopt;
}

class ColumnFinder {
 public:
  /// @param units  of the columns, as a second line of the header states them; empty: none does
  ColumnFinder(std::vector<std::string> header, const std::vector<std::string>& units, std::string where,
               TableProblems& problems)
      : header_(std::move(header)), where_(std::move(where)), problems_(problems) {
    for (const std::string& name : header_) parts_.push_back(parts_of(name));
    for (std::size_t i = 0; i < units.size(); ++i)
      if (parts_.at(i).unit.empty()) parts_[i].unit = units[i];
  }

  TableColumns find() {
    take_own();
    const bool of_averages = has_some_reading();
    if (!of_averages) take_of_others();
    take_time(of_averages);
    const bool circles = columns_.has("experiment") || columns_.has("alpha_deg");
    if (circles) {
      columns_.kind = TableKind::kCircles;
      for (const char* name : {"experiment", "n", "alpha_deg"}) require(name);
    } else if (columns_.has("t")) {
      columns_.kind = TableKind::kTimeSeries;
    }
    for (const std::string_view name : kReadingNames) require(name);
    const auto has = [&](const char* name) { return columns_.has(name); };
    if (has("u_u") || has("u_v") || has("u_w"))
      for (const char* name : {"u_u", "u_v", "u_w"}) require(name);
    require_direction();
    if (problems_.count() > 0) problems_.fail();
    take_units();
    name_ignored();
    return std::move(columns_);
  }

 private:
  bool is_time_column(std::size_t i) const {
    const std::vector<std::string> words = words_of_name(header_[i]);
    return is_time(parts_[i]) || std::ranges::find(words, "timestamp") != words.end();
  }

  bool has_some_reading() const {
    return std::ranges::any_of(kReadingNames, [&](std::string_view name) { return columns_.has(name); });
  }

  void take(std::string_view name, std::size_t place) {
    if (!columns_.place.emplace(name, place).second)
      problems_.add(fmt::format("{}, {}", where_, name), "the column twice", "each column once");
  }

  void require(std::string_view name) {
    if (columns_.has(name)) return;
    problems_.add(where_, as_quoted(fmt::format("{}", fmt::join(header_, ","))),
                  columns_.kind == TableKind::kCircles || has_some_reading()
                      ? fmt::format("a column {}", name)
                      : kWhatIsRead);
    if (!has_some_reading() && columns_.kind != TableKind::kCircles) problems_.fail();
  }

  /// The columns of one way to state directions, all or none.
  void require_direction() {
    std::vector<std::string_view> ways;
    for (const auto& names : kDirections) {
      const auto is_there = [&](std::string_view name) { return columns_.has(name); };
      if (std::ranges::none_of(names, is_there)) continue;
      ways.push_back(names.front());
      for (const std::string_view name : names)
        if (!name.empty()) require(name);
    }
    if (ways.size() > 1)
      problems_.add(where_, fmt::format("directions by {}", fmt::join(ways, " and by ")), "one of them");
    if (!ways.empty() && columns_.kind == TableKind::kCircles)
      problems_.add(where_, fmt::format("{} in addition to alpha_deg", ways.front()), "one of them");
  }

  void take_own() {
    for (std::size_t i = 0; i < header_.size(); ++i)
      if (const std::string name = pieces::lower(header_[i]); is_own(name)) take(name, i);
  }

  /// The three columns of one acceleration in the names of others; else the only three beside a time.
  void take_of_others() {
    std::map<std::string, std::map<std::size_t, std::size_t>> found;  // Column of each axis, by the stem.
    std::vector<std::size_t> others;
    for (std::size_t i = 0; i < header_.size(); ++i) {
      auto axis = axis_of(parts_[i].letters);
      if (!axis) axis = axis_in_words(header_[i]);
      if (axis) found[axis->second].emplace(axis->first, i);
      if (!is_time_column(i) && !columns_.has(pieces::lower(header_[i]))) others.push_back(i);
    }
    std::erase_if(found, [](const auto& each) { return each.second.size() < 3; });
    if (found.size() > 1) {
      problems_.add(
          where_,
          fmt::format("several accelerations: {}", as_quoted(fmt::format("{}", fmt::join(header_, ",")))),
          "--columns with names for those to be used, such as \"t,-,-,-,x,y,z\"");
      problems_.fail();
    }
    if (found.size() == 1) {
      for (const auto& [axis, place] : found.begin()->second) take(kReadingNames.at(axis), place);
    } else if (others.size() == 3 && header_.size() == 4) {
      for (std::size_t axis = 0; axis < 3; ++axis) take(kReadingNames.at(axis), others[axis]);
    }
  }

  /// @param of_averages  the readings have the names of abcal, where time_s is the time of an average
  void take_time(bool of_averages) {
    for (std::size_t i = 0; i < header_.size(); ++i) {
      if (!is_time_column(i) || columns_.has("t")) continue;
      const bool is_time_s = columns_.has("time_s") && columns_.place.at("time_s") == i;
      if (is_time_s && of_averages) continue;
      if (is_time_s) columns_.place.erase("time_s");
      columns_.place["t"] = i;
      columns_.time_unit = parts_[i].unit.empty() ? unit_in_name_of_time(parts_[i].letters) : parts_[i].unit;
    }
  }

  void take_units() {
    for (const std::string_view name : kReadingNames) {
      const std::size_t place = columns_.place.at(std::string(name));
      columns_.readings += fmt::format("{}{}", columns_.readings.empty() ? "" : ", ", header_[place]);
      const std::string unit = is_own(pieces::lower(header_[place])) ? "" : unit_named(parts_[place].unit);
      if (name != kReadingNames.front() && unit != columns_.unit)
        problems_.add(fmt::format("{}, {}", where_, header_[place]), as_quoted(unit),
                      fmt::format("the unit of the other readings, {}", as_quoted(columns_.unit)));
      columns_.unit = unit;
    }
    if (!columns_.time_unit.empty() && unit_of_time(columns_.time_unit) == nullptr)
      columns_.time_unit.clear();  // "[UTC]", "[-]"
  }

  void name_ignored() {
    for (std::size_t i = 0; i < header_.size(); ++i)
      if (!header_[i].empty() && header_[i] != "-" &&
          std::ranges::none_of(columns_.place, [&](const auto& each) { return each.second == i; }))
        columns_.ignored.push_back(header_[i]);
  }

  std::vector<std::string> header_;
  std::string where_;
  TableProblems& problems_;
  std::vector<HeaderName> parts_;
  TableColumns columns_;
};

/// A name for each of `width` columns from `--columns`.
std::vector<std::string> stated_columns(const TableOptions& options, std::size_t width,
                                        TableProblems& problems) {
  std::vector<std::string> names;
  for (const std::string_view name : pieces::split(options.columns, ','))
    names.emplace_back(pieces::trimmed(name));
  if (names.size() > width)
    problems.add(options.columns_by, fmt::format("{} names", names.size()),
                 fmt::format("at most {}, as many as the first row has columns", width));
  names.resize(width);
  return names;
}

}  // namespace

TableColumns find_columns(TableReader& table, const TableOptions& options, TableProblems& problems) {
  TableRow first;
  if (!table.next(first)) {
    problems.add("the file", table.is_empty() ? "nothing" : "no header line", kWhatIsRead);
    problems.fail();
  }
  const bool has_header = std::ranges::any_of(first.cells, [&](const std::string& cell) {
    return !cell.empty() && !table.number(cell) && !seconds_of_iso(cell);
  });
  const std::size_t width = first.cells.size();
  const std::string where =
      options.columns.empty() ? fmt::format("line {}, header", first.line) : options.columns_by;
  std::vector<std::string> names = first.cells, units;
  if (!has_header) {
    names = table.commented_header();
    const auto of_readings = std::ranges::count_if(names, [](const std::string& name) {
      return is_own(pieces::lower(name)) || axis_of(parts_of(name).letters) || axis_in_words(name);
    });
    if (names.size() != width || of_readings < 3) names.clear();
    table.put_back(std::move(first));
  } else {
    const auto is_text = [&](const std::string& cell) {
      return !table.number(cell) && !seconds_of_iso(cell);
    };
    TableRow second;
    if (table.next(second)) {
      if (std::ranges::all_of(second.cells, is_text)) {
        units = std::move(second.cells);
      } else {
        table.put_back(std::move(second));
      }
    }
  }
  if (!options.columns.empty()) names = stated_columns(options, width, problems);
  if (names.empty() && width == 3) names = {"r_u", "r_v", "r_w"};
  if (names.empty() && width == 4) names = {"t", "r_u", "r_v", "r_w"};
  if (names.empty()) {
    problems.add(where, fmt::format("{} columns without a header", width), kWhatIsRead);
    problems.fail();
  }
  return ColumnFinder(std::move(names), units, where, problems).find();
}

}  // namespace abcal
