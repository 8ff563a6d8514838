#pragma once

#include <string>

namespace abcal {

/// A secret that a person types, not shown, or the first line of standard input if that is not a terminal.
/// @param file  if not empty, its first line instead; it must be readable by its owner only
/// @throws std::invalid_argument, std::runtime_error
std::string read_secret(const std::string& prompt, const std::string& file);

/// As read_secret(), for a secret that is to be set: at a terminal the rule is printed first, and the secret
/// is typed twice.
/// @param rule  "at least 10 characters"
/// @throws std::invalid_argument if the two differ, and as read_secret()
std::string read_new_secret(const std::string& prompt, const std::string& rule, const std::string& file);

}  // namespace abcal
