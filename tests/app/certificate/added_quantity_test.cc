// A quantity is described once, in protocol/quantities: one that this test adds appears in every output.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "app/document/document_html.h"
#include "app/document/document_text.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/dcc_xml.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/result_json.h"
#include "app/results/analysis/result_summary.h"
#include "app/results/analysis/result_text.h"
#include "app/results/export/formats.h"
#include "app/results/report/calibration_document.h"
#include "app/results/report/record_hdf5.h"
#include "app/system/helper_program.h"
#include "protocol/quantities/output_names.h"
#include "protocol/quantities/quantity_groups.h"
#include "tests/app/certificate/certificate_fixtures.h"

namespace abcal {
namespace {

using testing::HasSubstr;

/// Mean of the three sensitivities: no output of the program.
QuantityGroup mean_sensitivity() {
  return {.key = "mean_sensitivity",
          .heading = "Mean of the sensitivities",
          .meaning = "mean of the sensitivities of U, V, W",
          .kind = QuantityKind::kOutput,
          .frame = QuantityFrame::kItem,
          .symbols = {"s_mean"},
          .columns = 1,
          .values = [](const CalibrationResult& result) {
            Quantity mean = result.intrinsic_sensitivity[0];
            mean.value = 1.25;
            return std::vector<Quantity>{mean};
          }};
}

class AddedQuantityTest : public CertificateTest {
 protected:
  AddedQuantityGroup added{mean_sensitivity()};
  ReportData data = gather_report(shared_run(), any_time());
};

TEST_F(AddedQuantityTest, IsInTheJsonWithItsDescription) {
  const nlohmann::json json = result_json(data.result());
  EXPECT_EQ(json.at("mean_sensitivity").at(0).at("value"), 1.25);
  const nlohmann::json& about = json.at("quantities").back();
  EXPECT_EQ(about.at("key"), "mean_sensitivity");
  EXPECT_EQ(about.at("path"), "/mean_sensitivity");
  EXPECT_EQ(about.at("symbols"), nlohmann::json({"s_mean"}));
}

TEST_F(AddedQuantityTest, IsInBothTextsOfATerminal) {
  EXPECT_THAT(result_text(data.result(), stdout), HasSubstr("Mean of the sensitivities\n  s_mean"));
  const AnalysedRun run = analyse_run(RunFile::load_items(shared_run()), "joint");
  EXPECT_THAT(summary_text(run, "a.run", stdout), HasSubstr("Mean of the sensitivities +- U\n  s_mean"));
}

TEST_F(AddedQuantityTest, IsOnTheFirstPageAndAmongTheValuesOfTheReport) {
  const std::string html = document_html(calibration_document(data));
  const std::size_t first = html.find("Mean of the sensitivities");
  ASSERT_NE(first, std::string::npos);
  EXPECT_NE(html.find("Mean of the sensitivities", first + 1), std::string::npos);
}

TEST_F(AddedQuantityTest, IsInHdf5) {
  std::ostringstream tree;
  write_hdf5_tree(std::vector{data}, "a.h5", tree);
  EXPECT_THAT(tree.str(), HasSubstr("/entry/result_joint/mean_sensitivity"));
  EXPECT_THAT(tree.str(), HasSubstr("/entry/result_joint/mean_sensitivity_errors"));
}

TEST_F(AddedQuantityTest, IsInTheConstantsOfOtherPrograms) {
  set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
  const CorrectionConstants constants = constants_of(data.result(), ExportFrame::kItem);
  EXPECT_EQ(
      nlohmann::json::parse(export_format("json").write(constants)).at("outputs").at("s_mean").at("value"),
      1.25);
  EXPECT_THAT(export_format("csv").write(constants), HasSubstr("\ns_mean,1.25,"));
  EXPECT_THAT(export_format("mat").write(constants), HasSubstr("s_mean"));
}

TEST_F(AddedQuantityTest, IsInTheCertificateAndOnItsPages) {
  const std::string xml = xml_text(dcc_document(make_certificate(request())));
  EXPECT_THAT(xml, HasSubstr("refType=\"abc_meanSensitivity\""));
  EXPECT_THAT(document_text(certificate_page(xml), stdout), HasSubstr("Mean of the sensitivities"));
}

// The table itself: every symbol, key and place in JSON once, every number of symbols that of the values.
TEST_F(AddedQuantityTest, GroupsAreDescribedOnce) {
  std::set<std::string> keys, paths, symbols;
  for (const QuantityGroup& group : quantity_groups()) {
    EXPECT_TRUE(keys.insert(group.key).second) << group.key;
    EXPECT_TRUE(paths.insert(group.path()).second) << group.key;
    for (const std::string& symbol : group.symbols) EXPECT_TRUE(symbols.insert(symbol).second) << symbol;
    const std::vector<Quantity> values = group.values(data.result());
    EXPECT_TRUE(values.empty() || values.size() == group.symbols.size()) << group.key;
  }
  for (const std::string_view symbol : kOutputSymbols) EXPECT_TRUE(symbols.contains(std::string(symbol)));
}

}  // namespace
}  // namespace abcal
