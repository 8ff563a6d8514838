#include "app/system/read_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <stdexcept>

namespace abcal {

std::string read_file(const std::filesystem::path& path, std::size_t most) {
  std::ifstream file(path, std::ios::binary);
  std::string bytes;
  std::array<char, 65536> part{};
  // Piece by piece, because only a plain file reports its length.
  while (file && bytes.size() <= most) {
    file.read(part.data(), part.size());
    bytes.append(part.data(), static_cast<std::size_t>(file.gcount()));
  }
  if (!file.is_open() || file.bad() || std::filesystem::is_directory(path))
    throw std::invalid_argument(path.string() + ": no such file, or it cannot be read");
  if (bytes.size() > most)
    throw std::invalid_argument(
        fmt::format("{}: is larger than {} bytes; required: at most that", path.string(), most));
  return bytes;
}

}  // namespace abcal
