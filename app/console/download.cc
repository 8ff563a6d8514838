#include "app/console/download.h"

#include <fstream>
#include <stdexcept>

#include "app/console/workshop.h"
#include "app/document/document_html.h"
#include "app/document/weasyprint.h"
#include "app/document/write_pdf.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/certificate/report_certificate.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/report_data.h"
#include "app/results/report/calibration_document.h"
#include "app/results/report/hdf5_export.h"
#include "app/results/report/record_csv.h"
#include "app/system/child_process.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"
#include "app/system/temporary_folder.h"

namespace abcal::console {
namespace {

using Path = std::filesystem::path;

std::vector<ReportData> data_of(const ItemOfRun& of) {
  return gather_items(of.run, RealClock().utc_now(), of.item);
}

/// The bytes that `write` puts into a file.
std::string bytes_of(const std::function<void(const Path& file)>& write) {
  const TemporaryFolder folder;
  const Path file = folder / "download";
  write(file);
  return read_file(file);
}

bool is_certified(const ItemOfRun& of) {
  return current_certificate(of.run, of.item).has_value();
}

/// The readings of several runs are no single file.
bool is_one_run(const ItemOfRun& of) {
  return !looks_like_measurement(of.run);
}

/// The certificate as it was issued, byte for byte; a download never issues one.
std::string certificate(const ItemOfRun& of, const std::stop_token&) {
  const auto issued = current_certificate(of.run, of.item);
  if (!issued) throw std::runtime_error("no certificate has been issued for this run; see `abcal issue`");
  return issued->xml;
}

/// The document that `abcal report` shows of a run: its certificate if one was issued.
struct Shown {
  Document document;
  std::string certificate_xml;  ///< Empty: no certificate.
};

Shown shown(const ItemOfRun& of, const std::stop_token& cancelled) {
  const ReportData data = gather_report(of.run, RealClock().utc_now(), of.item);
  require_wanted(cancelled);
  if (!is_certified(of)) return {calibration_document(data), {}};
  std::string xml = certificate_for_report(data, {}, /*draft=*/false, RealClock().utc_now());
  return {certificate_page(xml), std::move(xml)};
}

std::string report(const ItemOfRun& of, const std::stop_token& cancelled) {
  return document_html(shown(of, cancelled).document);
}

std::string printed_report(const ItemOfRun& of, const std::stop_token& cancelled) {
  return bytes_of([&](const Path& file) {
    const Shown page = shown(of, cancelled);
    require_wanted(cancelled);
    const auto is_cancelled = [&cancelled] { return cancelled.stop_requested(); };
    if (page.certificate_xml.empty()) return write_pdf(page.document, file, std::nullopt, is_cancelled);
    PdfPrinter printer;
    const TemporaryFolder folder;
    const Path attachment = folder / "certificate.xml";
    std::ofstream(attachment, std::ios::binary) << page.certificate_xml;
    printer.print(document_html(page.document), file, Attachment{attachment, AttachmentKind::kData},
                  is_cancelled);
  });
}

std::string averaged_readings(const ItemOfRun& of, const std::stop_token&) {
  return averaged_csv(data_of(of));
}

std::string single_readings(const ItemOfRun& of, const std::stop_token&) {
  return bytes_of([&](const Path& file) { write_raw_csv(data_of(of), file); });
}

std::string hdf5(const ItemOfRun& of, const std::stop_token&) {
  return bytes_of([&](const Path& file) { export_hdf5(data_of(of), file, of.run.stem().string() + ".h5"); });
}

}  // namespace

const std::vector<Download>& downloads() {
  static const std::vector<Download> all{
      {"report.html", "Report (HTML)", "text/html; charset=utf-8", report, nullptr},
      {"report.pdf", "Report (PDF)", "application/pdf", printed_report,
       [](const ItemOfRun& of) { return !is_certified(of) || is_installed(kWeasyPrint); }, true},
      {"certificate.xml", "Certificate (DCC XML)", "application/xml", certificate, is_certified},
      {"readings.csv", "Averaged readings (CSV)", "text/csv; charset=utf-8", averaged_readings, is_one_run},
      {"single-readings.csv", "Single readings (CSV)", "text/csv; charset=utf-8", single_readings,
       is_one_run},
      {"run.h5", "Everything (HDF5)", "application/x-hdf5", hdf5, is_one_run},
  };
  return all;
}

}  // namespace abcal::console
