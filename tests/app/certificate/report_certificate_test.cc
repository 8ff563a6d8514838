// `abcal report` with a certificate: its files, and its refusals.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "app/laboratory/certificate/issue_certificate.h"
#include "protocol/record/sqlite.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class ReportCertificateTest : public CertificateTest {
 protected:
  void SetUp() override {
    run = own_run();
    test::write_file(folder / "lab.toml", example_laboratory());
  }
  bool shell(const std::string& command) const {
    return std::system(("cd '" + folder.path().string() + "' && " + command + " > log 2>&1").c_str()) == 0;
  }
  void change_run(const std::string& sql) {
    std::filesystem::permissions(folder / run, std::filesystem::perms::owner_write,
                                 std::filesystem::perm_options::add);
    SqliteDatabase(folder / run, SqliteDatabase::Mode::kReadWrite).execute(sql);
  }
  std::string run;
};

TEST_F(ReportCertificateTest, WithoutALaboratoryFileThereIsNoCertificate) {
  const auto result = abcal({"report", run, "--dcc", "a.xml"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, HasSubstr("--laboratory"));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.xml"));
}

TEST_F(ReportCertificateTest, ADraftUntilItIsIssuedAndTheSameBytesEverAfter) {
  const auto draft =
      abcal({"report", run, "--dcc", "draft.xml", "--html", "draft.html", "--laboratory", "lab.toml"});
  ASSERT_EQ(draft.exit_code, 0) << draft.err;
  EXPECT_THAT(test::read_file(folder / "draft.xml"), HasSubstr("DRAFT: this certificate is not issued"));
  EXPECT_THAT(test::read_file(folder / "draft.html"),
              AllOf(HasSubstr("Calibration certificate"), HasSubstr("DRAFT"), HasSubstr("Example customer"),
                    HasSubstr("guard band"), HasSubstr("Metrological traceability")));
  EXPECT_EQ(abcal({"report", run, "--dcc", "draft.xml", "--laboratory", "lab.toml"}).exit_code, 2);

  const test::TrainingRegister registered(folder.path());
  const auto issued = abcal({"issue", run, "--laboratory", "lab.toml", "--dcc", "issued.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::string number = test::number_of(issued.out);
  // The laboratory file may be gone by then.
  std::filesystem::remove(folder / "lab.toml");
  const auto again = abcal({"report", run, "--dcc", "again.xml", "--html", "again.html"});
  ASSERT_EQ(again.exit_code, 0) << again.err;
  EXPECT_EQ(test::read_file(folder / "again.xml"), test::read_file(folder / "issued.xml"));
  EXPECT_THAT(test::read_file(folder / "again.html"),
              AllOf(HasSubstr(number), HasSubstr("TRAINING"), Not(HasSubstr("DRAFT"))));
  EXPECT_THAT(abcal({"report", run}).out, HasSubstr(number));
}

TEST_F(ReportCertificateTest, ThePdfHasTheXmlInside) {
  if (!shell("command -v weasyprint && command -v pdfdetach"))
    GTEST_SKIP() << "weasyprint or pdfdetach (poppler-utils) is not installed";
  const auto result = abcal({"report", run, "--pdf", "a.pdf", "--dcc", "a.xml", "--laboratory", "lab.toml"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  ASSERT_TRUE(shell("pdfdetach -save 1 -o inside.xml a.pdf")) << test::read_file(folder / "log");
  EXPECT_EQ(test::read_file(folder / "inside.xml"), test::read_file(folder / "a.xml"));
}

TEST_F(ReportCertificateTest, AnIncompleteRunGivesADraftOnly) {
  change_run("update meta set value = 'interrupted' where key = 'state'");
  const auto refused = abcal({"report", run, "--dcc", "a.xml", "--laboratory", "lab.toml"});
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err,
              AllOf(HasSubstr("interrupted"), HasSubstr("a complete run"), HasSubstr("--draft")));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.xml"));
  const auto draft = abcal({"report", run, "--dcc", "a.xml", "--laboratory", "lab.toml", "--draft"});
  ASSERT_EQ(draft.exit_code, 0) << draft.err;
  EXPECT_THAT(test::read_file(folder / "a.xml"),
              AllOf(HasSubstr("DRAFT-open"), HasSubstr("required: a complete run"),
                    HasSubstr("the run is not closed")));
}

TEST_F(ReportCertificateTest, AChangedRunGivesNothing) {
  change_run("update dwell set r_u = r_u + 1e-7 where id = 1");
  for (const char* draft : {"--html=a.html", "--draft"}) {
    const auto refused = abcal({"report", run, "--dcc", "a.xml", "--laboratory", "lab.toml", draft});
    EXPECT_EQ(refused.exit_code, 1) << draft;
    EXPECT_THAT(refused.err, HasSubstr("gives no result")) << draft;
    EXPECT_FALSE(std::filesystem::exists(folder / "a.xml")) << draft;
  }
}

TEST_F(ReportCertificateTest, AsFoundAndAsLeftAreTwoResultsOfOneCertificate) {
  // The same bench later, with the offset removed, is the as-left state.
  std::string bench =
      replaced(certificate_bench(), "offset = [0.01, 0.02, 0.03]", "offset = [0.0, 0.0, 0.0]");
  measure(bench, "left.run", folder);
  test::write_file(folder / "lab.toml", replaced(example_laboratory(), "deviations = \"\" ",
                                                 "adjustment = \"offset registers set\" "));
  std::vector<std::string> words{"report", "left.run", "--as-found",   run,
                                 "--dcc",  "pair.xml", "--laboratory", "lab.toml"};
  if (const auto schemas = test::shared_data("dcc/xsd"))
    words.insert(words.end(), {"--schemas", schemas->string()});
  const auto result = abcal(words);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const CertificateXml xml(test::read_file(folder / "pair.xml"));
  EXPECT_EQ(xml.texts("//dcc:measurementResult").size(), 2U);
  EXPECT_EQ(xml.text("//dcc:measurementResult[1]//dcc:status"), "beforeAdjustment");
  const auto shift = xml.numbers(
      "//dcc:quantity[@refType='abc_difference'][dcc:name/dcc:content='offset_w']/si:hybrid/si:real[1]/"
      "si:value");
  EXPECT_NEAR(shift.at(0), -0.03 * 9.80665, 2e-3);  // noise 1e-4 g and step errors of 0.005 degrees
}

}  // namespace
}  // namespace abcal
