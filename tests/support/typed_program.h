#pragma once

#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/project_paths.h"

namespace abcal::test {

/// A program at a terminal of its own, 80 characters wide.
class ProgramAtTerminal {
 public:
  /// @param program  its path; `folder`: where it starts; `environment`: variables that are set
  ProgramAtTerminal(const std::string& program, const std::vector<std::string>& arguments,
                    const std::filesystem::path& folder,
                    const std::map<std::string, std::string>& environment) {
    const winsize size{.ws_row = 50, .ws_col = 80, .ws_xpixel = 0, .ws_ypixel = 0};
    child_ = ::forkpty(&terminal_, nullptr, nullptr, &size);
    if (child_ < 0) throw std::runtime_error("forkpty failed");
    if (child_ > 0) return;
    for (const auto& [name, value] : environment) ::setenv(name.c_str(), value.c_str(), 1);
    become_program(program, arguments, folder);
  }
  ProgramAtTerminal(const ProgramAtTerminal&) = delete;
  ProgramAtTerminal& operator=(const ProgramAtTerminal&) = delete;
  ~ProgramAtTerminal() {
    if (!exit_code_) {
      ::kill(-child_, SIGKILL);
      wait();
    }
    ::close(terminal_);
  }

  /// Everything that the terminal has shown, bytes that move the cursor included.
  const std::string& shown() const { return shown_; }

  void type(const std::string& bytes) {
    if (::write(terminal_, bytes.data(), bytes.size()) != static_cast<ssize_t>(bytes.size()))
      throw std::runtime_error("the terminal takes no more");
  }

  /// Waits until more is shown. @return false if the program has ended
  /// @throws std::runtime_error if nothing is shown for so long
  bool read_more(std::chrono::milliseconds longest = std::chrono::minutes(4)) {
    pollfd ready{terminal_, POLLIN, 0};
    if (::poll(&ready, 1, static_cast<int>(longest.count())) <= 0)
      throw std::runtime_error("the program at the terminal shows nothing more, after: " + shown_);
    std::array<char, 4096> bytes{};
    const ssize_t count = ::read(terminal_, bytes.data(), bytes.size());
    if (count <= 0) return false;
    shown_.append(bytes.data(), static_cast<std::size_t>(count));
    return true;
  }

  /// Waits for the end. 128 + signal for a program that a signal ended.
  int wait() {
    if (!exit_code_) {
      int status = 0;
      ::waitpid(child_, &status, 0);
      exit_code_ = exit_code_of_status(status);
    }
    return *exit_code_;
  }

 private:
  pid_t child_ = -1;
  int terminal_ = -1;
  std::string shown_;
  std::optional<int> exit_code_;
};

struct Typed {
  int exit_code = -1;  ///< 128 + signal for a program that a signal ended.
  std::string shown;
};

/// Decides what is typed, from everything that the terminal shows: bytes, the end of the line included;
/// nothing: wait for more. Called whenever something was shown.
using Typist = std::function<std::optional<std::string>(const std::string& shown)>;

/// The program abcal at a terminal, and a person who types.
inline Typed type_at_terminal(const std::vector<std::string>& arguments, const std::filesystem::path& folder,
                              const Typist& typist,
                              const std::map<std::string, std::string>& environment = {}) {
  ProgramAtTerminal program(abcal_program(), arguments, folder, environment);
  while (program.read_more()) {
    if (const std::optional<std::string> line = typist(program.shown())) program.type(*line);
  }
  return {program.wait(), program.shown()};
}

/// Types each answer once `prompt` was shown for the next question.
inline Typist answers_to(const std::string& prompt, const std::vector<std::string>& answers) {
  return [prompt, answers, from = std::size_t{0},
          next = std::size_t{0}](const std::string& shown) mutable -> std::optional<std::string> {
    if (next == answers.size() || !shown.ends_with(prompt) || shown.find(prompt, from) == std::string::npos)
      return std::nullopt;
    from = shown.size();
    return answers[next++] + "\n";
  };
}

}  // namespace abcal::test
