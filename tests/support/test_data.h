#pragma once

#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "tests/support/project_paths.h"

namespace abcal::test {

/// The path of a file or folder of the shared data set: in the folder named by ABCAL_TEST_DATA, else in
/// ../shared/data next to the project. Nothing if it is absent: skip the test and say so.
inline std::optional<std::filesystem::path> shared_data(std::string_view relative) {
  const char* named = std::getenv("ABCAL_TEST_DATA");
  const std::filesystem::path root =
      named != nullptr ? std::filesystem::path(named) : source_folder() / ".." / "shared" / "data";
  std::filesystem::path path = root / relative;
  if (!std::filesystem::exists(path)) return std::nullopt;
  return path;
}

}  // namespace abcal::test

/// Binds `variable` to a file of the shared data set, or skips the test with the reason.
#define ABCAL_SHARED_DATA_OR_SKIP(variable, relative)                                                     \
  const auto variable##_found = ::abcal::test::shared_data(relative);                                     \
  if (!variable##_found)                                                                                  \
    GTEST_SKIP() << "shared data file " << (relative) << " is absent; set ABCAL_TEST_DATA to its folder"; \
  const std::filesystem::path variable = *variable##_found
