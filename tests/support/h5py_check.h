#pragma once

#include <gtest/gtest.h>

#include <filesystem>

#include "tests/support/program.h"

namespace abcal::test {

/// Runs check.py of a folder by the system's Python, as h5py is a package of the system's: 0 is good, 77 says
/// that h5py is missing. For the end of a test, which is skipped then.
inline void check_with_h5py(const std::filesystem::path& folder) {
  Program python("/usr/bin/python3", {"check.py"}, folder);
  const int code = python.wait();
  if (code == 77) GTEST_SKIP() << "python3-h5py is not installed";
  EXPECT_EQ(code, 0) << python.err();
}

}  // namespace abcal::test
