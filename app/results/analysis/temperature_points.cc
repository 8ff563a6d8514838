#include "app/results/analysis/temperature_points.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <stdexcept>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/item_identity.h"
#include "app/results/analysis/analyses.h"
#include "protocol/record/run_label.h"
#include "protocol/record/verify_run.h"

namespace abcal {
namespace {

double number_of(const std::string& text) {
  double value = std::nan("");
  std::from_chars(text.data(), text.data() + text.size(), value);
  return value;
}

}  // namespace

std::optional<PlaceInSeries> place_in_series(const RunHeader& header) {
  const auto leg = series_leg_from(label_of(header.labels, kLegLabel));
  if (!leg) return std::nullopt;
  PlaceInSeries place;
  place.leg = *leg;
  place.set_degc = number_of(label_of(header.labels, kSetLabel));
  const std::string stated = label_of(header.labels, kPointLabel);
  const char *begin = stated.data(), *end = begin + stated.size();
  constexpr std::string_view kOf = " of ";
  const char* after = std::from_chars(begin, end, place.number).ptr;
  if (std::string_view(after, static_cast<std::size_t>(end - after)).starts_with(kOf))
    std::from_chars(after + kOf.size(), end, place.of);
  return place;
}

TemperaturePoint point_of_series(const PlaceInSeries& place, const RunRecord& record,
                                 const CalibrationResult& result) {
  TemperaturePoint point = temperature_point(result);
  point.number = place.number;
  point.leg = place.leg;
  point.set_degc = place.set_degc;
  double sum = 0.0;
  int count = 0;
  for (const DwellRecord& dwell : record.dwells) {
    if (!dwell.temperature_degc) continue;
    sum += *dwell.temperature_degc;
    ++count;
  }
  // An item without a sensor: the air has soaked to the set point.
  point.by_item = count > 0;
  point.temperature_degc = count > 0 ? sum / count : point.set_degc;
  if (count > 1)
    point.change_k = record.dwells.back().temperature_degc.value_or(point.temperature_degc) -
                     record.dwells.front().temperature_degc.value_or(point.temperature_degc);
  return point;
}

std::vector<std::vector<TemperaturePoint>> points_of_series(const std::vector<std::filesystem::path>& paths) {
  std::vector<std::vector<TemperaturePoint>> points;
  for (std::size_t n = 0; n < paths.size(); ++n) {
    const std::filesystem::path& path = paths[n];
    std::vector<StoredRun> items = read_as_stored(path).items;
    auto place = place_in_series(items.front().header);
    if (!place)
      throw std::invalid_argument(path.string() + ": is no run of a series over temperature (no label " +
                                  kLegLabel + ")");
    if (items.front().state != RunState::kComplete)
      throw std::invalid_argument(path.string() + ": is not complete; go on with: abcal temperature BENCH");
    place->number = static_cast<int>(n) + 1;
    points.resize(std::max(points.size(), items.size()));
    const std::string estimator = declared_estimator(items.front().record).name;
    const AnalysedRun run = analyse_run(std::move(items), estimator);
    for (const AnalysedItem& item : run.items)
      points[static_cast<std::size_t>(item.stored.item) - 1].push_back(
          point_of_series(*place, item.stored.record, item.results.front()));
  }
  return points;
}

std::vector<AnalysedSeries> analyse_series(const std::vector<std::filesystem::path>& paths) {
  const std::vector<StoredRun> first = RunFile::load_items(paths.at(0));
  const BenchConfig config = parse_bench(first.front().header.bench_toml, paths[0].string());
  const std::vector<std::vector<TemperaturePoint>> points = points_of_series(paths);
  std::vector<AnalysedSeries> all;
  for (const StoredRun& run : first) {
    AnalysedSeries& series = all.emplace_back();
    const RunItem& item = run.own_item();
    series.item = in_words(ItemNames{item.maker, item.model, item.serial_number});
    series.response_unit = run.header.response_unit;
    series.performed = run.header.created_utc;
    series.g_loc_mps2 = run.record.g_loc.value_mps2;
    series.result =
        fit_temperature(points.at(all.size() - 1), config.temperature.reference_degc, series.response_unit);
  }
  return all;
}

}  // namespace abcal
