#include "app/certificate/report_certificate.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>

#include "app/certificate/issue.h"
#include "app/results/load_record.h"
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

ReportData gather_as_found(const std::filesystem::path& path, const ReportData& as_left, Clock::UtcTime now) {
  const auto count = static_cast<int>(items_of_file(path));
  for (int item = 1; item <= count; ++item) {
    if (count == 1) return gather_report(path, now);
    const LoadedRecord loaded = load_record(path, item);
    const std::map<std::string, std::string>& labels = loaded.run->header.labels;
    const bool is_same =
        std::ranges::all_of(std::array{"item.maker", "item.model", "item.serial_number"},
                            [&](const char* key) { return label_of(labels, key) == as_left.label(key); });
    if (is_same) return gather_report(path, now, item);
  }
  throw std::invalid_argument(fmt::format(
      "--as-found {}: none of its {} items is {} {}, serial number {}; required: a run of the same "
      "item before it was adjusted",
      path.string(), count, as_left.label("item.maker"), as_left.label("item.model"),
      as_left.label("item.serial_number")));
}

std::vector<ReportData> gather_series(const std::vector<std::string>& paths, Clock::UtcTime now) {
  std::vector<ReportData> points;
  points.reserve(paths.size());
  for (const std::string& path : paths) points.push_back(gather_report(path, now, chosen_item(path, 0)));
  return points;
}

std::string certificate_for_report(const ReportData& data, const CertificateFiles& files, bool draft,
                                   Clock::UtcTime now) {
  std::optional<ReportData> as_found;
  if (!files.as_found.empty()) as_found = gather_as_found(files.as_found, data, now);
  std::vector<ReportData> series = gather_series(files.temperature, now);
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
  request.series = std::move(series);
  request.draft = draft;
  return checked_xml(make_certificate(std::move(request)), &schema);
}

}  // namespace abcal
