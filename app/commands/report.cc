#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/commands/certificate_options.h"
#include "app/commands/commands.h"
#include "app/commands/print_pdf.h"
#include "app/commands/table_options.h"
#include "app/document/document_html.h"
#include "app/document/document_text.h"
#include "app/document/weasyprint.h"
#include "app/document/write_pdf.h"
#include "app/laboratory/certificate/certificate_json.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/report_data.h"
#include "app/results/report/calibration_document.h"
#include "app/results/report/hdf5_export.h"
#include "app/results/report/record_csv.h"
#include "app/results/report/report_json.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/real_clock.h"
#include "app/system/temporary_folder.h"

namespace abcal {
namespace {

struct ReportOptions {
  std::string file;
  std::string html, pdf, csv, csv_raw, hdf5;
  std::string attachment, dcc;
  CertificateFiles certificate;
  TableOptions table;
  int item = 0;
  bool draft = false, record = false, json = false, force = false;
};

/// A requested file, and the function that writes it.
struct Output {
  RequestedOutput requested;
  std::function<void(OutputFile& file)> write;
};

/// The pages of a report or a certificate.
struct Pages {
  Document document;
  std::string certificate_xml;    ///< Empty: they are those of a report.
  PdfPrinter* printer = nullptr;  ///< Prints a certificate.
  std::string suffix;             ///< Ends its files' names: "-item-2", of several; empty: the only ones.
};

/// The PDF of a certificate contains its XML, unless another attachment is requested.
void write_pages(const Pages& pages, OutputFile& file, const std::string& attached) {
  const TemporaryFolder folder;
  std::optional<Attachment> attachment;
  if (!attached.empty()) {
    attachment = {attached, AttachmentKind::kSupplement};
  } else if (!pages.certificate_xml.empty()) {
    attachment = {folder / "certificate.xml", AttachmentKind::kData};
    OutputFile(attachment->file).write(pages.certificate_xml);
  }
  if (pages.printer != nullptr) {
    print_pdf(*pages.printer, document_html(pages.document), file.temporary(), attachment);
  } else {
    write_pdf(pages.document, file.temporary(), attachment);
  }
  file.commit();
}

/// Whether the report is that of a certificate: one is requested, or was issued for this run.
bool of_certificate(const ReportOptions& options, const ReportData& data) {
  if (options.record) return false;
  if (options.draft || !options.dcc.empty() || !options.certificate.laboratory.empty()) return true;
  const bool unchanged = data.run && std::all_of(data.integrity.begin(), data.integrity.end(),
                                                 [](const IntegrityCheck& check) { return check.good; });
  return unchanged && current_certificate(data.path, data.item);
}

/// The readings of one run.
struct RunReadings {
  std::string suffix;  ///< Ends its files' names: "-2", the second run of a measurement; empty: the only one.
  std::vector<ReportData> items;
};

/// @param items  of the file; of a measurement its own result
/// @param item   the one whose readings are wanted, from 1; 0: all
std::vector<RunReadings> readings_of(const std::vector<ReportData>& items, int item, Clock::UtcTime now) {
  const ReportData& data = items.front();
  if (!data.is_of_several_runs()) return {{"", items}};
  std::vector<RunReadings> out;
  for (const RunOfMeasurement& run : data.all->runs) {
    const int number =
        item == 0 ? 0 : run.items.at(static_cast<std::size_t>(item) - 1).item;  // Runs may order them anew.
    out.push_back({fmt::format("-{}", out.size() + 1), gather_items(run.file, now, number)});
  }
  return out;
}

std::string with_suffix(const std::filesystem::path& path, const std::string& suffix) {
  std::filesystem::path out = path.parent_path() / path.stem();
  out += suffix;
  out += path.extension();
  return out.string();
}

/// The requested outputs.
std::vector<Output> outputs_of(const ReportOptions& options, const std::vector<RunReadings>& runs,
                               const std::vector<Pages>& pages_of_items) {
  std::vector<Output> outputs;
  const auto add = [&](const char* option, const std::string& path, std::function<void(OutputFile&)> write) {
    if (!path.empty()) outputs.push_back({{option, path}, std::move(write)});
  };
  const auto named = [](const std::string& path, const std::string& suffix) {
    return path.empty() ? path : with_suffix(path, suffix);
  };
  for (const Pages& pages : pages_of_items) {
    add("--html", named(options.html, pages.suffix),
        [&pages](OutputFile& file) { file.write(document_html(pages.document)); });
    add("--pdf", named(options.pdf, pages.suffix),
        [&pages, &options](OutputFile& file) { write_pages(pages, file, options.attachment); });
    add("--dcc", options.dcc, [&pages](OutputFile& file) { file.write(pages.certificate_xml); });
  }
  const auto add_of_run = [&](const char* option, const std::string& path, const RunReadings& run,
                              std::function<void(OutputFile&)> write) {
    add(option, named(path, run.suffix), std::move(write));
  };
  for (const RunReadings& run : runs) {
    const std::vector<ReportData>& items = run.items;
    add_of_run("--csv", options.csv, run, [&items](OutputFile& file) { file.write(averaged_csv(items)); });
    add_of_run("--csv-raw", options.csv_raw, run, [&items](OutputFile& file) {
      write_raw_csv(items, file.temporary());
      file.commit();
    });
    add_of_run("--hdf5", options.hdf5, run, [&items](OutputFile& file) {
      export_hdf5(items, file.temporary(), file.path().filename().string());
      file.commit();
    });
  }
  return outputs;
}

/// @param json  standard output belongs to the JSON object
void write_all(const std::vector<Output>& outputs, bool json) {
  for (const Output& output : outputs) {
    OutputFile file(output.requested.path);
    output.write(file);
    const std::string text = fmt::format("{} written: {}\n", output.requested.option.substr(2),
                                         std::filesystem::absolute(output.requested.path).string());
    json ? print_log("{}", text) : print_result("{}", text);
  }
}

/// Reports all foreseeable errors before the first file is written.
void check(const ReportOptions& options, const ReportData& data, const std::vector<Output>& outputs) {
  std::vector<RequestedOutput> requested;
  for (const Output& output : outputs) requested.push_back(output.requested);
  std::vector<std::filesystem::path> inputs{data.path};
  if (data.run) inputs.push_back(ResultsFile::path_beside(data.path));
  for (const std::string& input :
       {options.attachment, options.certificate.laboratory, options.certificate.as_found})
    if (!input.empty()) inputs.emplace_back(input);
  inputs.insert(inputs.end(), options.certificate.temperature.begin(), options.certificate.temperature.end());
  require_writable(requested, inputs, options.force);
  if (!options.attachment.empty() && !std::filesystem::is_regular_file(options.attachment))
    throw std::invalid_argument(fmt::format("--attach {}: no such file", options.attachment));
  if (!options.csv_raw.empty() && !data.run) {
    throw std::invalid_argument(
        fmt::format("--csv-raw: {} is a table and has no single readings beside its own", options.file));
  }
}

bool wants_readings(const ReportOptions& options) {
  return !options.csv.empty() || !options.csv_raw.empty() || !options.hdf5.empty();
}

/// Whether only files are wanted that hold all items, or of which each item can have its own. Everything else
/// is of one item.
bool may_have_all_items(const ReportOptions& options) {
  const bool wants_one = options.json || options.draft || options.record || !options.dcc.empty() ||
                         !options.attachment.empty() || !options.certificate.laboratory.empty();
  return !wants_one && (wants_readings(options) || !options.html.empty() || !options.pdf.empty());
}

}  // namespace

CLI::App* add_report(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<ReportOptions>();
  CLI::App* command =
      parent.add_subcommand("report", "The report of a run or table, for people and programs");
  command->add_option("RUN", options->file, "run file, measurement, or table of readings")->required();
  command->add_option(
      "--item", options->item,
      "of a run with several items: whose report, from 1 (default: --csv, --csv-raw and --hdf5 hold all "
      "items, and --html and --pdf are written for each: FILE-item-1.html, ...)");
  add_table_options(*command, options->table);
  command->add_option("--html", options->html, "write the report as one HTML page with figures");
  CLI::Option* pdf =
      command->add_option("--pdf", options->pdf, "write the report as PDF (a certificate: by WeasyPrint)");
  command->add_option("--attach", options->attachment, "file to attach to the PDF")->needs(pdf);
  command->add_option("--csv", options->csv,
                      "write the averaged readings as CSV, which `abcal analyse` reads; of a measurement one "
                      "file for each run: FILE-1.csv, ... (--csv-raw and --hdf5 likewise)");
  command->add_option("--csv-raw", options->csv_raw, "write the single readings as CSV");
  command->add_option("--hdf5", options->hdf5, "write readings and results as HDF5 with NeXus conventions");
  command->add_option("--dcc", options->dcc,
                      "write the digital calibration certificate (XML, DCC 3.3.0): the one that was issued, "
                      "or a draft; docs/certificate.md");
  add_certificate_options(*command, options->certificate);
  command->add_flag("--draft", options->draft,
                    "make a draft of the certificate even if the run or its equipment has problems");
  CLI::Option* record = command->add_flag(
      "--record", options->record,
      "the laboratory's own record of the run, with figures, also where there is a certificate");
  for (const char* of_certificate : {"--dcc", "--draft"})
    record->excludes(command->get_option(of_certificate));
  command->add_flag("--json", options->json, "print one JSON object, schema abcal.report/1");
  command->add_flag("--force", options->force, "overwrite files that exist");
  command->callback([options, &exit_code] {
    const int item = may_have_all_items(*options) ? options->item : chosen_item(options->file, options->item);
    const std::vector<ReportData> items =
        gather_items(options->file, RealClock().utc_now(), item, options->table);
    const ReportData& data = items.front();
    say_how_read(options->file, data.record);
    std::vector<Pages> pages_of_items;
    std::optional<PdfPrinter> printer;
    const bool wants_all = may_have_all_items(*options) && !(options->html.empty() && options->pdf.empty());
    for (const ReportData& each : items) {
      if (!wants_all && !pages_of_items.empty()) break;
      Pages& pages = pages_of_items.emplace_back();
      if (wants_all && items.size() > 1) pages.suffix = fmt::format("-item-{}", each.item);
      if (of_certificate(*options, each)) {
        if (!options->pdf.empty()) pages.printer = printer ? &*printer : &printer.emplace();
        pages.certificate_xml =
            certificate_for_report(each, options->certificate, options->draft, RealClock().utc_now());
        pages.document = certificate_page(pages.certificate_xml);
      } else {
        pages.document = calibration_document(each);
      }
    }
    const std::vector<RunReadings> runs = wants_readings(*options)
                                              ? readings_of(items, item, RealClock().utc_now())
                                              : std::vector<RunReadings>();
    const std::vector<Output> outputs = outputs_of(*options, runs, pages_of_items);
    check(*options, data, outputs);
    write_all(outputs, options->json);
    if (options->json) {
      nlohmann::ordered_json json = report_json(data);
      const Pages& pages = pages_of_items.front();
      if (!pages.certificate_xml.empty()) json["certificate"] = certificate_json(pages.certificate_xml);
      print_result("{}\n", json.dump(2));
    } else if (outputs.empty()) {
      print_result("{}", document_text(pages_of_items.front().document, stdout));
    }
    for (const Pages& pages : outputs.empty() ? std::vector<Pages>() : pages_of_items)
      for (const std::string& caution : pages.document.cautions)
        print_log("caution: {}{}\n", pages.suffix.empty() ? "" : pages.suffix.substr(1) + ": ", caution);
    const bool has_numbers = std::ranges::any_of(
        items, [](const ReportData& each) { return each.result().verdict != Verdict::kNotUsable; });
    exit_code = has_numbers ? kExitDone : kExitFailed;
  });
  return command;
}

}  // namespace abcal
