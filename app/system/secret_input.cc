#include "app/system/secret_input.h"

#include <fmt/format.h>
#include <termios.h>
#include <unistd.h>

#include <iostream>
#include <optional>
#include <stdexcept>

#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/private_file.h"

namespace abcal {
namespace {

/// Switches the echo of the terminal off for the lifetime of this object.
class NoEcho {
 public:
  NoEcho() : changed_(::tcgetattr(STDIN_FILENO, &before_) == 0) {
    if (!changed_) return;
    termios silent = before_;
    silent.c_lflag &= ~static_cast<tcflag_t>(ECHO);
    shown_again_.emplace([shown = before_] { ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &shown); });
    changed_ = ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &silent) == 0;
  }
  NoEcho(const NoEcho&) = delete;
  NoEcho& operator=(const NoEcho&) = delete;
  ~NoEcho() {
    if (changed_) ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &before_);
  }

 private:
  termios before_{};
  bool changed_ = false;
  std::optional<BeforeSignalEnds> shown_again_;
};

std::string secret_of_file(const std::string& path) {
  const std::string text = read_private_file(path, "password");
  std::string secret = text.substr(0, text.find('\n'));
  if (secret.empty()) throw std::invalid_argument(path + ": its first line is empty; required: the password");
  return secret;
}

/// A line of standard input: typed behind a prompt and not shown, or unchanged if that is not a terminal.
std::string secret_line(const std::string& prompt) {
  std::string secret;
  if (::isatty(STDIN_FILENO) == 0) {
    std::getline(std::cin, secret);
  } else {
    const NoEcho silent;
    print_log("{}: ", prompt);
    std::getline(std::cin, secret);
    print_log("\n");
  }
  if (secret.empty()) throw std::invalid_argument(prompt + ": nothing was given");
  return secret;
}

}  // namespace

std::string read_secret(const std::string& prompt, const std::string& file) {
  return file.empty() ? secret_line(prompt) : secret_of_file(file);
}

std::string read_new_secret(const std::string& prompt, const std::string& rule, const std::string& file) {
  if (!file.empty() || ::isatty(STDIN_FILENO) == 0) return read_secret(prompt, file);
  std::string secret = secret_line(fmt::format("{} ({})", prompt, rule));
  if (secret_line("once more") != secret)
    throw std::invalid_argument(prompt + ": the two are not the same; nothing is changed, try again");
  return secret;
}

}  // namespace abcal
