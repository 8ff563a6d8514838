#pragma once

#include <pty.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "tests/support/project_paths.h"

namespace abcal::test {

struct Typed {
  int exit_code = -1;  ///< 128 + signal for a program that a signal ended.
  std::string shown;
};

/// Decides what is typed, from everything that the terminal shows: bytes, the end of the line included;
/// nothing: wait for more. Called whenever something was shown.
using Typist = std::function<std::optional<std::string>(const std::string& shown)>;

/// The program at a terminal, and a person who types.
inline Typed type_at_terminal(const std::vector<std::string>& arguments, const std::filesystem::path& folder,
                              const Typist& typist,
                              const std::map<std::string, std::string>& environment = {}) {
  int terminal = -1;
  const pid_t child = ::forkpty(&terminal, nullptr, nullptr, nullptr);
  if (child == 0) {
    if (::chdir(folder.c_str()) != 0) ::_exit(126);
    for (const auto& [name, value] : environment) ::setenv(name.c_str(), value.c_str(), 1);
    const std::string program = abcal_program();
    std::vector<std::string> words{program};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    ::execv(program.c_str(), argv.data());
    ::_exit(127);
  }
  Typed typed;
  std::array<char, 512> bytes{};
  for (ssize_t n = 0; (n = ::read(terminal, bytes.data(), bytes.size())) > 0;) {
    typed.shown.append(bytes.data(), static_cast<std::size_t>(n));
    const std::optional<std::string> line = typist(typed.shown);
    if (line && ::write(terminal, line->data(), line->size()) < 0) break;
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  ::close(terminal);
  typed.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return typed;
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
