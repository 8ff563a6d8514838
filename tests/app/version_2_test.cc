// Run files of version 2 through the program: analysed to the digits that abcal 0.1 gave, verified, reported,
// replayed.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/app/program_fixtures.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::HasSubstr;
using Json = nlohmann::json;

class Version2RunTest : public ProgramTest, public testing::WithParamInterface<const char*> {
 protected:
  Version2RunTest() {
    using std::filesystem::perms;
    const std::string run = GetParam();
    for (const std::string& file : {run + ".run", run + ".run.results"}) {
      std::filesystem::copy_file(data / file, folder / file);
      const bool closed = file.ends_with(".run");
      std::filesystem::permissions(folder / file,
                                   closed ? perms::owner_read : perms::owner_read | perms::owner_write);
    }
  }
  std::string run() const { return std::string(GetParam()) + ".run"; }

  const std::filesystem::path data = test::source_folder() / "tests/data/version_2";
};

/// Every "value" below a node, in order.
void values_below(const Json& node, const char* key, std::vector<double>& values) {
  if (node.is_object() && node.contains(key) && node[key].is_number()) {
    values.push_back(node[key].get<double>());
  } else if (node.is_structured()) {
    for (const Json& child : node) values_below(child, key, values);
  }
}

TEST_P(Version2RunTest, IsAnalysedToTheResultOfVersion01) {
  const test::ProgramResult result = abcal({"analyse", run(), "--json", "--estimator", "abc"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Json now = Json::parse(result.out);
  const Json then = Json::parse(test::read_file(data / (std::string(GetParam()) + ".abc.json")));
  for (const char* group : {"sensitivity_matrix", "offset", "intrinsic_sensitivity", "intrinsic_angle"}) {
    std::vector<double> a, b, u;
    values_below(now.at(group), "value", a);
    values_below(then.at(group), "value", b);
    values_below(now.at(group), "standard_uncertainty", u);
    ASSERT_EQ(a.size(), b.size());
    ASSERT_GE(a.size(), 3U);
    // The readings are the same to the last digit (record_test). The result is now the line response: ABC is
    // corrected by its own harmonics, and step errors come in with them, by a fraction of the uncertainty
    // that was stated.
    for (std::size_t k = 0; k < a.size(); ++k) EXPECT_NEAR(a[k], b[k], u.at(k)) << group << " " << k;
  }
}

TEST_P(Version2RunTest, IsVerifiedAndReported) {
  const test::ProgramResult verified = abcal({"verify", run()});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out, HasSubstr("follow from"));
  const test::ProgramResult report = abcal({"report", run(), "--html", "a.html", "--csv", "a.csv"});
  EXPECT_EQ(report.exit_code, 0) << report.err;
  EXPECT_THAT(test::read_file(folder / "a.html"), HasSubstr("6284.123456"));
}

INSTANTIATE_TEST_SUITE_P(Files, Version2RunTest, testing::Values("complete", "resumed", "recorded"),
                         [](const auto& tested) { return std::string(tested.param); });

}  // namespace
}  // namespace abcal
