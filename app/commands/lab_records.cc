#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <string_view>
#include <vector>

#include "app/commands/lab.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/private_file.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"
#include "drivers/text/number.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

double number_of(const std::string& text, const std::string& whole) {
  if (const auto value = pieces::number<double>(text)) return *value;
  throw std::invalid_argument(
      fmt::format("--value {}: \"{}\" is not a number; required: NAME=VALUE,U,K,UNIT", whole, text));
}

/// "step_deg=0.0003,0.0002,2,deg"
lab::CalibratedValue value_of(const std::string& text) {
  const std::size_t equals = text.find('=');
  std::vector<std::string> parts;
  std::size_t at = equals == std::string::npos ? text.size() : equals + 1;
  while (at <= text.size() && equals != std::string::npos) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    parts.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  if (parts.size() != 4)
    throw std::invalid_argument(
        fmt::format("--value {}: required: NAME=VALUE,U,K,UNIT, such as step_deg=0.0003,0.0002,2,deg", text));
  return {text.substr(0, equals), parts[3], number_of(parts[0], text), number_of(parts[1], text),
          number_of(parts[2], text)};
}

void add_add_equipment(CLI::App& add, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto equipment = std::make_shared<lab::Equipment>();
  CLI::App* command = add.add_subcommand("equipment", "Add a piece of equipment");
  command->add_option("IDENTITY", equipment->identity, "its name in the register: STAGE-1")->required();
  command->add_option("--name", equipment->name, "what it is, as on certificates")->required();
  command
      ->add_option(
          "--quantity", equipment->quantity,
          "what it makes traceable: angle, voltage, gravity, temperature, humidity, pressure, level, "
          "\"stage record\", other")
      ->required();
  command->add_option("--serial-number", equipment->serial_number, "exactly as it identifies itself")
      ->required();
  command->add_option("--maker", equipment->maker, "its maker");
  command->add_option("--model", equipment->model, "its model");
  command->callback([shared, equipment, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    opened.add_equipment(lab::require_login(opened, now), *equipment, now);
    print_result("equipment added: {}\n", equipment->identity);
    exit_code = kExitDone;
  });
}

void add_add_calibration(CLI::App& add, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    lab::Calibration calibration;
    std::vector<std::string> values;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = add.add_subcommand("calibration", "Add a calibration of a piece of equipment");
  command->add_option("CERTIFICATE", options->calibration.certificate, "number of its certificate")
      ->required();
  command->add_option("--equipment", options->calibration.equipment, "identity of the equipment")->required();
  command
      ->add_option("--issuer", options->calibration.issuer,
                   "who issued it; of a stage record, who approves it")
      ->required();
  command->add_option("--performed", options->calibration.performed, "date, 2026-03-01")->required();
  command->add_option("--due", options->calibration.due, "date until which it holds")->required();
  command->add_option("--sha256", options->calibration.sha256,
                      "of the certificate's file, or of the stage record");
  command
      ->add_option("--value", options->values,
                   "a value, repeatable: NAME=VALUE,U,K,UNIT, such as step_deg=0.0003,0.0002,2,deg")
      ->allow_extra_args(false);
  command->callback([shared, options, &exit_code] {
    for (const std::string& value : options->values) options->calibration.values.push_back(value_of(value));
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    opened.add_calibration(lab::require_login(opened, now), options->calibration, now);
    print_result("calibration added: {} of {}\n", options->calibration.certificate,
                 options->calibration.equipment);
    exit_code = kExitDone;
  });
}

void add_add_item(CLI::App& add, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto item = std::make_shared<lab::Item>();
  CLI::App* command = add.add_subcommand("item", "Add an item that is calibrated");
  command->add_option("--maker", item->maker, "its maker")->required();
  command->add_option("--model", item->model, "its model")->required();
  command->add_option("--serial-number", item->serial_number, "its serial number")->required();
  command->add_option("--owner", item->owner, "its owner");
  command->add_option("--identity", item->identity,
                      "its name in the register (default: maker, model, serial number)");
  command->callback([shared, item, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    opened.add_item(lab::require_login(opened, now), *item, now);
    print_result("item added\n");
    exit_code = kExitDone;
  });
}

void add_add_scope(CLI::App& add, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto entry = std::make_shared<lab::ScopeEntry>();
  CLI::App* command = add.add_subcommand(
      "scope", "Add a CMC: the smallest expanded uncertainty that issue may state in a range");
  command->add_option("NAME", entry->identity, "its name in the register")->required();
  command->add_option("--quantity", entry->quantity, "sensitivity, angle or offset")->required();
  command->add_option("--unit", entry->unit, "as in results: V/g_loc, degree, V")->required();
  command->add_option("--from", entry->from, "range of the value's size")->required();
  command->add_option("--to", entry->to, "its end")->required();
  command->add_option("--cmc", entry->cmc, "expanded uncertainty, k = 2")->required();
  command->add_flag("--relative", entry->relative, "the CMC is a part of the value");
  command->callback([shared, entry, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    opened.add_scope(lab::require_login(opened, now), *entry, now);
    print_result("scope added: {}\n", entry->identity);
    exit_code = kExitDone;
  });
}

struct KeyOptions {
  std::string owner, file, kind = "bench", certificate;
};

/// Makes a key, or takes the certificate of one that was made elsewhere. @return its public part
std::string public_key_for(const KeyOptions& options, const lab::Register& opened, Clock::UtcTime now) {
  const bool of_person = options.kind == "person";
  if (!of_person && !options.certificate.empty())
    throw std::invalid_argument("--certificate: a bench has a key alone; required: --kind person");
  if (of_person && options.certificate.empty())
    throw std::invalid_argument(
        "--kind person: required: --certificate FILE, the person's X.509 certificate");
  if (options.file.empty()) {
    if (!of_person) throw std::invalid_argument("required: --output FILE for the private key");
    return subject_of(read_file(options.certificate)).public_pem;
  }
  if (!of_person) {
    const std::string key = make_private_key();
    write_private_file(options.file, key);
    return public_key_of(key);
  }
  const SigningIdentity made = make_signing_identity(options.owner, opened.facts().name, now);
  require_writable({{"--certificate", options.certificate}}, {}, false);
  write_private_file(options.file, made.private_pem);
  OutputFile(options.certificate).write(made.certificate_pem);
  return subject_of(made.certificate_pem).public_pem;
}

void add_key(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto options = std::make_shared<KeyOptions>();
  CLI::App* command =
      parent.add_subcommand("key",
                            "Make a key with which a bench signs its runs (Ed25519) or a person certificates "
                            "(ECDSA P-256); the register keeps the public part");
  command->add_option("OWNER", options->owner, "name of the bench or person")->required();
  command->add_option("-o,--output", options->file, "file for the private key, made with mode 0600");
  command->add_option("--kind", options->kind, "bench or person (default: bench)")
      ->check(CLI::IsMember({"bench", "person"}));
  command->add_option("--certificate", options->certificate,
                      "of a person: file for the X.509 certificate; without --output, the certificate of a "
                      "key that was made elsewhere");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    const lab::LoggedIn by = lab::require_login(opened, now);
    const std::string public_pem = public_key_for(*options, opened, now);
    opened.add_key(by, {fingerprint_of(public_pem), options->owner, options->kind, public_pem, {}, {}}, now);
    print_result("key of {} {}: {}\n", options->kind, options->owner, fingerprint_of(public_pem));
    if (!options->file.empty())
      print_result("its private part is in {}: keep it {} only\n", options->file,
                   options->kind == "bench" ? "on the bench" : "where its owner alone can read it");
    exit_code = kExitDone;
  });
}

nlohmann::ordered_json listed(lab::Register& opened, const std::string& what) {
  return nlohmann::ordered_json::parse(opened.export_json())["tables"][what];
}

void print_table(const nlohmann::ordered_json& rows) {
  for (const auto& row : rows) {
    std::string line;
    for (const auto& [key, value] : row.items()) {
      const std::string text = value.get<std::string>();
      if (text.empty() || key == "public_pem" || key == "before_json" || key == "after_json") continue;
      line += fmt::format("{}{}: {}", line.empty() ? "" : "; ", key, text);
    }
    print_result("{}\n", line);
  }
}

void add_list(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string what;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("list", "List the records of a kind");
  command
      ->add_option("KIND", options->what,
                   fmt::format("{}", fmt::join(lab::Register::exported_tables(), ", ")))
      ->required()
      ->check(CLI::IsMember(lab::Register::exported_tables()));
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const nlohmann::ordered_json rows = listed(opened, options->what);
    if (options->json) {
      print_result(
          "{}\n", nlohmann::ordered_json{{"schema", "abcal.register_list/1"}, {options->what, rows}}.dump(2));
    } else {
      print_table(rows);
    }
    exit_code = kExitDone;
  });
}

/// Whether a text names a serial number, and not one that only contains it.
bool names(const std::string& text, const std::string& serial_number) {
  const auto belongs = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' || c == '-';
  };
  for (std::size_t at = text.find(serial_number); at != std::string::npos;
       at = text.find(serial_number, at + 1)) {
    const std::size_t end = at + serial_number.size();
    if ((at == 0 || !belongs(text[at - 1])) && (end == text.size() || !belongs(text[end]))) return true;
  }
  return false;
}

/// The history of an item in the register: its record, its certificates, its charts and their runs.
nlohmann::ordered_json history_of(lab::Register& opened, const std::string& serial_number) {
  const nlohmann::ordered_json tables = nlohmann::ordered_json::parse(opened.export_json())["tables"];
  nlohmann::ordered_json history = nlohmann::ordered_json::object();
  std::set<std::string> charts;
  for (const char* table : {"item", "certificate", "check_standard", "check_point", "check_run"}) {
    history[table] = nlohmann::ordered_json::array();
    for (const nlohmann::ordered_json& row : tables.at(table)) {
      const auto of = [&](const char* column) {
        return row.contains(column) ? row[column].get<std::string>() : "";
      };
      const bool own = names(of("serial_number"), serial_number) || names(of("item"), serial_number) ||
                       charts.contains(of("check_standard"));
      if (!own) continue;
      if (table == std::string_view("check_standard")) charts.insert(of("name"));
      history[table].push_back(row);
    }
  }
  return history;
}

void add_history(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string serial_number;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "history", "List what is known of an item: certificates, control charts and their runs");
  command->add_option("SERIAL_NUMBER", options->serial_number, "of the item")->required();
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const nlohmann::ordered_json history = history_of(opened, options->serial_number);
    const bool known = std::ranges::any_of(history, [](const auto& rows) { return !rows.empty(); });
    exit_code = known ? kExitDone : kExitFailed;
    if (options->json) {
      print_result("{}\n", nlohmann::ordered_json{{"schema", "abcal.register_history/1"},
                                                  {"serial_number", options->serial_number},
                                                  {"records", history}}
                               .dump(2));
      return;
    }
    for (const auto& [table, rows] : history.items()) {
      if (rows.empty()) continue;
      print_result("{}\n", table);
      print_table(rows);
    }
    if (!known) print_result("no record names an item {}\n", options->serial_number);
  });
}

}  // namespace

void add_lab_records(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  CLI::App* add = parent.get_subcommand("add");
  add_add_equipment(*add, shared, exit_code);
  add_add_calibration(*add, shared, exit_code);
  add_add_item(*add, shared, exit_code);
  add_add_scope(*add, shared, exit_code);
  add_key(parent, shared, exit_code);
  add_list(parent, shared, exit_code);
  add_history(parent, shared, exit_code);
}

}  // namespace abcal
