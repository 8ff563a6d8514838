#include "app/bench_file/chamber_consistency.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "drivers/instrument/driver_catalogue.h"

namespace abcal {
namespace {

constexpr const char* kPoints = "temperature.set_points_degc";
/// Dew point (degC) of a room whose conditions are not stated: that of 25 degC and 55 %.
constexpr double kUsualDewPoint = 15.0;

/// All temperatures of the series.
std::vector<double> all_points(const TemperatureConfig& t) {
  std::vector<double> points = t.set_points_degc;
  points.push_back(t.reference_degc);
  return points;
}

std::string list_of(const std::vector<double>& points) {
  return fmt::format("{:g}", fmt::join(points, ", "));
}

template <class Is>
std::vector<double> those(const std::vector<double>& points, Is is) {
  std::vector<double> found;
  std::copy_if(points.begin(), points.end(), std::back_inserter(found), is);
  return found;
}

void check_range(std::vector<Problem>& problems, const TemperatureConfig& t,
                 const std::optional<double>& least, const std::optional<double>& most,
                 const std::string& whose) {
  const auto outside =
      those(all_points(t), [&](double degc) { return (least && degc < *least) || (most && degc > *most); });
  if (outside.empty()) return;
  problems.push_back({kPoints, list_of(outside) + " degC",
                      fmt::format("{} to {} degC, {}", least ? fmt::format("{:g}", *least) : "any",
                                  most ? fmt::format("{:g}", *most) : "any", whose)});
}

void check_points(std::vector<Problem>& problems, const TemperatureConfig& t) {
  const std::vector<double>& points = t.set_points_degc;
  if (points.size() < 2)
    problems.push_back({kPoints, list_of(points), "at least two temperatures, from one end to the other"});
  const bool up = std::adjacent_find(points.begin(), points.end(), std::greater_equal<>()) == points.end();
  const bool down = std::adjacent_find(points.begin(), points.end(), std::less_equal<>()) == points.end();
  if (!up && !down)
    problems.push_back({kPoints, list_of(points), "each once, in order from one end to the other"});
}

/// The longest ramp from one point to the next, in seconds.
double longest_ramp_s(const TemperatureConfig& t) {
  if (t.ramp_k_per_min <= 0.0) return 0.0;
  double before = t.reference_degc, longest = 0.0;
  for (const double degc : all_points(t)) {
    longest = std::max(longest, std::abs(degc - before));
    before = degc;
  }
  return longest / t.ramp_k_per_min * 60.0;
}

void check_soak(std::vector<Problem>& problems, const TemperatureConfig& t) {
  if (t.soak_rate_k_per_min <= 0.0)
    problems.push_back({"temperature.soak_rate_k_per_min", fmt::format("{:g}", t.soak_rate_k_per_min),
                        "more than 0: no sensor ever stands still, so the soak would never end"});
  const double needed = longest_ramp_s(t) + std::max(t.soak_min_s, t.soak_span_s);
  if (t.soak_max_s <= needed)
    problems.push_back({"temperature.soak_max_s", fmt::format("{:g} s", t.soak_max_s),
                        fmt::format("more than {:g} s: the longest ramp takes {:g} s and the shortest soak "
                                    "{:g} s, so the soak would never end",
                                    needed, longest_ramp_s(t), std::max(t.soak_min_s, t.soak_span_s))});
}

void check_dew_point(std::vector<Problem>& problems, const BenchConfig& c) {
  const double dew = assumed_dew_point_degc(c) + c.temperature.dew_point_margin_k;
  const auto wet = those(all_points(c.temperature), [&](double degc) { return degc < dew; });
  if (wet.empty()) return;
  problems.push_back(
      {kPoints, list_of(wet) + " degC",
       fmt::format(
           "above {:.1f} degC, the dew point of the room's air with its margin; or a chamber that measures "
           "humidity ([chamber] humidity); or dry air or nitrogen on ([chamber] dry_gas = true)",
           dew)});
}

void check_chamber(std::vector<Problem>& problems, const ChamberConfig& chamber) {
  const bool by_hand = !find_in(driver_catalogue().chambers, chamber.driver).has_port;
  if (chamber.driver.empty() != chamber.port.empty() && !by_hand)
    problems.push_back(
        {chamber.port.empty() ? "chamber.port" : "chamber.driver", "nothing", "driver and port, or neither"});
  if (by_hand && !chamber.port.empty())
    problems.push_back({"chamber.port", "\"" + chamber.port + "\"", "nothing, as a person sets the chamber"});
  if (chamber.min_degc && chamber.max_degc && !(*chamber.min_degc < *chamber.max_degc))
    problems.push_back({"chamber.min_degc", fmt::format("{:g} to {:g}", *chamber.min_degc, *chamber.max_degc),
                        "min_degc < max_degc"});
  if (chamber.settings.pause_output != 0 && chamber.settings.pause_output == chamber.settings.run_output)
    problems.push_back({"chamber.pause_output",
                        fmt::format("{}, also run_output", chamber.settings.pause_output),
                        "another output than the one that starts the chamber"});
}

}  // namespace

double dew_point_degc(double air_degc, double humidity_percent) {
  const double x =
      std::log(std::max(humidity_percent, 0.01) / 100.0) + 17.62 * air_degc / (243.12 + air_degc);
  return 243.12 * x / (17.62 - x);
}

double assumed_dew_point_degc(const BenchConfig& config) {
  const EnvironmentConfig& room = config.environment;
  if (!room.temperature_degc || !room.humidity_percent) return kUsualDewPoint;
  return dew_point_degc(*room.temperature_degc, *room.humidity_percent);
}

std::vector<Problem> chamber_problems(const BenchConfig& c) {
  std::vector<Problem> problems;
  check_chamber(problems, c.chamber);
  const TemperatureConfig& t = c.temperature;
  if (!t.wanted()) return problems;
  if (!c.chamber.present() && c.chamber.port.empty())
    problems.push_back(
        {"chamber.driver", "nothing", "a chamber's driver and port, as [temperature] has set points"});
  check_points(problems, t);
  check_range(problems, t, c.chamber.min_degc, c.chamber.max_degc, "the limits of [chamber]");
  check_range(problems, t, t.item_min_degc, t.item_max_degc, "what the item stands ([temperature])");
  const auto limit = [](double degc) { return std::abs(degc) < 1e9 ? std::optional(degc) : std::nullopt; };
  check_range(problems, t, limit(c.items.front().limits.temperature_min_degc),
              limit(c.items.front().limits.temperature_max_degc),
              "the limits of a run ([limits]); widen them or leave them out");
  check_soak(problems, t);
  const bool may_measure = c.chamber.settings.humidity ||
                           find_in(driver_catalogue().chambers, c.chamber.driver).traits.tells_humidity;
  if (!c.chamber.dry_gas && !may_measure) check_dew_point(problems, c);
  return problems;
}

std::vector<Problem> chamber_problems(const BenchConfig& c, const ChamberInfo& chamber) {
  std::vector<Problem> problems;
  const TemperatureConfig& t = c.temperature;
  if (!t.wanted()) return problems;
  check_range(problems, t, chamber.least_set_degc, chamber.most_set_degc,
              "the limits of the hardware of chamber " + chamber.model);
  if (!c.chamber.dry_gas && !chamber.has_humidity) check_dew_point(problems, c);
  return problems;
}

}  // namespace abcal
