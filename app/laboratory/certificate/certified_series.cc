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

const Message kOption("{option}", "--temperature");

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

Message where_in_series(const ReportData& point) {
  return {"{option}, {file}", kOption, quoted(point.path.filename().string())};
}

/// Adds the differences between a point and the run of the certificate.
void compare_with_run(const ReportData& point, const ReportData& run, std::vector<Reason>& problems) {
  const Message where = where_in_series(point);
  for (const char* key : {"item.maker", "item.model", "item.serial_number"})
    if (point.label(key) != run.label(key))
      problems.push_back({where, Message("{key}", key), quoted(point.label(key)),
                          Message("the item of the run, {item}", quoted(run.label(key)))});
  if (point.record.response_unit != run.record.response_unit)
    problems.push_back({where, Message("response unit"), Message("{unit}", point.record.response_unit),
                        Message("{unit}", run.record.response_unit)});
  if (bench_of(point) != bench_of(run))
    problems.push_back({where, Message("bench"), quoted(bench_of(point)),
                        Message("the bench of the run, {bench}", quoted(bench_of(run)))});
}

/// Reports points of a series that are missing or repeated.
void check_whole(const std::vector<PlaceInSeries>& places, std::vector<Reason>& problems) {
  if (places.empty()) return;
  const int of = places.front().of;
  std::vector<int> there, missing, twice;
  for (const PlaceInSeries& place : places) {
    if (place.of != of) {
      problems.push_back({kOption,
                          {},
                          Message("points of a series of {first} and of one of {second}", of, place.of),
                          Message("the points of one series")});
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
    problems.push_back(
        {kOption,
         {},
         Message("no point {points} of {all}", fmt::format("{}", fmt::join(missing, ", ")), of),
         Message("every point of the series, with its return to the reference")});
  if (!twice.empty())
    problems.push_back({kOption,
                        {},
                        Message("point {points} twice", fmt::format("{}", fmt::join(twice, ", "))),
                        Message("every point once")});
}

}  // namespace

std::vector<Reason> problems_of_series(const std::vector<ReportData>& points, const ReportData& run) {
  std::vector<Reason> problems;
  std::vector<PlaceInSeries> places;
  const ReportData* first = nullptr;
  for (const ReportData& point : points) {
    const auto place = place_of(point);
    if (!place) {
      problems.push_back({where_in_series(point),
                          {},
                          point.run ? Message("a run that is no point of a series") : Message("no run file"),
                          Message("a run that `abcal temperature` measured")});
      continue;
    }
    places.push_back(*place);
    if (run.run) compare_with_run(point, run, problems);
    if (first == nullptr) first = &point;
    if (point.run->header.bench_toml != first->run->header.bench_toml)
      problems.push_back(
          {where_in_series(point),
           {},
           Message("measured with another bench file"),
           Message("the same for all points, that of {file}", first->path.filename().string())});
  }
  check_whole(places, problems);
  const auto place = place_of(run);
  if (place && place->leg != SeriesLeg::kReference && place->leg != SeriesLeg::kReturn)
    problems.push_back({Message("run"),
                        {},
                        Message("the point of a series at {temperature:g} degC", place->set_degc),
                        Message("a run at the reference temperature of the series")});
  return problems;
}

CertifiedSeries certified_series(std::vector<ReportData> points, std::vector<Reason>& problems) {
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
        problems.push_back({kOption, Message("{name} of the stage", trend.name),
                            Message("{slope:.2g} {unit}/K, standard uncertainty {uncertainty:.1g}",
                                    trend.slope, trend.unit, trend.standard_uncertainty),
                            Message("a stage that does not change with temperature")});
  } catch (const std::invalid_argument& error) {
    problems.push_back({kOption, {}, Message::bare(error.what()), Message("runs at several temperatures")});
  }
  return series;
}

}  // namespace abcal
