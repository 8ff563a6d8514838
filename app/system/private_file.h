#pragma once

#include <filesystem>
#include <string>

namespace abcal {

/// Makes a file that only its owner can read, and flushes it to the disk. It must not exist.
/// @throws std::runtime_error
void write_private_file(const std::filesystem::path& path, const std::string& content);

/// The content of a file with a secret, which only its owner may read or change.
/// @param kind  name in messages: "key", "password"
/// @throws std::invalid_argument
std::string read_private_file(const std::filesystem::path& path, const std::string& kind);

}  // namespace abcal
