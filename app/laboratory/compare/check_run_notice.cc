#include "app/laboratory/compare/check_run_notice.h"

#include <fmt/format.h>

#include <exception>

#include "app/laboratory/compare/chart_report.h"
#include "app/laboratory/compare/check_chart.h"
#include "app/laboratory/register/login.h"
#include "app/results/analysis/load_record.h"
#include "app/system/real_clock.h"

namespace abcal {
namespace {

/// Charts in use of the item of a run on its bench.
std::vector<std::string> charts_of(lab::Register& opened, const StoredRun& run) {
  const ChartSubject subject = subject_of(run);
  std::vector<std::string> charts;
  for (const lab::CheckStandard& standard : opened.check_standards()) {
    if (!standard.retired.empty()) continue;
    if (differences(baseline_from_json(standard.baseline_json).first(), subject).empty())
      charts.push_back(standard.name);
  }
  return charts;
}

}  // namespace

std::vector<std::string> check_run_notices(const EndedRun& run, const std::string& login) {
  std::vector<std::string> notices;
  const std::string location = lab::register_location({});
  if (location.empty()) return notices;
  const std::string file = name_of_item(std::filesystem::absolute(run.path).string(), run.stored);
  try {
    const Clock::UtcTime now = RealClock().utc_now();
    lab::Register opened = lab::Register::open(location, now);
    const std::vector<std::string> charts = charts_of(opened, run.stored);
    for (const std::string& chart : charts)
      notices.push_back(fmt::format("This is a run of check standard {}, whose chart waits for it: {}", chart,
                                    command_to_add(chart, name_of_item(run.path.string(), run.stored))));
    if (charts.empty() || run.sha256.empty()) return notices;
    const lab::LoggedIn by = login.empty() ? lab::require_login(opened, now) : opened.who(login, now);
    for (const std::string& chart : charts)
      opened.tell_check_run(by, {chart, run.sha256, file, run.stored.header.created_utc, {}, {}}, now);
  } catch (const std::exception& error) {
    notices.push_back(
        fmt::format("the register was not told of {}, in case a chart waits for it: {}", file, error.what()));
  }
  return notices;
}

}  // namespace abcal
