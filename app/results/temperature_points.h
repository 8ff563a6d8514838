#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/temperature/temperature_fit.h"

namespace abcal {

/// Labels of the run of one point of a series over temperature, by which it is found again.
inline constexpr const char* kPointLabel = "temperature.point";   ///< "3 of 15"
inline constexpr const char* kLegLabel = "temperature.leg";       ///< "up"
inline constexpr const char* kSetLabel = "temperature.set_degc";  ///< "-40"
inline constexpr const char* kSoakLabel = "temperature.soak";     ///< In words.
inline constexpr const char* kPlanLabel = "temperature.plan";     ///< What its plan was found for, if it was.

/// Where the run of a point stands in its series, as its labels say.
struct PlaceInSeries {
  int number = 0, of = 0;  ///< "3 of 15"
  SeriesLeg leg = SeriesLeg::kUp;
  double set_degc = 0.0;
};

/// @return nothing for a run that is none of a series
std::optional<PlaceInSeries> place_in_series(const RunHeader& header);

/// The run of one point, analysed. @throws std::invalid_argument as temperature_point()
TemperaturePoint point_of_series(const PlaceInSeries& place, const RunRecord& record,
                                 const CalibrationResult& result);

/// The points of a series from their run files, in order, for fit_temperature().
/// @throws std::invalid_argument for a file that is none of a series, or not complete
std::vector<TemperaturePoint> points_of_series(const std::vector<std::filesystem::path>& paths);

/// A measured series and its fit.
struct AnalysedSeries {
  TemperatureResult result;
  std::string item;  ///< Maker, model, serial number of the first run; empty: not known.
  std::string response_unit;
  std::string performed;  ///< UTC, of the first run.
  double g_loc_mps2 = 0.0;
};

/// points_of_series() and their fit, about the reference that the runs' bench file names.
/// @throws std::invalid_argument as these
AnalysedSeries analyse_series(const std::vector<std::filesystem::path>& paths);

}  // namespace abcal
