#pragma once

#include <cstdio>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "app/laboratory/compare/check_chart.h"
#include "app/laboratory/register/register.h"

namespace abcal {

/// A chart with its points and blocks, to be shown.
struct ShownChart {
  struct Point {
    std::string identity, run_sha256, date, found, added_by;
    bool outside = false;  ///< The verdict when the point was added.
    ChartValue value;
  };
  struct Block {
    std::string found, set_utc, lifted_by, lifted_utc, reason;
    bool holds = false;
  };
  /// A run that is measured but not judged yet.
  struct Waiting {
    std::string file, date, run_sha256, told_by;
  };
  std::string name, approved_by, approved_utc, retired;
  CheckBaseline baseline;
  std::vector<Point> points;
  std::vector<Block> blocks;
  std::vector<Waiting> waiting;

  bool blocked() const;
  std::vector<JudgedPoint> judged() const;
};

/// A chart of the register, with its baseline, points and blocks.
/// @throws lab::RegisterError, CheckChartError
ShownChart shown_chart(lab::Register& opened, const std::string& name);

/// @param stream  the stream that it is printed on, for colours
std::string chart_text(const ShownChart& chart, std::FILE* stream);

/// Schema abcal.chart/1.
nlohmann::ordered_json chart_json(const ShownChart& chart);

/// The command with which a person has a run judged.
std::string command_to_add(const std::string& chart, const std::string& file);

/// The nine properties with their limits, for gnuplot, without terminal and output.
std::string chart_script(const ShownChart& chart);

}  // namespace abcal
