#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/record/run_label.h"
#include "protocol/temperature/temperature_fit.h"

namespace abcal {

/// Place of a point's run in its series, as stated by the run's labels.
struct PlaceInSeries {
  int number = 0, of = 0;  ///< "3 of 15"
  SeriesLeg leg = SeriesLeg::kUp;
  double set_degc = 0.0;
};

/// @return nothing for a run that belongs to no series
std::optional<PlaceInSeries> place_in_series(const RunHeader& header);

/// The run of one point, analysed. @throws std::invalid_argument as temperature_point()
TemperaturePoint point_of_series(const PlaceInSeries& place, const RunRecord& record,
                                 const CalibrationResult& result);

/// The points of a series from their run files, in order, for fit_temperature(): one list for each item of
/// the runs.
/// @throws std::invalid_argument for a file that belongs to no series, or is not complete
std::vector<std::vector<TemperaturePoint>> points_of_series(const std::vector<std::filesystem::path>& paths);

/// A measured series of one item and its fit.
struct AnalysedSeries {
  TemperatureResult result;
  std::string item;  ///< Maker, model, serial number of the first run; empty: not known.
  std::string response_unit;
  std::string performed;  ///< UTC, of the first run.
  double g_loc_mps2 = 0.0;
};

/// points_of_series() of each item and their fit, about the reference that the runs' bench file names.
/// @throws std::invalid_argument as these
std::vector<AnalysedSeries> analyse_series(const std::vector<std::filesystem::path>& paths);

}  // namespace abcal
