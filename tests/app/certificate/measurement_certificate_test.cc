// The certificate of a measurement of several runs.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "app/laboratory/certificate/dcc_xml.h"
#include "app/laboratory/certificate/report_certificate.h"
#include "protocol/record/results_file.h"
#include "protocol/record/sha256.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

/// Two runs of one item, the second one turned by 90 degrees about X, and a training register.
class MeasurementCertificateTest : public CertificateTest {
 protected:
  static void SetUpTestSuite() {
    shared_ = new test::TemporaryFolder;
    measure(
        bench_of("x y z", "[[1.0021, -0.0047, 0.0037], [0.0069, 0.9982, 0.0086], [-0.0117, 0.0064, 1.0009]]"),
        "a.run", *shared_);
    measure(bench_of("x -z y",
                     "[[1.0021, 0.0037, 0.0047], [0.0069, 0.0086, -0.9982], [-0.0117, 1.0009, -0.0064]]"),
            "b.run", *shared_);
    const auto combined =
        test::run_program({"combine", "a.run", "b.run", "-o", "m.measurement"}, shared_->path());
    ASSERT_EQ(combined.exit_code, 0) << combined.err;
    ASSERT_THAT(combined.out, HasSubstr("Result: usable")) << combined.out;
  }
  static void TearDownTestSuite() {
    delete shared_;
    shared_ = nullptr;
  }
  void SetUp() override {
    for (const auto& entry : std::filesystem::directory_iterator(shared_->path()))
      std::filesystem::copy_file(entry.path(), folder / entry.path().filename().string());
    test::write_file(folder / "lab.toml", example_laboratory());
  }
  CertificateRequest request() {
    CertificateRequest asked;
    asked.laboratory = parse_laboratory_file(example_laboratory(), "lab.toml");
    asked.run = gather_report(folder / "m.measurement", any_time());
    asked.together = gather_runs(asked.run, any_time());
    return asked;
  }

 private:
  static std::string bench_of(const std::string& mounting, const std::string& matrix) {
    std::string bench = replaced(certificate_bench(), "range = \"8 g\"\n",
                                 "range = \"8 g\"\nmounting = \"" + mounting + "\"\n");
    bench = replaced(bench, "[protocol]\n", "[protocol]\nestimator = \"joint\"\n");
    bench =
        replaced(bench, "[simulation]\n", "[item_uncertainty]\ndrift_between_runs = 2e-6\n[simulation]\n");
    return replaced(bench, "[[1.0021, -0.0047, 0.0037], [0.0069, 0.9982, 0.0086], [-0.0117, 0.0064, 1.0009]]",
                    matrix);
  }
  static inline test::TemporaryFolder* shared_ = nullptr;
};

TEST_F(MeasurementCertificateTest, NamesItsRunsAndIsKeptWithTheMeasurement) {
  const test::TrainingRegister registered(folder.path());
  const auto issued = abcal({"issue", "m.measurement", "--laboratory", "lab.toml", "--dcc", "a.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const CertificateXml xml(test::read_file(folder / "a.xml"));
  EXPECT_EQ(xml.text("//dcc:metaData[@refType='abc_rawDataHash']//dcc:data//dcc:content"),
            sha256_of_file(folder / "m.measurement"));
  const std::string of_run = "//dcc:metaData[@refType='abc_runHash']";
  EXPECT_EQ(xml.text("(" + of_run + ")[1]//dcc:data//dcc:content"), sha256_of_file(folder / "a.run"));
  EXPECT_EQ(xml.text("(" + of_run + ")[2]//dcc:data//dcc:content"), sha256_of_file(folder / "b.run"));
  EXPECT_THAT(
      xml.text("//dcc:statement[@refType='abc_runs']/dcc:declaration//dcc:content"),
      AllOf(HasSubstr("readings of 2 runs"), HasSubstr("a.run: begun 20"), HasSubstr("as in the first run"),
            HasSubstr("turned by 90 degrees about"), HasSubstr("by Operator N. N.")));
  EXPECT_EQ(ResultsFile::certificates(folder / "m.measurement").size(), 1U);
  const auto verified = abcal({"verify", "m.measurement"});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out, HasSubstr("register, certificate T-"));
  const auto page = abcal({"report", "m.measurement"});
  EXPECT_THAT(page.out, AllOf(HasSubstr("TRAINING"), HasSubstr("Runs evaluated together")));
}

TEST_F(MeasurementCertificateTest, RestsOnAStatedChangeBetweenRuns) {
  EXPECT_EQ(refusal(request()), "");
  CertificateRequest unstated = request();
  unstated.run.record.tolerances.sources.erase("drift_between_runs");
  EXPECT_THAT(refusal(std::move(unstated)),
              HasSubstr("drift_between_runs: found nothing; required: by how much"));
  // A problem of one of the runs is one of the certificate.
  CertificateRequest doubtful = request();
  doubtful.together.back().run->environment.clear();
  EXPECT_THAT(refusal(std::move(doubtful)), HasSubstr("run \"b.run\", temperature of the room"));
}

// The item before its adjustment may have been measured in several runs, too: each is inspected and listed.
TEST_F(MeasurementCertificateTest, MayBeTheResultAsFound) {
  const auto adjusted = [&] {
    CertificateRequest asked = request();
    asked.laboratory = parse_laboratory_file(
        replaced(example_laboratory(), "deviations = \"\" ", "adjustment = \"set\" "), "lab.toml");
    asked.as_found = asked.run;
    asked.together_as_found = gather_runs(*asked.as_found, any_time());
    return asked;
  };
  CertificateRequest unstated = adjusted();
  unstated.as_found->record.tolerances.sources.erase("drift_between_runs");
  EXPECT_THAT(refusal(std::move(unstated)), HasSubstr("drift_between_runs"));
  CertificateRequest doubtful = adjusted();
  doubtful.together_as_found.front().run->environment.clear();
  EXPECT_THAT(refusal(std::move(doubtful)), HasSubstr("run \"a.run\", temperature of the room"));
  const CertificateXml xml(xml_text(dcc_document(make_certificate(adjusted()))));
  EXPECT_EQ(xml.texts("//dcc:statement[@refType='abc_runs']").size(), 2U);
  EXPECT_EQ(xml.texts("//dcc:metaData[@refType='abc_runHash']").size(), 4U);
}

TEST_F(MeasurementCertificateTest, IsNotIssuedOfARunThatWasChanged) {
  const test::TrainingRegister registered(folder.path());
  std::filesystem::permissions(folder / "b.run", std::filesystem::perms::owner_write,
                               std::filesystem::perm_options::add);
  std::ofstream(folder / "b.run", std::ios::app) << "x";
  const auto issued = abcal({"issue", "m.measurement", "--laboratory", "lab.toml"});
  EXPECT_NE(issued.exit_code, 0);
  EXPECT_THAT(issued.err, HasSubstr("b.run was changed after the measurement was made"));
}

}  // namespace
}  // namespace abcal
