#pragma once

#include <cstddef>
#include <filesystem>
#include <limits>
#include <string>

namespace abcal {

/// All bytes of a file.
/// @param most  a larger file is refused before it is read
/// @throws std::invalid_argument if it is absent, a folder, cannot be read, or is larger
std::string read_file(const std::filesystem::path& path,
                      std::size_t most = std::numeric_limits<std::size_t>::max());

}  // namespace abcal
