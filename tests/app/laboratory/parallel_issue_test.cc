#include <gtest/gtest.h>

#include <memory>
#include <set>
#include <sstream>
#include <vector>

#include "protocol/record/sha256.h"
#include "tests/app/laboratory/register_fixtures.h"
#include "tests/support/program.h"

namespace abcal::lab {
namespace {

/// Several processes give `each` numbers each at the same time: all are different, none is lost, and the
/// audit is whole.
void issue_at_once(Register made, const std::filesystem::path& folder, int processes, int each) {
  std::vector<std::unique_ptr<test::Program>> running;
  for (int k = 0; k < processes; ++k)
    running.push_back(
        std::make_unique<test::Program>(ABCAL_ISSUE_NUMBERS,
                                        std::vector<std::string>{made.location(), "Approver N. N.", kPassword,
                                                                 std::to_string(k), std::to_string(each)},
                                        folder));
  std::set<std::string> numbers;
  for (const auto& program : running) {
    EXPECT_EQ(program->wait(), 0) << program->err();
    std::istringstream lines(program->out());
    std::string number, run;
    while (lines >> number >> run) {
      EXPECT_TRUE(numbers.insert(number).second) << number;
      const auto registered = made.certificates_of(sha256_of(run));
      ASSERT_EQ(registered.size(), 1U) << run;
      EXPECT_EQ(registered[0].number, number);
      EXPECT_EQ(registered[0].state, "issued");
      EXPECT_EQ(registered[0].xml_sha256, sha256_of("xml of " + run));
    }
  }
  const auto total = static_cast<std::size_t>(processes * each);
  EXPECT_EQ(numbers.size(), total);
  EXPECT_EQ(made.certificates().size(), total);
  // An entry has the time at which it was written, however long its process waited for others.
  for (const AuditEntry& entry : made.audit()) EXPECT_NE(entry.subject, kClock) << entry.what;
  for (const RegisterFinding& finding : made.verify())
    EXPECT_TRUE(finding.good) << finding.what << ": " << finding.found;
}

class ParallelIssueTest : public OnDatabase {};
ABCAL_ON_BOTH_DATABASES(ParallelIssueTest);
TEST_P(ParallelIssueTest, FourProcessesGiveFiveNumbersEach) {
  issue_at_once(with_people(), folder.path(), 4, 5);
}

class LongParallelIssueTest : public OnDatabase {};
INSTANTIATE_TEST_SUITE_P(LongOnBothDatabases, LongParallelIssueTest,
                         testing::Values(Kind::kSqlite, Kind::kPostgresql), name_of);
TEST_P(LongParallelIssueTest, EightProcessesGiveAHundredNumbersEach) {
  issue_at_once(with_people(), folder.path(), 8, 100);
}

}  // namespace
}  // namespace abcal::lab
