// Commands for the time after a certificate: withdrawal, what rests on a record, letters, status, retention.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <vector>

#include "app/commands/lab.h"
#include "app/document/document_html.h"
#include "app/laboratory/issuing/run_sources.h"
#include "app/laboratory/issuing/withdrawal_letters.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/real_clock.h"
#include "app/system/terminal.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

std::string words_of(const lab::Withdrawal& one) {
  return fmt::format("{} {}: withdrawn on {} by {}: {}", one.kind, one.name, one.date(), one.withdrawn_by,
                     one.reason);
}

std::string customer_of(const lab::AffectedCertificate& one) {
  return one.addressee ? one.addressee->name : "customer not known";
}

Json json_of(const lab::Withdrawal& one) {
  return {{"kind", one.kind},
          {"name", one.name},
          {"date", one.date()},
          {"withdrawn_by", one.withdrawn_by},
          {"reason", one.reason}};
}

Json json_of(const std::string& name, const lab::Affected& affected) {
  Json runs = Json::array(), certificates = Json::array(), withdrawn = Json::array();
  for (const lab::Withdrawal& one : affected.withdrawn) withdrawn.push_back(json_of(one));
  for (const lab::RegisteredRun& run : affected.runs) {
    Json sources = Json::array();
    for (const lab::UsedSource& source : run.sources)
      sources.push_back({{"kind", source.kind},
                         {"name", source.name},
                         {"serial_number", source.serial_number},
                         {"role", source.role}});
    runs.push_back({{"file", run.file},
                    {"sha256", run.run_sha256},
                    {"item", run.item},
                    {"date", run.date},
                    {"sources", sources}});
  }
  for (const lab::AffectedCertificate& one : affected.certificates)
    certificates.push_back({{"number", one.record.number},
                            {"state", one.record.state},
                            {"item", one.record.item},
                            {"date", one.record.issue_date},
                            {"run_sha256", one.record.run_sha256},
                            {"customer", one.addressee ? Json(one.addressee->name) : Json()}});
  return {{"schema", "abcal.register_affected/1"},
          {"name", name},
          {"withdrawn", withdrawn},
          {"runs", runs},
          {"certificates", certificates},
          {"not_known", affected.unknown}};
}

void print_affected(const std::string& name, const lab::Affected& affected) {
  for (const lab::Withdrawal& one : affected.withdrawn) print_result("{}\n", words_of(one));
  print_result("{}: {} run{}, {} certificate{}\n", name, affected.runs.size(),
               affected.runs.size() == 1 ? "" : "s", affected.certificates.size(),
               affected.certificates.size() == 1 ? "" : "s");
  for (const lab::RegisteredRun& run : affected.runs) {
    print_result("run {}, {}: {}\n", run.date, run.item, run.file);
    for (const lab::UsedSource& source : run.sources)
      print_result("  {} {}: {}\n", source.kind, source.name, source.role);
  }
  for (const lab::AffectedCertificate& one : affected.certificates)
    print_result("certificate {}, {}, {}: {}, {}\n", one.record.number, one.record.state,
                 one.record.issue_date, one.record.item, customer_of(one));
  if (affected.unknown.empty()) return;
  print_result(
      "not known for {} certificate{}, whose runs the register was not told of (`abcal lab add run FILE`): "
      "{}\n",
      affected.unknown.size(), affected.unknown.size() == 1 ? "" : "s", fmt::join(affected.unknown, ", "));
}

lab::Affected require_affected(lab::Register& opened, const std::string& name) {
  lab::Affected affected = opened.affected_by(name);
  if (!affected.is_known)
    throw std::invalid_argument(
        fmt::format("{}: is nothing that the register knows; required: the name of a calibration or another "
                    "source, a certificate, or identity or serial number of equipment",
                    name));
  return affected;
}

void add_withdraw(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string kind, name, reason;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "withdraw", "Withdraw a calibration of equipment, a certificate or another record that runs rest on");
  command
      ->add_option("KIND", options->kind,
                   "calibration (right to operate), certificate (right to approve), or the kind of another "
                   "record that a run used (right to operate)")
      ->required();
  command->add_option("NAME", options->name, "its number")->required();
  command->add_option("--reason", options->reason, "why; letters to customers have it")->required();
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    (void)opened.withdraw(lab::require_login(opened, now), options->kind, options->name, options->reason,
                          now);
    const lab::Affected affected = opened.affected_by(options->name);
    print_affected(options->name, affected);
    if (!affected.certificates.empty())
      print_result("letters to the customers, as drafts: abcal lab letters {} -o FOLDER\n", options->name);
    exit_code = kExitDone;
  });
}

void add_affected(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string name;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("affected", "List every run and certificate that rests on a record or equipment");
  command
      ->add_option("NAME", options->name,
                   "number of a calibration or certificate, or identity or serial number of equipment")
      ->required();
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const lab::Affected affected = require_affected(opened, options->name);
    if (options->json)
      print_result("{}\n", json_of(options->name, affected).dump(2));
    else
      print_affected(options->name, affected);
    exit_code = kExitDone;
  });
}

void add_letters(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string name, folder;
    bool force = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "letters", "Write drafts of letters about a withdrawal, one a customer; nothing is sent");
  command->add_option("NAME", options->name, "what was withdrawn")->required();
  command->add_option("-o,--output", options->folder, "folder for the letters (HTML)")->required();
  command->add_flag("--force", options->force, "overwrite files that exist");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const WithdrawalLetters drafts =
        withdrawal_letters(require_affected(opened, options->name), opened.facts().name,
                           format_utc(RealClock().utc_now()).substr(0, 10));
    const std::filesystem::path folder = options->folder;
    std::filesystem::create_directories(folder);
    std::vector<RequestedOutput> outputs;
    for (const Letter& letter : drafts.letters) outputs.push_back({"--output", folder / letter.file_name});
    require_writable(outputs, {}, options->force);
    for (const Letter& letter : drafts.letters) {
      OutputFile(folder / letter.file_name).write(document_html(letter.document));
      print_result("draft for {}: {}\n", letter.customer, (folder / letter.file_name).string());
    }
    print_result("{} draft{} written; nothing was sent\n", drafts.letters.size(),
                 drafts.letters.size() == 1 ? "" : "s");
    if (!drafts.without_customer.empty())
      print_warning(
          fmt::format("no letter for {}: the register was not told to whom they were issued; required: "
                      "`abcal lab add run FILE` with their runs",
                      fmt::join(drafts.without_customer, ", ")));
    exit_code = drafts.without_customer.empty() ? kExitDone : kExitFailed;
  });
}

void add_status(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string number;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("status", "Say whether a certificate is valid, amended or withdrawn");
  command->add_option("NUMBER", options->number, "of the certificate")->required();
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto status = opened.status_of(options->number);
    if (!status)
      throw std::invalid_argument(fmt::format(
          "certificate {}: the register of {} did not give this number; required: a number that it gave",
          options->number, opened.facts().name));
    if (options->json) {
      Json sources = Json::array();
      for (const lab::Withdrawal& one : status->sources_withdrawn) sources.push_back(json_of(one));
      print_result("{}\n", Json{{"schema", "abcal.register_status/1"},
                                {"number", options->number},
                                {"status", status->word()},
                                {"holds", status->holds()},
                                {"training", status->training},
                                {"item", status->record.item},
                                {"date", status->record.issue_date},
                                {"amended_by", status->amended_by},
                                {"withdrawn", status->withdrawn ? json_of(*status->withdrawn) : Json()},
                                {"sources_withdrawn", sources},
                                {"words", status->words()}}
                               .dump(2));
    } else {
      print_result("{}\n", emphasised(stdout, status->holds() ? Emphasis::kGood : Emphasis::kBad,
                                      fmt::format("certificate {}: {}", options->number, status->words())));
      print_result("{}\n", status->record.item);
    }
    exit_code = status->holds() ? kExitDone : kExitFailed;
  });
}

void add_retention(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto as_json = std::make_shared<bool>(false);
  CLI::App* command = parent.add_subcommand(
      "retention", "List the rules for keeping records, and the records whose time has passed");
  command->add_flag("--json", *as_json, "print one JSON object");
  command->callback([shared, as_json, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto rules = opened.retention();
    const auto past = opened.past_retention(RealClock().utc_now());
    exit_code = kExitDone;
    if (*as_json) {
      Json listed = Json::array(), records = Json::array();
      for (const lab::RetentionRule& rule : rules)
        listed.push_back({{"kind", rule.kind}, {"years", rule.years}, {"set_by", rule.set_by}});
      for (const lab::RetainedRecord& one : past)
        records.push_back(
            {{"kind", one.kind}, {"name", one.name}, {"since", one.since}, {"until", one.until}});
      print_result(
          "{}\n",
          Json{{"schema", "abcal.register_retention/1"}, {"rules", listed}, {"past", records}}.dump(2));
      return;
    }
    for (const lab::RetentionRule& rule : rules)
      print_result("{}: {} years, set by {} on {}\n", rule.kind, rule.years, rule.set_by,
                   rule.utc.substr(0, 10));
    print_result("audit: without end; each entry proves those after it\n");
    if (rules.empty()) print_result("no rule is set: `abcal lab add retention KIND --years N`\n");
    for (const lab::RetainedRecord& one : past)
      print_result("past: {} {}, kept since {}, required until {}\n", one.kind, one.name, one.since,
                   one.until);
    print_result("{} record{} past {}; nothing was deleted\n", past.size(), past.size() == 1 ? "" : "s",
                 past.size() == 1 ? "its time" : "their time");
  });
}

void add_add_retention(CLI::App& add, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string kind;
    int years = 0;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = add.add_subcommand("retention", "Set for how many years records of a kind are kept");
  command->add_option("KIND", options->kind, "certificate, run or calibration")->required();
  command->add_option("--years", options->years, "1 to 100")->required();
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    opened.set_retention(lab::require_login(opened, now), options->kind, options->years, now);
    print_result("retention of {}: {} years\n", options->kind, options->years);
    exit_code = kExitDone;
  });
}

void add_add_run(CLI::App& add, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto files = std::make_shared<std::vector<std::string>>();
  CLI::App* command = add.add_subcommand("run",
                                         "Tell the register what a run rests on, and of its certificates; a "
                                         "run that ends with a register tells it by itself");
  command->add_option("FILE", *files, "run files")->required();
  command->callback([shared, files, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    const lab::LoggedIn by = lab::require_login(opened, now);
    for (const std::string& file : *files) {
      const ToldRun told = tell_of_run(opened, by, file, now);
      print_result(
          "{}: {}, rests on {} record{}; certificates: {}\n", file, told.is_new ? "added" : "known already",
          told.sources, told.sources == 1 ? "" : "s",
          told.certificates.empty() ? "none" : fmt::format("{}", fmt::join(told.certificates, ", ")));
    }
    exit_code = kExitDone;
  });
}

}  // namespace

void add_lab_withdraw(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  CLI::App* add = parent.get_subcommand("add");
  add_add_retention(*add, shared, exit_code);
  add_add_run(*add, shared, exit_code);
  add_withdraw(parent, shared, exit_code);
  add_affected(parent, shared, exit_code);
  add_letters(parent, shared, exit_code);
  add_status(parent, shared, exit_code);
  add_retention(parent, shared, exit_code);
}

}  // namespace abcal
