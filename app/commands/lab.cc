#include "app/commands/lab.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "app/commands/commands.h"
#include "app/laboratory/issuing/evidence_files.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/secret_input.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

struct InitOptions {
  std::string laboratory, administrator, prefix = "EX-", password_file;
  bool training = false;
};

void init(const LabOptions& shared, const InitOptions& options) {
  const std::string location = lab::register_location(shared.location);
  if (location.empty())
    throw std::invalid_argument(
        "--register is missing: a file to be made, or postgresql://USER@HOST/DATABASE");
  lab::NewRegister facts;
  facts.laboratory = options.laboratory;
  facts.training = options.training;
  facts.number_prefix = options.prefix;
  facts.administrator = options.administrator;
  facts.password =
      read_new_secret("password of " + options.administrator, lab::password_rule(), options.password_file);
  const lab::Register made = lab::Register::create(location, facts, RealClock().utc_now());
  print_result("register of {} made: {}; its administrator is {}\n", made.facts().name,
               lab::without_password(location), options.administrator);
  if (made.facts().training)
    print_result("TRAINING: its certificates have numbers {}..., are marked TRAINING, and certify nothing\n",
                 made.facts().number_prefix);
}

void add_init(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto options = std::make_shared<InitOptions>();
  CLI::App* command = parent.add_subcommand("init", "Make a register");
  command->add_option("--laboratory", options->laboratory, "name of the laboratory")->required();
  command
      ->add_option("--administrator", options->administrator,
                   "name of the first person, who may do everything")
      ->required();
  command->add_option("--prefix", options->prefix, "beginning of the certificates' numbers (default: EX-)");
  command->add_option("--password-file", options->password_file,
                      "file with the password, readable by its owner only");
  command->add_flag(
      "--training", options->training,
      "for training: certificates are marked TRAINING and have numbers T-..., also of simulated runs");
  command->callback([shared, options, &exit_code] {
    init(*shared, *options);
    exit_code = kExitDone;
  });
}

struct VerifyRegisterOptions {
  std::vector<std::string> against;
  bool json = false;
};

int verify_register(const LabOptions& shared, const VerifyRegisterOptions& options) {
  lab::Register opened = open_register(shared);
  std::vector<lab::RegisterFinding> findings = opened.verify();
  for (const std::string& file : options.against)
    for (const lab::RegisterEvidence& evidence : read_evidence(file))
      for (lab::RegisterFinding& finding : opened.compare_with(evidence)) {
        finding.what = "against " + finding.what;
        findings.push_back(std::move(finding));
      }
  const bool good =
      std::all_of(findings.begin(), findings.end(), [](const lab::RegisterFinding& one) { return one.good; });
  if (options.json) {
    nlohmann::ordered_json object{{"schema", "abcal.register_verify/1"}, {"good", good}};
    for (const lab::RegisterFinding& finding : findings) {
      nlohmann::ordered_json check{{"what", finding.what}, {"good", finding.good}, {"found", finding.found}};
      if (!finding.kind.empty()) check["kind"] = finding.kind;
      object["checks"].push_back(std::move(check));
    }
    print_result("{}\n", object.dump(2));
  } else {
    for (const lab::RegisterFinding& finding : findings)
      print_result(
          "{}  {}: {}\n",
          emphasised(stdout, finding.good ? Emphasis::kGood : Emphasis::kBad, finding.good ? "good" : " bad"),
          finding.what, finding.found);
  }
  return good ? kExitDone : kExitFailed;
}

void add_verify_register(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto options = std::make_shared<VerifyRegisterOptions>();
  CLI::App* command =
      parent.add_subcommand("verify", "Check the register: its audit, its times, its records, its numbers");
  command
      ->add_option("--against", options->against,
                   "what is outside the register and names its entries, repeatable: a backup, a certificate "
                   "(XML), a run with certificates, or ENTRY:DIGITS of a printed certificate; finds a "
                   "register that was copied back, continued otherwise or rewritten")
      ->type_name("FILE");
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([shared, options, &exit_code] { exit_code = verify_register(*shared, *options); });
}

}  // namespace

lab::Register open_register(const LabOptions& options) {
  const std::string location = lab::register_location(options.location);
  if (location.empty())
    throw std::invalid_argument(
        "no register is configured; required: --register FILE or postgresql://..., or ABCAL_REGISTER");
  return lab::Register::open(location, RealClock().utc_now());
}

CLI::App* add_lab(CLI::App& parent, int& exit_code) {
  auto shared = std::make_shared<LabOptions>();
  CLI::App* command =
      parent.add_subcommand("lab", "The register of a laboratory: persons, equipment, certificates");
  command->add_option("--register", shared->location,
                      "file or postgresql://USER@HOST/DATABASE (default: ABCAL_REGISTER)");
  command->require_subcommand(1);
  add_init(*command, shared, exit_code);
  add_lab_people(*command, shared, exit_code);
  add_lab_records(*command, shared, exit_code);
  add_lab_charts(*command, shared, exit_code);
  add_lab_withdraw(*command, shared, exit_code);
  add_lab_copies(*command, shared, exit_code);
  add_verify_register(*command, shared, exit_code);
  add_lab_time_stamp(*command, exit_code);
  add_lab_sign(*command, exit_code);
  return command;
}

}  // namespace abcal
