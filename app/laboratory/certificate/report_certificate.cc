#include "app/laboratory/certificate/report_certificate.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>

#include "app/laboratory/certificate/issue_certificate.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "protocol/record/run_label.h"

namespace abcal {
namespace {

void require_consistent(const ReportData& data) {
  std::vector<Problem> problems;
  for (const IntegrityCheck& check : data.integrity)
    if (!check.good) problems.push_back({check.what, check.found, "consistent with what was stored"});
  if (!problems.empty()) throw CertificateRefused(data.path.string(), std::move(problems));
}

/// The page of a certificate must not show a calibration that its XML does not contain.
void require_issued_with(const IssuedCertificate& issued, const ReportData& with, const char* option) {
  if (with.sha256 && issued.xml.find(*with.sha256) != std::string::npos) return;
  throw CertificateRefused(issued.number,
                           {{option, with.path.string() + ", whose results are not part of this certificate",
                             "a run of the certificate"}});
}

}  // namespace

DccSchema schema_of(const CertificateFiles& files) {
  return DccSchema(files.schemas.empty() ? program_schemas() : std::filesystem::path(files.schemas));
}

ReportData gather_same_item(const char* option, const std::filesystem::path& path, const ReportData& of,
                            Clock::UtcTime now) {
  const auto count = static_cast<int>(items_of_file(path));
  if (count == 1) return gather_report(path, now, 1);  // Another item is refused later, with all reasons.
  for (int item = 1; item <= count; ++item) {
    const std::map<std::string, std::string> labels =
        RunFile::load(runs_of_file(path.string()).front(), item).header.labels;
    const bool is_same =
        std::ranges::all_of(std::array{"item.maker", "item.model", "item.serial_number"},
                            [&](const char* key) { return label_of(labels, key) == of.label(key); });
    if (is_same) return gather_report(path, now, item);
  }
  throw std::invalid_argument(fmt::format(
      "{} {}: none of its {} items is {} {}, serial number {}; required: a run of the same item", option,
      path.string(), count, of.label("item.maker"), of.label("item.model"), of.label("item.serial_number")));
}

std::vector<ReportData> gather_series(const std::vector<std::string>& paths, const ReportData& of,
                                      Clock::UtcTime now) {
  std::vector<ReportData> points;
  points.reserve(paths.size());
  for (const std::string& path : paths) points.push_back(gather_same_item("--temperature", path, of, now));
  return points;
}

std::vector<ReportData> gather_runs(const ReportData& data, Clock::UtcTime now) {
  std::vector<ReportData> runs;
  for (const RunOfMeasurement& run : data.all->runs)
    runs.push_back(gather_report(run.file, now, run.items.at(static_cast<std::size_t>(data.item) - 1).item));
  return runs;
}

void gather_runs(CertificateRequest& request, Clock::UtcTime now) {
  request.together = gather_runs(request.run, now);
  if (request.as_found) request.together_as_found = gather_runs(*request.as_found, now);
}

std::string certificate_for_report(const ReportData& data, const CertificateFiles& files, bool draft,
                                   Clock::UtcTime now) {
  std::optional<ReportData> as_found;
  if (!files.as_found.empty()) as_found = gather_same_item("--as-found", files.as_found, data, now);
  std::vector<ReportData> series = gather_series(files.temperature, data, now);
  if (data.run && !draft) {
    if (auto issued = current_certificate(data.path, data.item)) {
      require_consistent(data);
      if (as_found) require_issued_with(*issued, *as_found, "--as-found");
      for (const ReportData& point : series) require_issued_with(*issued, point, "--temperature");
      return std::move(issued->xml);
    }
  }
  if (files.laboratory.empty())
    throw std::invalid_argument(
        "a certificate needs --laboratory LAB.toml (docs/examples/laboratory.toml is one)");
  const DccSchema schema = schema_of(files);
  CertificateRequest request;
  request.laboratory = read_laboratory_file(files.laboratory);
  if (!files.language.empty()) request.laboratory.file.language = files.language;
  request.run = data;
  request.as_found = std::move(as_found);
  add_monte_carlo(request);
  gather_runs(request, now);
  request.series = std::move(series);
  request.draft = draft;
  return checked_xml(make_certificate(std::move(request)), &schema);
}

}  // namespace abcal
