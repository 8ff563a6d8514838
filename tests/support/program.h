#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <regex>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "tests/support/project_paths.h"

namespace abcal::test {

inline std::string read_file(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

inline void write_file(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

/// A text in one line: where it was broken does not matter.
inline std::string unwrapped(const std::string& text) {
  return std::regex_replace(text, std::regex("\\s+"), " ");
}

/// In a child process: becomes the program, which starts in the folder. Ends it where that is not possible.
[[noreturn]] inline void become_program(const std::string& program, const std::vector<std::string>& arguments,
                                        const std::filesystem::path& folder) {
  if (::chdir(folder.c_str()) != 0) ::_exit(126);
  std::vector<std::string> words{program};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  ::execv(program.c_str(), argv.data());
  ::_exit(127);
}

/// The exit code that a process has ended with; 128 + signal if a signal ended it.
/// @param status  as waitpid() gives it
inline int exit_code_of_status(int status) {
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

/// The program `abcal` in a process of its own, with its output in files of `folder`.
class Program {
 public:
  struct Limits {
    std::optional<rlim_t> file_size;  ///< Simulates a disk that is full at this size of a file.
  };

  Program(std::vector<std::string> arguments, const std::filesystem::path& folder)
      : Program(arguments, folder, Limits{}) {}

  Program(const std::vector<std::string>& arguments, const std::filesystem::path& folder,
          const Limits& limits)
      : Program(abcal_program(), arguments, folder, limits) {}

  /// Another program that starts abcal.
  Program(const std::string& program, const std::vector<std::string>& arguments,
          const std::filesystem::path& folder, const Limits& limits = {}) {
    static int count = 0;
    const std::string stem = "program-" + std::to_string(::getpid()) + "-" + std::to_string(count++);
    out_ = folder / (stem + ".out");
    err_ = folder / (stem + ".err");
    pid_ = ::fork();
    if (pid_ < 0) throw std::runtime_error("fork failed");
    if (pid_ == 0) {
      ::setpgid(0, 0);
      const int out = ::open(out_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
      const int err = ::open(err_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
      ::dup2(out, 1);
      ::dup2(err, 2);
      if (limits.file_size) {
        const rlimit limit{*limits.file_size, *limits.file_size};
        ::setrlimit(RLIMIT_FSIZE, &limit);
        ::signal(SIGXFSZ, SIG_IGN);
      }
      become_program(program, arguments, folder);
    }
  }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;
  ~Program() {
    if (!exit_code_) {
      signal(SIGKILL);
      wait();
    }
  }

  pid_t pid() const { return pid_; }
  void signal(int number) const { ::kill(pid_, number); }

  /// Waits for the end. 128 + signal for a program that a signal ended.
  int wait() {
    if (!exit_code_) {
      int status = 0;
      ::waitpid(pid_, &status, 0);
      exit_code_ = exit_code_of_status(status);
    }
    return *exit_code_;
  }

  bool running() {
    if (exit_code_) return false;
    int status = 0;
    if (::waitpid(pid_, &status, WNOHANG) != pid_) return true;
    exit_code_ = exit_code_of_status(status);
    return false;
  }

  std::string out() const { return read_file(out_); }
  std::string err() const { return read_file(err_); }

 private:
  pid_t pid_ = -1;
  std::filesystem::path out_, err_;
  std::optional<int> exit_code_;
};

struct ProgramResult {
  int exit_code = -1;
  std::string out, err;
};

inline ProgramResult run_program(const std::vector<std::string>& arguments,
                                 const std::filesystem::path& folder) {
  Program program(arguments, folder);
  const int code = program.wait();
  return {code, program.out(), program.err()};
}

/// Polls until `condition` holds, e.g. to wait for progress of another process. @return false after
/// `longest`
inline bool wait_for(const std::function<bool()>& condition, std::chrono::milliseconds longest) {
  const auto deadline = std::chrono::steady_clock::now() + longest;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

}  // namespace abcal::test
