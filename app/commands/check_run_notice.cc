#include "app/commands/check_run_notice.h"

#include <fmt/format.h>

#include <algorithm>
#include <exception>
#include <filesystem>
#include <string>
#include <vector>

#include "app/bench/bench_config.h"
#include "app/bench/make_bench.h"
#include "app/bench/real_clock.h"
#include "app/compare/chart_report.h"
#include "app/compare/check_chart.h"
#include "app/laboratory/login.h"
#include "app/system/output.h"

namespace abcal {
namespace {

std::string label(const StoredRun& run, const std::string& key) {
  const auto found = run.header.labels.find(key);
  return found == run.header.labels.end() ? std::string() : found->second;
}

/// Charts in use of the item of a run on its bench.
std::vector<std::string> charts_of(lab::Register& opened, const StoredRun& run) {
  const std::string maker = label(run, "item.maker"), model = label(run, "item.model"),
                    serial_number = label(run, "item.serial_number");
  const BenchIdentity bench = bench_of(run);
  std::vector<std::string> charts;
  for (const lab::CheckStandard& standard : opened.check_standards()) {
    if (!standard.retired.empty()) continue;
    const CheckBaseline baseline = baseline_from_json(standard.baseline_json);
    const CheckRun& first = baseline.first();
    if (first.maker == maker && first.model == model && first.serial_number == serial_number &&
        first.bench.stage == bench.stage && first.bench.name == bench.name)
      charts.push_back(standard.name);
  }
  return charts;
}

}  // namespace

void tell_charts(const RunOutcome& outcome) {
  if (outcome.is_levelling() || outcome.stored.state != RunState::kComplete) return;
  const std::string location = lab::register_location({});
  if (location.empty()) return;
  const std::string file = std::filesystem::absolute(outcome.path).string();
  try {
    const Clock::UtcTime now = RealClock().utc_now();
    lab::Register opened = lab::Register::open(location, now);
    const std::vector<std::string> charts = charts_of(opened, outcome.stored);
    for (const std::string& chart : charts)
      print_log("This is a run of check standard {}, whose chart waits for it: {}\n", chart,
                command_to_add(chart, outcome.path.string()));
    if (charts.empty() || outcome.sha256.empty()) return;
    const lab::LoggedIn by = lab::require_login(opened, now);
    for (const std::string& chart : charts)
      opened.tell_check_run(by, {chart, outcome.sha256, file, outcome.stored.header.created_utc, {}, {}},
                            now);
  } catch (const std::exception& error) {
    print_warning(
        fmt::format("the register was not told of {}, in case a chart waits for it: {}", file, error.what()));
  }
}

}  // namespace abcal
