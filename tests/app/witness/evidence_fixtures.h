#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <string>

#include "protocol/record/results_file.h"
#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/support/forged_chain.h"

namespace abcal {

/// A run that a test may do anything to.
class EvidenceTest : public CertificateTest {
 protected:
  void SetUp() override { path = folder / own_run(); }

  std::filesystem::path results() const { return ResultsFile::path_beside(path); }

  /// Changes a closed run, as anyone with write access can.
  void change(const std::string& sql) const {
    std::filesystem::permissions(path, std::filesystem::perms::owner_write,
                                 std::filesystem::perm_options::add);
    SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).execute(sql);
  }

  /// Changes a run and makes the chain of its dwells again.
  void rebuild_chain(const std::string& sql) const {
    change(sql);
    test::rebuild_chain(path);
  }

  /// Changes a run and makes everything that depends on it again: chain of dwells, seal, the hash in the
  /// results, the analyses. The means have to be changed by `sql`.
  void forge(const std::string& sql) const {
    rebuild_chain(sql);
    {
      SqliteDatabase kept(results(), SqliteDatabase::Mode::kReadWrite);
      kept.execute("delete from analysis");
      kept.prepare("update run set sha256 = :hash").set("hash", std::string_view(sha256_of_file(path))).run();
    }
    EXPECT_EQ(test::run_program({"analyse", path.filename().string()}, folder.path()).exit_code, 0);
  }

  std::filesystem::path path;
};

/// Readings and means of output u 5e-4 larger: stated values still follow from the stored readings.
inline constexpr const char* kLargerU =
    "update reading set u = u * 1.0005; update dwell set r_u = r_u * 1.0005, spread_u = spread_u * 1.0005,"
    " u_u = u_u * 1.0005";

}  // namespace abcal
