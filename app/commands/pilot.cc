#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/commands/commands.h"
#include "app/document/document_html.h"
#include "app/document/document_text.h"
#include "app/document/write_pdf.h"
#include "app/laboratory/pilot/comparison_chain.h"
#include "app/laboratory/pilot/comparison_protocol.h"
#include "app/laboratory/pilot/pilot_analysis.h"
#include "app/laboratory/pilot/pilot_dcc.h"
#include "app/laboratory/pilot/pilot_document.h"
#include "app/laboratory/register/login.h"
#include "app/laboratory/register/register.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/real_clock.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr const char* kProtocolWords = "protocol of the comparison (TOML)";

struct AddOptions {
  std::string protocol, file, participant, sha256, replace, withdraw, statement, protocol_change;
  bool agree = false;
};

PilotAnalysis analysed_comparison(const std::string& file, PilotDraft draft) {
  PilotAnalysis analysis = analyse_comparison(file, lab::register_location({}), RealClock().utc_now());
  if (draft == PilotDraft::kB) ComparisonChain(analysis.protocol).require_agreement();
  return analysis;
}

/// The SHA-256 of a result, and its file if that is there.
std::string hash_to_add(const AddOptions& options, const ComparisonProtocol& protocol) {
  if (options.file.empty()) {
    constexpr std::size_t kDigits = 64;
    if (options.sha256.size() != kDigits ||
        options.sha256.find_first_not_of("0123456789abcdef") != std::string::npos)
      throw std::invalid_argument(
          "required: the FILE of the result, or --sha256 with its 64 hexadecimal digits");
    return options.sha256;
  }
  // Read, so that a result that cannot be compared is refused now; its values are not shown.
  read_pilot_result(protocol, options.participant, options.file);
  const std::string sha256 = sha256_of_file(options.file);
  if (!options.sha256.empty() && options.sha256 != sha256)
    throw std::invalid_argument(
        fmt::format("{}: its SHA-256 is {}, not that of --sha256", options.file, sha256));
  return sha256;
}

void add_to_comparison(const AddOptions& options) {
  const ComparisonProtocol protocol = read_comparison_protocol(options.protocol);
  ComparisonChain chain(protocol);
  const Clock::UtcTime now = RealClock().utc_now();
  if (!options.protocol_change.empty()) {
    chain.accept_protocol(options.protocol_change, now);
    print_result("The protocol as it is now counts.\n");
    return;
  }
  if (options.participant.empty())
    throw std::invalid_argument("--participant is required: whose result it is");
  chain.require_known(options.participant);
  if (!options.withdraw.empty()) {
    chain.withdraw(options.participant, options.withdraw, now);
    print_result("{}: its results do not count any more; the report says so.\n", options.participant);
  } else if (!options.statement.empty()) {
    chain.add_statement(options.participant, options.statement, now);
    print_result("{}: its statement stands in the report.\n", options.participant);
  } else if (options.agree) {
    chain.agree(options.participant, now);
    print_result("{}: agrees with Draft A.\n", options.participant);
    return;
  } else {
    const std::string sha256 = hash_to_add(options, protocol);
    const int number =
        options.replace.empty()
            ? chain.add_result(options.participant, sha256, options.file, now)
            : chain.replace_result(options.participant, sha256, options.file, options.replace, now);
    print_result("Measurement {} by {}: committed by SHA-256 {}{}.\n", number, options.participant, sha256,
                 options.file.empty() ? "; add the file when all results are committed" : "");
  }
  print_log("{} of {} results are committed\n", chain.committed(), chain.states().size());
}

void add_pilot_init(CLI::App& parent) {
  struct Options {
    std::string file;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("init", "Write a protocol with comments, to be changed");
  command->add_option("PROTOCOL", options->file, "file to write; it must not exist")->required();
  command->callback([options] {
    OutputFile(options->file).write_new(example_protocol());
    print_result("{} written: change it, and have all participants agree before the first measurement\n",
                 options->file);
  });
}

void add_pilot_add(CLI::App& parent) {
  auto options = std::make_shared<AddOptions>();
  CLI::App* command = parent.add_subcommand(
      "add", "Add a result by its SHA-256, a late change, a withdrawal or a statement; shows no value");
  command->add_option("PROTOCOL", options->protocol, kProtocolWords)->required();
  command->add_option("FILE", options->file,
                      "result: certificate (DCC XML), run, measurement, or a table with covariance (CSV)");
  command->add_option("--participant", options->participant, "whose result it is");
  command->add_option(
      "--sha256", options->sha256,
      "SHA-256 of the file, where the participant gives the file when all results are committed");
  CLI::Option* replace =
      command->add_option("--replace", options->replace, "reason why it replaces the participant's result")
          ->type_name("REASON");
  CLI::Option* withdraw =
      command
          ->add_option("--withdraw", options->withdraw, "reason why the participant's results do not count")
          ->type_name("REASON");
  CLI::Option* statement =
      command->add_option("--statement", options->statement, "statement of the participant for the report");
  CLI::Option* agree = command->add_flag("--agree", options->agree,
                                         "the participant has read Draft A and agrees with it, for Draft B");
  CLI::Option* change = command
                            ->add_option("--protocol-change", options->protocol_change,
                                         "reason why the protocol, as it is now, counts from now on")
                            ->type_name("REASON");
  withdraw->excludes(replace)->excludes(statement)->excludes(change);
  statement->excludes(replace)->excludes(change);
  agree->excludes(replace)->excludes(withdraw)->excludes(statement)->excludes(change);
  command->callback([options] { add_to_comparison(*options); });
}

void add_pilot_status(CLI::App& parent) {
  struct Options {
    std::string protocol;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("status", "Which results are in, and what was changed; shows no value");
  command->add_option("PROTOCOL", options->protocol, kProtocolWords)->required();
  command->add_flag("--json", options->json, "print one JSON object, schema abcal.pilot/1");
  command->callback([options] {
    const ComparisonProtocol protocol = read_comparison_protocol(options->protocol);
    const ComparisonChain chain(protocol);
    if (options->json) {
      print_result("{}\n", pilot_status_json(protocol, chain).dump(2));
    } else {
      print_result("{}", document_text(pilot_status(protocol, chain), stdout));
    }
    chain.require_protocol();
  });
}

void add_pilot_analyse(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string protocol;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "analyse",
      "Reference value, degrees of equivalence, and who differs; exit 1 if the participants do not agree");
  command->add_option("PROTOCOL", options->protocol, kProtocolWords)->required();
  command->add_flag("--json", options->json, "print one JSON object, schema abcal.pilot/1");
  command->callback([options, &exit_code] {
    const PilotAnalysis analysis = analysed_comparison(options->protocol, PilotDraft::kA);
    if (options->json) {
      print_result("{}\n", pilot_json(analysis).dump(2));
    } else {
      const std::string now = format_utc(RealClock().utc_now());
      print_result("{}", document_text(pilot_document(analysis, PilotDraft::kA, now), stdout));
    }
    exit_code = analysis.agree() ? kExitDone : kExitFailed;
  });
}

struct ReportOptions {
  std::string protocol, draft = "A", html, pdf, xml, laboratory, number, approved_by;
  bool force = false;

  std::vector<RequestedOutput> outputs() const {
    std::vector<RequestedOutput> list;
    if (!html.empty()) list.push_back({"--html", html});
    if (!pdf.empty()) list.push_back({"--pdf", pdf});
    if (!xml.empty()) list.push_back({"--xml", xml});
    return list;
  }
};

/// The facts of the certificate, or everything that is missing.
std::optional<PilotCertificate> facts_of_certificate(const ReportOptions& options, PilotDraft draft,
                                                     Clock::UtcTime now) {
  const bool any = !options.laboratory.empty() || !options.number.empty() || !options.approved_by.empty();
  if (options.xml.empty()) {
    if (any)
      throw std::invalid_argument(
          "--laboratory, --number and --approved-by are of a certificate; required: --xml FILE");
    return std::nullopt;
  }
  if (draft != PilotDraft::kB || options.laboratory.empty() || options.number.empty() ||
      options.approved_by.empty())
    throw std::invalid_argument(
        "--xml writes the certificate of what all agreed with; required: --draft B, --laboratory FILE, "
        "--number "
        "NUMBER and --approved-by NAME");
  ReadLaboratoryFile read = read_laboratory_file(options.laboratory);
  if (!read.problems.empty()) throw LaboratoryFileError(options.laboratory, read.problems);
  return PilotCertificate{.laboratory = std::move(read.file),
                          .number = options.number,
                          .approved_by = options.approved_by,
                          .date = parse_date(format_utc(now)).value()};
}

void report_comparison(const ReportOptions& options) {
  const PilotDraft draft = kPilotDrafts.value(options.draft).value();
  const Clock::UtcTime now = RealClock().utc_now();
  const std::vector<RequestedOutput> outputs = options.outputs();
  const std::optional<PilotCertificate> facts = facts_of_certificate(options, draft, now);
  require_writable(outputs, {options.protocol}, options.force);
  const PilotAnalysis analysis = analysed_comparison(options.protocol, draft);
  const Document document = pilot_document(analysis, draft, format_utc(now));
  if (outputs.empty()) print_result("{}", document_text(document, stdout));
  if (facts) {
    const DccSchema schema(program_schemas());
    OutputFile(options.xml).write(pilot_dcc(analysis, *facts, &schema));
  }
  if (!options.html.empty()) OutputFile(options.html).write(document_html(document));
  if (!options.pdf.empty()) {
    OutputFile file(options.pdf);
    write_pdf(document, file.temporary(), std::nullopt);
    file.commit();
  }
  for (const RequestedOutput& output : outputs)
    print_result("{} written: {}\n", output.option.substr(2),
                 std::filesystem::absolute(output.path).string());
}

void add_pilot_report(CLI::App& parent) {
  auto options = std::make_shared<ReportOptions>();
  CLI::App* command = parent.add_subcommand(
      "report",
      "Draft A or B with figures and matrices (HTML, PDF; else as text), and the certificate (DCC XML)");
  command->add_option("PROTOCOL", options->protocol, kProtocolWords)->required();
  command
      ->add_option("--draft", options->draft,
                   "A: for the participants; B: what all agreed with (abcal pilot add --agree)")
      ->check(CLI::IsMember(kPilotDrafts.all()))
      ->capture_default_str();
  command->add_option("--html", options->html, "write this page");
  command->add_option("--pdf", options->pdf, "write this PDF");
  command->add_option("--xml", options->xml, "write this certificate of the result (DCC XML), with Draft B");
  command->add_option("--laboratory", options->laboratory,
                      "laboratory file of the pilot, for the certificate");
  command->add_option("--number", options->number, "number of the certificate");
  command->add_option("--approved-by", options->approved_by, "person of the laboratory file who approves it");
  command->add_flag("--force", options->force, "overwrite existing files");
  command->callback([options] { report_comparison(*options); });
}

}  // namespace

CLI::App* add_pilot(CLI::App& parent, int& exit_code) {
  CLI::App* command = parent.add_subcommand(
      "pilot", "A comparison of laboratories: protocol, blind results, reference value, drafts");
  command->require_subcommand(1);
  add_pilot_init(*command);
  add_pilot_add(*command);
  add_pilot_status(*command);
  add_pilot_analyse(*command, exit_code);
  add_pilot_report(*command);
  return command;
}

}  // namespace abcal
