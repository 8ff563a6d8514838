#include "app/laboratory/certificate/certified_series.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

#include "app/results/analysis/temperature_points.h"

namespace abcal {
namespace {

constexpr const char* kOption = "--temperature";

std::string in_quotes(const std::string& text) {
  return text.empty() ? "nothing" : "\"" + text + "\"";
}

/// The bench and its stage, by their names.
std::string bench_of(const ReportData& data) {
  std::string text = data.label("bench.name");
  for (const InstrumentIdentity& instrument : data.run->header.instruments)
    if (instrument.role.starts_with("stage"))
      text += fmt::format("{}{} {}", text.empty() ? "" : ", ", instrument.model, instrument.serial_number);
  return text;
}

std::optional<PlaceInSeries> place_of(const ReportData& point) {
  return point.run ? place_in_series(point.run->header) : std::nullopt;
}

std::string where_in_series(const ReportData& point) {
  return fmt::format("{}, \"{}\"", kOption, point.path.filename().string());
}

/// Adds the differences between a point and the run of the certificate.
void compare_with_run(const ReportData& point, const ReportData& run, std::vector<Problem>& problems) {
  const std::string where = where_in_series(point);
  for (const char* key : {"item.maker", "item.model", "item.serial_number"})
    if (point.label(key) != run.label(key))
      problems.push_back({where + ", " + key, in_quotes(point.label(key)),
                          "the item of the run, " + in_quotes(run.label(key))});
  if (point.record.response_unit != run.record.response_unit)
    problems.push_back({where + ", response unit", point.record.response_unit, run.record.response_unit});
  if (bench_of(point) != bench_of(run))
    problems.push_back(
        {where + ", bench", in_quotes(bench_of(point)), "the bench of the run, " + in_quotes(bench_of(run))});
}

/// Reports points of a series that are missing or repeated.
void check_whole(const std::vector<PlaceInSeries>& places, std::vector<Problem>& problems) {
  if (places.empty()) return;
  const int of = places.front().of;
  std::vector<int> there, missing, twice;
  for (const PlaceInSeries& place : places) {
    if (place.of != of) {
      problems.push_back({kOption, fmt::format("points of a series of {} and of one of {}", of, place.of),
                          "the points of one series"});
      return;
    }
    there.push_back(place.number);
  }
  for (int number = 1; number <= of; ++number) {
    const auto count = std::count(there.begin(), there.end(), number);
    if (count == 0) missing.push_back(number);
    if (count > 1) twice.push_back(number);
  }
  if (!missing.empty())
    problems.push_back({kOption, fmt::format("no point {} of {}", fmt::join(missing, ", "), of),
                        "every point of the series, with its return to the reference"});
  if (!twice.empty())
    problems.push_back({kOption, fmt::format("point {} twice", fmt::join(twice, ", ")), "every point once"});
}

}  // namespace

std::vector<Problem> problems_of_series(const std::vector<ReportData>& points, const ReportData& run) {
  std::vector<Problem> problems;
  std::vector<PlaceInSeries> places;
  const ReportData* first = nullptr;
  for (const ReportData& point : points) {
    const auto place = place_of(point);
    if (!place) {
      problems.push_back({where_in_series(point),
                          point.run ? "a run that is no point of a series" : "no run file",
                          "a run that `abcal temperature` measured"});
      continue;
    }
    places.push_back(*place);
    if (run.run) compare_with_run(point, run, problems);
    if (first == nullptr) first = &point;
    if (point.run->header.bench_toml != first->run->header.bench_toml)
      problems.push_back({where_in_series(point), "measured with another bench file",
                          "the same for all points, that of " + first->path.filename().string()});
  }
  check_whole(places, problems);
  const auto place = place_of(run);
  if (place && place->leg != SeriesLeg::kReference && place->leg != SeriesLeg::kReturn)
    problems.push_back({"run", fmt::format("the point of a series at {:g} degC", place->set_degc),
                        "a run at the reference temperature of the series"});
  return problems;
}

CertifiedSeries certified_series(std::vector<ReportData> points, std::vector<Problem>& problems) {
  CertifiedSeries series;
  series.points = std::move(points);
  const auto number = [](const ReportData& point) {
    const auto place = place_of(point);
    return place ? place->number : 0;
  };
  std::stable_sort(series.points.begin(), series.points.end(),
                   [&](const ReportData& a, const ReportData& b) { return number(a) < number(b); });
  std::vector<TemperaturePoint> values;
  for (const ReportData& point : series.points) {
    const auto place = place_of(point);
    // Reported already: these runs are no series, or one has no result.
    if (!place || !point.bench || point.result().verdict == Verdict::kNotUsable) return series;
    values.push_back(point_of_series(*place, point.record, point.result()));
  }
  try {
    const ReportData& first = series.points.front();
    series.result = fit_temperature(std::move(values), first.bench->temperature.reference_degc,
                                    first.record.response_unit);
    for (const StageTrend& trend : series.result->stage)
      if (!trend.constant())
        problems.push_back({fmt::format("{}, {} of the stage", kOption, trend.name),
                            fmt::format("{:.2g} {}/K, standard uncertainty {:.1g}", trend.slope, trend.unit,
                                        trend.standard_uncertainty),
                            "a stage that does not change with temperature"});
  } catch (const std::invalid_argument& error) {
    problems.push_back({kOption, error.what(), "runs at several temperatures"});
  }
  return series;
}

}  // namespace abcal
