#pragma once

#include <fcntl.h>
#include <pwd.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/temporary_folder.h"

namespace abcal::test {

/// A PostgreSQL server of its own in a temporary folder, reached by a socket in that folder only. PostgreSQL
/// refuses to run as root: there it runs as the user `nobody`.
class PostgresqlCluster {
 public:
  /// Where PostgreSQL's programs are; nothing: it is not installed.
  static std::optional<std::filesystem::path> programs() {
    std::vector<std::filesystem::path> found;
    std::error_code ignored;
    for (const auto& version : std::filesystem::directory_iterator("/usr/lib/postgresql", ignored))
      if (std::filesystem::exists(version.path() / "bin/initdb", ignored))
        found.push_back(version.path() / "bin");
    if (found.empty()) return std::nullopt;
    return *std::max_element(found.begin(), found.end());
  }

  PostgresqlCluster() {
    const auto bin = programs();
    if (!bin) throw std::runtime_error("PostgreSQL is not installed");
    bin_ = *bin;
    if (::geteuid() == 0) {
      const passwd* nobody = ::getpwnam("nobody");
      if (nobody == nullptr) throw std::runtime_error("there is no user nobody");
      uid_ = nobody->pw_uid;
      gid_ = nobody->pw_gid;
      if (::chown(folder_.path().c_str(), uid_, gid_) != 0) throw std::runtime_error("chown failed");
    }
    const std::string data = (folder_ / "data").string();
    run(bin_ / "initdb", {"-D", data, "-U", "abcal", "-A", "trust", "--no-sync", "-E", "UTF8", "--locale=C"});
    run(bin_ / "pg_ctl",
        {"-D", data, "-w", "-l", (folder_ / "log").string(), "-o",
         "-F -c listen_addresses='' -c max_connections=40 -k " + folder_.path().string(), "start"});
    started_ = true;
  }
  PostgresqlCluster(const PostgresqlCluster&) = delete;
  PostgresqlCluster& operator=(const PostgresqlCluster&) = delete;
  ~PostgresqlCluster() {
    if (!started_) return;
    try {
      run(bin_ / "pg_ctl", {"-D", (folder_ / "data").string(), "-m", "immediate", "-w", "stop"});
    } catch (const std::exception&) {
      // The folder goes with it.
    }
  }

  /// A new, empty database. @return its location
  std::string make_database() {
    const std::string name = "register_" + std::to_string(++databases_);
    run(bin_ / "createdb", {"-h", folder_.path().string(), "-U", "abcal", name});
    return "postgresql:///" + name + "?host=" + folder_.path().string() + "&user=abcal";
  }

 private:
  void run(const std::filesystem::path& program, std::vector<std::string> arguments) {
    const pid_t child = ::fork();
    if (child == 0) {
      const int nowhere = ::open("/dev/null", O_RDWR);
      const int log = ::open((folder_ / "commands.log").c_str(), O_WRONLY | O_CREAT | O_APPEND, 0666);
      ::dup2(nowhere, 0);
      ::dup2(log, 1);
      ::dup2(log, 2);
      if (uid_ != 0 && (::setgid(gid_) != 0 || ::setuid(uid_) != 0)) ::_exit(126);
      if (::chdir("/") != 0) ::_exit(126);
      std::vector<char*> words;
      std::string name = program.string();
      words.push_back(name.data());
      for (std::string& argument : arguments) words.push_back(argument.data());
      words.push_back(nullptr);
      ::execv(name.c_str(), words.data());
      ::_exit(127);
    }
    int status = 0;
    if (child < 0 || ::waitpid(child, &status, 0) != child || !WIFEXITED(status) || WEXITSTATUS(status) != 0)
      throw std::runtime_error(program.string() + " failed");
  }

  TemporaryFolder folder_;
  std::filesystem::path bin_;
  uid_t uid_ = 0;
  gid_t gid_ = 0;
  bool started_ = false;
  int databases_ = 0;
};

}  // namespace abcal::test
