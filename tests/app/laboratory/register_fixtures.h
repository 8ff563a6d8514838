#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <string>

#include "app/laboratory/register/register.h"
#include "tests/support/postgresql_cluster.h"
#include "tests/support/temporary_folder.h"

namespace abcal::lab {

enum class Kind { kSqlite, kPostgresql };

inline std::string name_of(const testing::TestParamInfo<Kind>& info) {
  return info.param == Kind::kSqlite ? "Sqlite" : "Postgresql";
}

inline constexpr const char* kPassword = "correct horse 7";

/// The time 2026-03-01T12:00:00Z plus this number of seconds.
inline Clock::UtcTime at(int seconds) {
  using namespace std::chrono;
  return Clock::UtcTime(sys_days(year(2026) / March / 1).time_since_epoch() + hours(12) +
                        std::chrono::seconds(seconds));
}

/// The text of the exception of a call; empty: none.
template <class Call>
std::string refusal(const Call& call) {
  try {
    call();
  } catch (const RegisterError& error) {
    return error.what();
  }
  return {};
}

/// A test on an empty database of either kind. One server serves all tests of a program.
class OnDatabase : public testing::TestWithParam<Kind> {
 protected:
  void SetUp() override {
    if (GetParam() == Kind::kPostgresql && !test::PostgresqlCluster::programs())
      GTEST_SKIP() << "PostgreSQL is not installed";
    location = new_location();
  }

  std::string new_location() {
    if (GetParam() == Kind::kSqlite)
      return (folder / ("register-" + std::to_string(++count_) + ".db")).string();
    static test::PostgresqlCluster cluster;
    return cluster.make_database();
  }

  static NewRegister facts() {
    return {"Example laboratory", false, "EX-", "Admin N. N.", kPassword, PasswordCost::kForTests};
  }

  /// A register with an administrator (every right), an operator and an approver.
  Register with_people() {
    Register made = Register::create(location, facts(), at(0));
    const LoggedIn admin = login(made, "Admin N. N.");
    made.add_person(admin, {"Operator N. N.", "technician", "", {Right::kMeasure}, {}, {}}, kPassword, at(1),
                    PasswordCost::kForTests);
    made.add_person(admin, {"Approver N. N.", "head", "", {Right::kMeasure, Right::kApprove}, {}, {}},
                    kPassword, at(1), PasswordCost::kForTests);
    return made;
  }
  static LoggedIn login(Register& in, const std::string& name, int when = 2) {
    return in.who(in.log_in(name, kPassword, at(when), std::chrono::hours(8)), at(when));
  }
  static std::string bad(Register& in) {
    std::string words;
    for (const RegisterFinding& finding : in.verify())
      if (!finding.good) words += finding.what + ": " + finding.found + "\n";
    return words;
  }

  test::TemporaryFolder folder;
  std::string location;

 private:
  int count_ = 0;
};

#define ABCAL_ON_BOTH_DATABASES(suite) \
  INSTANTIATE_TEST_SUITE_P(OnBothDatabases, suite, testing::Values(Kind::kSqlite, Kind::kPostgresql), name_of)

}  // namespace abcal::lab
