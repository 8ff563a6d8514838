#pragma once

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>

#include "app/system/interrupt.h"

namespace abcal {

/// The folder for temporary files: TMPDIR or /tmp.
/// @throws std::runtime_error if it is none
inline std::filesystem::path temporary_place() {
  std::error_code error;
  std::filesystem::path place = std::filesystem::temp_directory_path(error);
  if (!error) return place;
  const char* stated = std::getenv("TMPDIR");
  throw std::runtime_error("TMPDIR: found \"" + std::string(stated != nullptr ? stated : "/tmp") +
                           "\", which is no folder; required: a folder for temporary files, or no TMPDIR");
}

/// A folder for the files that programs hand to each other, removed with them at the end.
class TemporaryFolder {
 public:
  /// @throws std::runtime_error if none can be made
  TemporaryFolder() {
    std::string pattern = (temporary_place() / "abcal-XXXXXX").string();
    if (::mkdtemp(pattern.data()) == nullptr)
      throw std::runtime_error("no temporary folder " + pattern + ": " + std::strerror(errno));
    path_ = pattern;
    removed_too_.emplace([folder = path_] { remove(folder); });
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() { remove(path_); }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  static void remove(const std::filesystem::path& folder) {
    std::error_code ignored;
    std::filesystem::remove_all(folder, ignored);
  }

  std::filesystem::path path_;
  std::optional<BeforeSignalEnds> removed_too_;
};

}  // namespace abcal
