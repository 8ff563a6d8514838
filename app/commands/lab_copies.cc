#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <stdexcept>

#include "app/commands/lab.h"
#include "app/laboratory/certificate/laboratory_file.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/private_file.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"

namespace abcal {
namespace {

void add_backup(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto file = std::make_shared<std::string>();
  CLI::App* command = parent.add_subcommand("backup", "Write all of the register to one file");
  command->add_option("FILE", *file, "the file, made with mode 0600: it holds the passwords' hashes")
      ->required();
  command->callback([shared, file, &exit_code] {
    lab::Register opened = open_register(*shared);
    write_private_file(*file, opened.backup());
    print_result("backup written: {}\n", *file);
    exit_code = kExitDone;
  });
}

void add_restore(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto file = std::make_shared<std::string>();
  CLI::App* command =
      parent.add_subcommand("restore", "Make a register of a backup; it may be of the other database");
  command->add_option("FILE", *file, "what `abcal lab backup` wrote")->required();
  command->callback([shared, file, &exit_code] {
    const std::string location = lab::register_location(shared->location);
    if (location.empty())
      throw std::invalid_argument("--register is missing: where the register is to be made");
    const lab::Register restored = lab::Register::restore(location, read_file(*file), RealClock().utc_now());
    print_result("register of {} restored: {}\n", restored.facts().name, lab::without_password(location));
    exit_code = kExitDone;
  });
}

void add_export(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string folder, format = "csv";
    bool force = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("export", "Write the records for other programs, without passwords");
  command->add_option("FOLDER", options->folder, "where: one file a table as CSV, or register.json")
      ->required();
  command->add_option("--format", options->format, "csv or json (default: csv)")
      ->check(CLI::IsMember({"csv", "json"}));
  command->add_flag("--force", options->force, "overwrite files that exist");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const std::filesystem::path folder = options->folder;
    std::filesystem::create_directories(folder);
    std::vector<std::pair<std::filesystem::path, std::string>> files;
    if (options->format == "json") {
      files.emplace_back(folder / "register.json", opened.export_json());
    } else {
      for (const std::string& table : lab::Register::exported_tables())
        files.emplace_back(folder / (table + ".csv"), opened.export_csv(table));
    }
    std::vector<RequestedOutput> requested;
    for (const auto& [path, text] : files) requested.push_back({"export", path});
    require_writable(requested, {}, options->force);
    for (const auto& [path, text] : files) OutputFile(path).write(text);
    print_result("{} files written: {}\n", files.size(), folder.string());
    exit_code = kExitDone;
  });
}

/// Entries of the scope that the register does not have yet.
std::size_t import_scope(lab::Register& opened, const lab::LoggedIn& by, const LaboratoryFile& file,
                         Clock::UtcTime now) {
  std::size_t added = 0;
  const std::vector<lab::ScopeEntry> known = opened.scope();
  for (const ScopeLimit& limit : file.scope) {
    const std::string identity =
        fmt::format("{} {} {} to {}", limit.quantity, limit.unit, limit.from, limit.to);
    const bool is_known = std::any_of(known.begin(), known.end(),
                                      [&](const lab::ScopeEntry& one) { return one.identity == identity; });
    if (is_known) continue;
    opened.add_scope(
        by, {identity, limit.quantity, limit.unit, limit.from, limit.to, limit.cmc, limit.relative, {}, {}},
        now);
    ++added;
  }
  return added;
}

/// Adds the persons, equipment and scope of a laboratory file that the register does not have yet.
/// @return the number of records added
std::size_t import_file(lab::Register& opened, const lab::LoggedIn& by, const LaboratoryFile& file,
                        Clock::UtcTime now) {
  std::size_t added = 0;
  for (const Person& person : file.persons) {
    if (opened.find_person(person.name)) continue;
    lab::Person record{person.name, person.role, person.email, {}, {}, {}};
    for (const std::string& word : person.may)
      if (const auto right = lab::right_from(word)) record.rights.push_back(*right);
    opened.add_person(by, record, "", now);
    ++added;
  }
  for (const Equipment& one : file.equipment) {
    const std::string identity = one.name + " " + one.serial_number;
    bool known = false;
    for (const lab::Equipment& record : opened.equipment()) known = known || record.identity == identity;
    if (known) continue;
    opened.add_equipment(by, {identity, one.name, one.maker, one.model, one.serial_number, one.quantity, {}},
                         now);
    ++added;
    print_log(
        "note: calibration {} of {}: not taken over, since a laboratory file does not say when it was "
        "performed; `abcal lab add calibration` adds it\n",
        one.certificate, identity);
  }
  return added + import_scope(opened, by, file, now);
}

void add_import(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  auto file = std::make_shared<std::string>();
  CLI::App* command = parent.add_subcommand(
      "import", "Take over persons (without passwords), equipment and scope of a laboratory file");
  command->add_option("LAB.toml", *file, "laboratory file")->required();
  command->callback([shared, file, &exit_code] {
    const ReadLaboratoryFile read = read_laboratory_file(*file);
    if (!read.problems.empty()) throw LaboratoryFileError(*file, read.problems);
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    const std::size_t added = import_file(opened, lab::require_login(opened, now), read.file, now);
    print_result("{} records added from {}\n", added, *file);
    exit_code = kExitDone;
  });
}

}  // namespace

void add_lab_copies(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  add_backup(parent, shared, exit_code);
  add_restore(parent, shared, exit_code);
  add_export(parent, shared, exit_code);
  add_import(parent, shared, exit_code);
}

}  // namespace abcal
