#pragma once

#include <sys/stat.h>

#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>

#include "tests/support/program.h"

namespace abcal::test {

/// A training register in a folder, with "Approver N. N.", who is logged in, and "Operator N. N."; the
/// programs that a test starts use it as long as this lives. Its certificates have the numbers T-YEAR-0001
/// and so on.
class TrainingRegister {
 public:
  explicit TrainingRegister(const std::filesystem::path& folder, bool training = true) : folder_(folder) {
    write_file(folder / "password", "correct horse 7\n");
    ::chmod((folder / "password").c_str(), 0600);
    use();
    std::vector<std::string> init{"init", "--laboratory", "Example laboratory", "--administrator",
                                  "Approver N. N."};
    if (training) init.emplace_back("--training");
    lab(init, true);
    log_in("Approver N. N.");
    lab({"add", "person", "Operator N. N.", "--role", "technician", "--may", "measure"}, true);
  }
  /// A copy of another's in another folder, with its login: making one takes a while, since passwords are
  /// hashed.
  TrainingRegister(const TrainingRegister& other, const std::filesystem::path& folder) : folder_(folder) {
    for (const char* part : {"register.db", "password", "state"})
      std::filesystem::copy(other.folder_ / part, folder / part, std::filesystem::copy_options::recursive);
    use();
  }
  TrainingRegister(const TrainingRegister&) = delete;
  TrainingRegister& operator=(const TrainingRegister&) = delete;
  ~TrainingRegister() { leave(); }

  /// From now on programs use this register.
  void use() const {
    ::setenv("XDG_STATE_HOME", (folder_ / "state").c_str(), 1);
    ::setenv("ABCAL_REGISTER", (folder_ / "register.db").c_str(), 1);
  }
  /// From now on programs use no register.
  static void leave() {
    ::unsetenv("ABCAL_REGISTER");
    ::unsetenv("XDG_STATE_HOME");
  }

  void log_in(const std::string& name) { lab({"login", name}, true); }

  /// Runs `abcal lab` with these words. @throws std::runtime_error if it fails
  std::string lab(std::vector<std::string> words, bool with_password = false) {
    words.insert(words.begin(), "lab");
    if (with_password) words.insert(words.end(), {"--password-file", (folder_ / "password").string()});
    const ProgramResult result = run_program(words, folder_);
    if (result.exit_code != 0) throw std::runtime_error(result.err + result.out);
    return result.out;
  }

 private:
  std::filesystem::path folder_;
};

/// The number after "certificate " in what `abcal issue` printed.
inline std::string number_of(const std::string& printed) {
  const std::string before = "certificate ";
  const std::size_t at = printed.find(before + "T-");
  if (at == std::string::npos) return {};
  const std::size_t begin = at + before.size();
  return printed.substr(begin, printed.find(' ', begin) - begin);
}

}  // namespace abcal::test
