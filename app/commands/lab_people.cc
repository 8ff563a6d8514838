#include <fmt/format.h>
#include <fmt/ranges.h>

#include <chrono>
#include <stdexcept>
#include <vector>

#include "app/commands/lab.h"
#include "app/laboratory/register/login_file.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/secret_input.h"

namespace abcal {
namespace {

constexpr int kUsualHours = 8;  // A working day.

void add_login(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string name, password_file;
    int hours = kUsualHours;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("login", "Log in on this machine");
  command->add_option("NAME", options->name, "a person of the register")->required();
  command->add_option("--password-file", options->password_file,
                      "file with the password, readable by its owner only");
  command->add_option("--hours", options->hours, fmt::format("how long it holds (default: {})", kUsualHours))
      ->check(CLI::Range(1, 24));
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const std::string password = read_secret("password of " + options->name, options->password_file);
    const auto now = RealClock().utc_now();
    const std::string token = opened.log_in(options->name, password, now, std::chrono::hours(options->hours));
    lab::write_login({opened.facts().identity, token});
    print_result("{} is logged in to the register of {} until {}\n", options->name, opened.facts().name,
                 opened.who(token, now).expires_utc());
    exit_code = kExitDone;
  });
}

void add_logout(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  CLI::App* command = parent.add_subcommand("logout", "Log out on this machine");
  command->callback([shared, &exit_code] {
    lab::Register opened = open_register(*shared);
    if (const auto login = lab::read_login(opened.facts().identity)) {
      try {
        opened.log_out(login->token, RealClock().utc_now());
      } catch (const lab::RegisterError& error) {
        print_log("note: {}\n", error.what());
      }
      lab::remove_login(opened.facts().identity);
      print_result("logged out\n");
    } else {
      print_result("nobody was logged in\n");
    }
    exit_code = kExitDone;
  });
}

std::vector<lab::Right> rights_of(const std::vector<std::string>& words) {
  std::vector<lab::Right> rights;
  for (const std::string& word : words) {
    const auto right = lab::right_from(word);
    if (!right)
      throw std::invalid_argument(fmt::format("--may {}: required: one of {}", word, lab::all_rights()));
    rights.push_back(*right);
  }
  return rights;
}

void add_add_person(CLI::App& add, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    lab::Person person;
    std::vector<std::string> may;
    std::string password_file;
    bool without_password = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = add.add_subcommand("person", "Add a person");
  command->add_option("NAME", options->person.name, "as on certificates and in bench files")->required();
  command->add_option("--role", options->person.role, "position in the laboratory")->required();
  command->add_option("--email", options->person.email, "e-mail");
  command->add_option("--may", options->may, fmt::format("a right, repeatable: {}", lab::all_rights()));
  command->add_option("--password-file", options->password_file,
                      "file with the password, readable by its owner only");
  command->add_flag("--no-login", options->without_password, "without a password: the person cannot log in");
  command->callback([shared, options, &exit_code] {
    options->person.rights = rights_of(options->may);
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    const lab::LoggedIn by = lab::require_login(opened, now);
    const std::string password = options->without_password
                                     ? ""
                                     : read_new_secret("password of " + options->person.name,
                                                       lab::password_rule(), options->password_file);
    opened.add_person(by, options->person, password, RealClock().utc_now());
    print_result("person added: {}\n", options->person.name);
    exit_code = kExitDone;
  });
}

void add_retire(CLI::App& retire, const std::shared_ptr<LabOptions>& shared, int& exit_code, const char* what,
                void (lab::Register::*method)(const lab::LoggedIn&, const std::string&, const std::string&,
                                              Clock::UtcTime)) {
  struct Options {
    std::string name, reason;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = retire.add_subcommand(what, fmt::format("Retire: {}", what));
  command->add_option("NAME", options->name, "name or identity; of a key its fingerprint")->required();
  command->add_option("--reason", options->reason, "why")->required();
  command->callback([shared, options, &exit_code, what, method] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    (opened.*method)(lab::require_login(opened, now), options->name, options->reason, now);
    print_result("{} retired: {}\n", what, options->name);
    exit_code = kExitDone;
  });
}

void add_password(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  struct Options {
    std::string name, password_file;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("password", "Set a person's password: the own one, or as administrator");
  command->add_option("NAME", options->name, "a person of the register")->required();
  command->add_option("--password-file", options->password_file,
                      "file with the new password, readable by its owner only");
  command->callback([shared, options, &exit_code] {
    lab::Register opened = open_register(*shared);
    const auto now = RealClock().utc_now();
    const lab::LoggedIn by = lab::require_login(opened, now);
    const std::string password =
        read_new_secret("new password of " + options->name, lab::password_rule(), options->password_file);
    opened.set_password(by, options->name, password, RealClock().utc_now());
    print_result("password set: {}; their logins are ended\n", options->name);
    exit_code = kExitDone;
  });
}

}  // namespace

void add_lab_people(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code) {
  add_login(parent, shared, exit_code);
  add_logout(parent, shared, exit_code);
  add_password(parent, shared, exit_code);
  CLI::App* add = parent.add_subcommand("add", "Add a record");
  add->require_subcommand(1);
  add_add_person(*add, shared, exit_code);
  CLI::App* retire = parent.add_subcommand("retire", "Retire a record; it stays, since others name it");
  retire->require_subcommand(1);
  add_retire(*retire, shared, exit_code, "person", &lab::Register::retire_person);
  add_retire(*retire, shared, exit_code, "equipment", &lab::Register::retire_equipment);
  add_retire(*retire, shared, exit_code, "key", &lab::Register::retire_key);
  add_retire(*retire, shared, exit_code, "chart", &lab::Register::retire_check_standard);
  add_retire(*retire, shared, exit_code, "scope", &lab::Register::retire_scope);
}

}  // namespace abcal
