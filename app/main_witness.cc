// abcal-witness: signs the links of a run while it is measured, in a log of which each line names the one
// before (app/witness/witness_service.h, docs/witness.md). A service of the computer under a user of
// its own, or started by abcal, with one end of a socket as descriptor 3.
#include <fmt/format.h>
#include <pwd.h>
#include <sys/stat.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdint>
#include <exception>
#include <filesystem>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/system/boot_clock.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/private_file.h"
#include "app/system/real_clock.h"
#include "app/system/version.h"
#include "app/witness/witness_log.h"
#include "app/witness/witness_service.h"
#include "protocol/record/signature.h"

namespace {

struct Choices {
  std::string key, log, socket;
  std::vector<std::string> users;
  bool beside = false, make_key = false, check = false;
};

abcal::WitnessMoment moment() {
  static const std::string boot = abcal::boot_id();
  return {abcal::RealClock().utc_now(), boot, abcal::uptime()};
}

std::set<std::uint32_t> ids_of(const std::vector<std::string>& users) {
  std::set<std::uint32_t> ids;
  for (const std::string& name : users) {
    const passwd* user = ::getpwnam(name.c_str());
    if (user == nullptr)
      throw std::invalid_argument(
          fmt::format("--user {}: found no such user; required: the name of a user of this computer", name));
    ids.insert(user->pw_uid);
  }
  return ids;
}

void make_key(const std::string& file) {
  if (!std::filesystem::exists(file)) abcal::write_private_file(file, abcal::make_private_key());
  abcal::print_result("{}", abcal::public_key_of(abcal::read_private_file(file, "key")));
}

int check(abcal::WitnessLog& log) {
  const std::vector<std::string> findings = log.verify();
  for (const std::string& finding : findings) abcal::print_result("{}\n", finding);
  if (findings.empty()) abcal::print_result("{} lines, whole\n", log.size());
  return abcal::finish_output(findings.empty() ? abcal::kExitDone : abcal::kExitFailed);
}

int run(const Choices& choices) {
  if (choices.make_key) {
    make_key(choices.key);
    return abcal::finish_output(abcal::kExitDone);
  }
  if (choices.check && !std::filesystem::exists(choices.log))
    throw std::invalid_argument(choices.log + ": found no log; required: one that a witness has made");
  abcal::WitnessLog log(choices.log, abcal::read_private_file(choices.key, "key"), moment);
  if (choices.check) return check(log);
  abcal::WitnessService::Options options{
      .socket = choices.socket, .owner = abcal::Descriptor(choices.beside ? 3 : -1), .users = std::nullopt};
  if (!choices.beside) options.users = ids_of(choices.users);
  abcal::WitnessService service(log, std::move(options));
  service.serve();
  return abcal::kExitDone;
}

}  // namespace

int main(int argc, char** argv) {
  Choices choices;
  CLI::App app("Signs the links of runs while they are measured.", "abcal-witness");
  app.set_version_flag("--version", fmt::format("abcal-witness {}", abcal::program_version()));
  app.add_option("--key", choices.key, "File of its private Ed25519 key, which only its owner may read")
      ->required();
  CLI::Option* log =
      app.add_option("--log", choices.log, "File of its log (SQLite); made if it does not exist");
  CLI::Option* socket =
      app.add_option("--socket", choices.socket, "Where it listens for programs of the named users");
  app.add_option("--user", choices.users, "User for whom it signs, repeatable")
      ->allow_extra_args(false)
      ->needs(socket);
  CLI::Option* beside = app.add_flag("--beside", choices.beside,
                                     "Serves the socket at descriptor 3, and ends with its other end");
  CLI::Option* make_key = app.add_flag("--make-key", choices.make_key,
                                       "Makes the key if there is none, prints its public part and ends");
  CLI::Option* check =
      app.add_flag("--check", choices.check, "Reads the whole log, prints findings and ends");
  for (CLI::Option* one : {socket, beside, check}) one->needs(log);
  for (CLI::Option* one : {log, socket, beside, check}) one->excludes(make_key);
  socket->excludes(check);
  beside->excludes(socket)->excludes(check);
  CLI11_PARSE(app, argc, argv);
  if (!choices.make_key && !choices.check && !choices.beside && choices.socket.empty()) {
    abcal::print_log(
        "abcal-witness: found nothing to do; required: --socket, --beside, --make-key or --check\n");
    return abcal::kExitUsage;
  }
  ::umask(0077);  // The log is for the user of the witness only.
  std::signal(SIGPIPE, SIG_IGN);
  try {
    return run(choices);
  } catch (const std::exception& error) {
    if (choices.beside)
      abcal::refuse_owner(3, error.what());
    else
      abcal::print_log("abcal-witness: {}\n", error.what());
    return dynamic_cast<const std::invalid_argument*>(&error) != nullptr ? abcal::kExitUsage
                                                                         : abcal::kExitFailed;
  }
}
