#include "app/console/download.h"

#include <fmt/format.h>

#include <stdexcept>

#include "app/certificate/issue.h"
#include "protocol/record/run_file.h"

namespace abcal::console {
namespace {

/// As `abcal analyse` reads them. What was not measured is left empty.
std::string averaged_readings(const std::filesystem::path& path) {
  const StoredRun run = RunFile::load(path);
  std::string text = "experiment,n,alpha_deg,r_u,r_v,r_w,u_u,u_v,u_w,time_s,count,temperature_degc\n";
  const auto digits = [](double value) { return fmt::format("{:.17g}", value); };
  const auto cell = [&](const std::optional<double>& value) { return value ? digits(*value) : ""; };
  for (const DwellRecord& dwell : run.record.dwells) {
    if (dwell.closing) continue;
    text += fmt::format("{},{},{}", dwell.experiment, dwell.n, digits(dwell.alpha.deg()));
    for (int j = 0; j < 3; ++j) text += "," + digits(dwell.mean[j]);
    for (int j = 0; j < 3; ++j) text += "," + (dwell.u_mean ? digits((*dwell.u_mean)[j]) : "");
    text += fmt::format(",{},{},{}\n", cell(dwell.time_s), dwell.count, cell(dwell.temperature_degc));
  }
  return text;
}

/// As it was issued, byte for byte. Issuing is not for a page: `abcal issue`.
std::string certificate(const std::filesystem::path& path) {
  const auto issued = current_certificate(path);
  if (!issued) throw std::runtime_error("no certificate has been issued for this run; see `abcal issue`");
  return issued->xml;
}

bool is_certified(const std::filesystem::path& path) {
  return current_certificate(path).has_value();
}

}  // namespace

const std::vector<Download>& downloads() {
  static const std::vector<Download> all{
      {"readings.csv", "Averaged readings (CSV)", "text/csv; charset=utf-8", averaged_readings, nullptr},
      {"certificate.xml", "Certificate (DCC XML)", "application/xml", certificate, is_certified},
  };
  return all;
}

}  // namespace abcal::console
