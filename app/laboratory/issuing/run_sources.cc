#include "app/laboratory/issuing/run_sources.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <stdexcept>

#include "app/bench_file/not_real.h"
#include "app/formats/xml_query.h"
#include "app/laboratory/certificate/traceability.h"
#include "app/laboratory/register/login.h"
#include "app/results/analysis/stage_record_use.h"
#include "app/system/real_clock.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_label.h"
#include "protocol/record/sha256.h"
#include "protocol/record/stage_record.h"

namespace abcal {
namespace {

constexpr std::size_t kDateSize = 10;  // "2026-03-01"

/// Whether equipment is the instrument of these serial numbers. An instrument without a serial number may be
/// any.
bool is_instrument(const Equipment& equipment, const std::string& serial_numbers) {
  if (serial_numbers.empty() || equipment.serial_number == serial_numbers) return true;
  const std::vector<std::string> parts = single_serial_numbers(serial_numbers);
  return std::find(parts.begin(), parts.end(), equipment.serial_number) != parts.end();
}

/// For what a run used a piece of equipment; empty: it did not.
std::vector<std::string> roles_of(const StoredRun& run, const Equipment& one) {
  std::vector<std::string> roles;
  if (one.quantity == "angle") {
    if (is_instrument(one, serial_numbers_of(run, "stage"))) roles.emplace_back("angle of the stage");
  } else if (one.quantity == "voltage") {
    const bool in_volts = run.header.response_unit.ends_with("V");
    const std::string voltmeter = serial_numbers_of(run, "accelerometer");
    if ((in_volts || !voltmeter.empty()) && is_instrument(one, voltmeter))
      roles.emplace_back("voltage of the item's output");
  } else if (one.quantity == "gravity") {
    const std::string& source = run.header.g_loc.source;
    if (names_number(source, one.certificate) || names_number(source, one.serial_number))
      roles.emplace_back("local gravity");
  } else if (one.quantity == lab::kStageRecordQuantity) {
    if (one.certificate_sha256 == sha256_of_stage_record(run)) roles.emplace_back(kStageRecordSource);
  } else {
    roles.push_back(one.quantity);
  }
  for (const auto& [effect, source] : run.header.tolerances.sources)
    if (names_number(source, one.certificate)) roles.push_back(effect);
  return roles;
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words)
    if (!word.empty()) text += (text.empty() ? "" : " ") + word;
  return text;
}

std::string items_of(const StoredRun& run) {
  const auto label = [&](const char* key) { return label_of(run.header.labels, key); };
  if (run.header.items.size() < 2)
    return joined({label("item.maker"), label("item.model"), label("item.serial_number")});
  std::string text;
  for (const RunItem& item : run.header.items)
    text += (text.empty() ? "" : "; ") + joined({item.maker, item.model, item.serial_number});
  return text;
}

}  // namespace

std::vector<lab::UsedSource> sources_of(const StoredRun& run, const std::vector<Equipment>& equipment) {
  std::vector<lab::UsedSource> sources;
  for (const Equipment& one : equipment) {
    const std::vector<std::string> roles = roles_of(run, one);
    if (!one.certificate.empty() && !roles.empty())
      sources.push_back({lab::kCalibrationKind, one.certificate, one.serial_number,
                         fmt::format("{}", fmt::join(roles, "; "))});
  }
  return sources;
}

lab::RegisteredRun run_record_of(const std::filesystem::path& path, const std::string& sha256,
                                 const StoredRun& run, const std::vector<Equipment>& equipment) {
  const std::string ended = run.events.empty() ? run.header.created_utc : run.events.back().utc;
  return {sha256, std::filesystem::absolute(path).string(), items_of(run), ended.substr(0, kDateSize),
          sources_of(run, equipment)};
}

std::vector<std::string> tell_register(const EndedRun& run, const std::string& login) {
  const std::string location = lab::register_location({});
  if (location.empty() || run.sha256.empty()) return {};
  try {
    const Clock::UtcTime now = RealClock().utc_now();
    lab::Register opened = lab::Register::open(location, now);
    const lab::LoggedIn by = login.empty() ? lab::require_login(opened, now) : opened.who(login, now);
    (void)opened.tell_run(by, run_record_of(run.path, run.sha256, run.stored, equipment_of_run(run.stored)),
                          now);
    return {};
  } catch (const std::exception& error) {
    return {
        fmt::format("the register was not told what {} rests on: {}; required: `abcal lab add run {}`, or "
                    "its certificate, which tells it",
                    run.path.string(), error.what(), run.path.string())};
  }
}

CertificateFacts certificate_facts(const std::string& name, const std::string& xml) {
  const XmlDocument document = parse_xml(xml, name);
  const XmlQuery certificate(document.get());
  const std::string customer = "dcc:administrativeData/dcc:customer/", at = customer + "dcc:location/";
  CertificateFacts facts;
  facts.addressee.name = certificate.text(customer + "dcc:name/dcc:content");
  std::vector<std::string> lines{
      certificate.text(at + "dcc:street"),
      joined({certificate.text(at + "dcc:postCode"), certificate.text(at + "dcc:city")}),
      certificate.text(at + "dcc:state"), certificate.text(at + "dcc:further/dcc:content")};
  std::erase(lines, std::string());
  facts.addressee.address = fmt::format("{}", fmt::join(lines, ", "));
  facts.addressee.email = certificate.text(customer + "dcc:eMail");
  facts.addressee.language = certificate.text("dcc:administrativeData/dcc:coreData/dcc:usedLangCodeISO639_1");
  facts.run_sha256s = certificate.texts(
      "dcc:measurementResults/dcc:measurementResult/dcc:measurementMetaData/"
      "dcc:metaData[@refType='abc_rawDataHash' or @refType='abc_runHash' or starts-with(@refType, "
      "'abc_seriesPoint')]/dcc:data/dcc:text/dcc:content");
  return facts;
}

ToldRun tell_of_run(lab::Register& opened, const lab::LoggedIn& by, const std::filesystem::path& run,
                    Clock::UtcTime now) {
  if (!RunFile::is_closed(run))
    throw std::invalid_argument(run.string() + ": is not closed; required: a run that has ended");
  const std::string sha256 = sha256_of_file(run);
  const std::vector<IssuedCertificate> kept = ResultsFile::certificates(run);
  ToldRun told;
  lab::RegisteredRun record;
  for (const StoredRun& item : RunFile::load_items(run)) {
    std::vector<Equipment> equipment = equipment_of_run(item);
    // Without a register, the laboratory file of the certificate names the equipment.
    if (equipment.empty() && !kept.empty())
      equipment = parse_laboratory_file(kept.back().laboratory_toml, kept.back().number).file.equipment;
    record = run_record_of(run, sha256, item, equipment);
    told.is_new = opened.tell_run(by, record, now) || told.is_new;
    told.sources = std::max(told.sources, record.sources.size());
  }
  for (const lab::CertificateRecord& known : opened.certificates_of(sha256))
    for (const IssuedCertificate& one : kept) {
      if (one.number != known.number || sha256_of(one.xml) != known.xml_sha256) continue;
      const CertificateFacts facts = certificate_facts(one.number, one.xml);
      told.is_new =
          opened.tell_certificate(by, one.number, facts.addressee, facts.run_sha256s, now) || told.is_new;
      told.certificates.push_back(one.number);
    }
  return told;
}

}  // namespace abcal
