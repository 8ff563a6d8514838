#pragma once

#include <filesystem>
#include <string>

namespace abcal {

/// All bytes of a file. @throws std::invalid_argument  that it is not there or cannot be read
std::string bytes_of_file(const std::filesystem::path& path);

}  // namespace abcal
