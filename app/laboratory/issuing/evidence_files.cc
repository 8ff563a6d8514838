#include "app/laboratory/issuing/evidence_files.h"

#include <fmt/format.h>

#include <filesystem>
#include <optional>
#include <regex>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "app/formats/xml_query.h"
#include "app/laboratory/certificate/registered_entry.h"
#include "app/results/analysis/other_file.h"
#include "app/system/read_file.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr const char* kResults = ".results";

/// "17:0123...": as printed on a certificate.
std::optional<lab::RegisterEvidence> evidence_of_line(const std::string& text) {
  static const std::regex kForm("([1-9][0-9]{0,17}):([0-9a-f]{32,64})");
  std::smatch parts;
  if (!std::regex_match(text, parts, kForm)) return std::nullopt;
  lab::RegisterEvidence evidence;
  evidence.name = "line of a page";
  evidence.head = lab::AuditHead{std::stoll(parts[1]), parts[2]};
  return evidence;
}

/// The certificates of a run, given it or its results.
std::vector<lab::RegisterEvidence> evidence_of_run(const std::string& file) {
  const std::string run =
      file.ends_with(kResults) ? file.substr(0, file.size() - std::string_view(kResults).size()) : file;
  std::vector<lab::RegisterEvidence> all;
  for (const IssuedCertificate& one : ResultsFile::certificates(run))
    all.push_back(evidence_of_certificate(file + ", certificate " + one.number, one.xml));
  if (all.empty())
    throw std::invalid_argument(
        fmt::format("--against {}: has no certificate; required: at least one", file));
  return all;
}

}  // namespace

lab::RegisterEvidence evidence_of_certificate(const std::string& name, const std::string& xml) {
  const XmlDocument document = parse_xml(xml, name);
  const XmlQuery certificate(document.get());
  lab::NamedCertificate named;
  named.number = certificate.text("dcc:administrativeData/dcc:coreData/dcc:uniqueIdentifier");
  named.xml_sha256 = sha256_of(xml);
  // As found, then as left: the certificate is of the last run.
  const std::vector<std::string> runs = certificate.texts(
      "dcc:measurementResults/dcc:measurementResult[not(@refType='abc_temperatureSeries')]/"
      "dcc:measurementMetaData/dcc:metaData[@refType='abc_rawDataHash']/dcc:data/dcc:text/dcc:content");
  if (certificate.nodes("/dcc:digitalCalibrationCertificate").empty() || named.number.empty() || runs.empty())
    throw std::invalid_argument(
        name + ": XML, but not a certificate of abcal; required: one with number and hash of its run");
  if (certificate.any("dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_draft']"))
    throw std::invalid_argument(name + ": a draft, which no register knows; required: an issued certificate");
  named.run_sha256 = runs.back();
  lab::RegisterEvidence evidence;
  evidence.name = name;
  if (const auto registered = registered_entry_of(certificate)) {
    evidence.register_identity = registered->register_identity;
    evidence.head = lab::AuditHead{registered->entry, registered->sha256};
  }
  evidence.certificate = std::move(named);
  return evidence;
}

std::vector<lab::RegisterEvidence> read_evidence(const std::string& file) {
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored))
    if (auto line = evidence_of_line(file)) return {*std::move(line)};
  if (RunFile::looks_like_run_file(file)) return evidence_of_run(file);
  if (looks_like_xml(file)) return {evidence_of_certificate(file, read_file(file, kLargestXml))};
  const std::string text = read_file(file);
  if (text.starts_with('{')) return {lab::evidence_of_backup(file, text)};
  throw std::invalid_argument(fmt::format(
      "--against {}: is no evidence of a register; required: a backup (`abcal lab backup`), a certificate "
      "(XML; a PDF has it attached), a run with certificates, or ENTRY:DIGITS of a printed certificate",
      file));
}

}  // namespace abcal
