#include "app/certificate/issue.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"
#include "protocol/record/verify.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class IssueTest : public CertificateTest {
 protected:
  void SetUp() override {
    run = own_run();
    test::write_file(folder / "lab.toml", example_laboratory());
  }
  std::vector<std::string> issue(const std::string& number, std::vector<std::string> more = {}) const {
    std::vector<std::string> words{"issue", run, "--laboratory", "lab.toml", "--number", number};
    if (std::find(more.begin(), more.end(), "--approved-by") == more.end())
      words.insert(words.end(), {"--approved-by", "Approver N. N."});
    words.insert(words.end(), more.begin(), more.end());
    return words;
  }
  std::string run;
};

TEST_F(IssueTest, AnIssuedCertificateIsKeptAndVerified) {
  const auto result = abcal(issue("EX-1", {"--dcc", "a.xml", "--date", "2999-01-02"}));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("certificate EX-1 of 2999-01-02: measured by Operator N. N., approved by "
                                    "Approver N. N."));
  const std::string xml = test::read_file(folder / "a.xml");
  EXPECT_THAT(xml, Not(HasSubstr("DRAFT")));
  const CertificateXml query(xml);
  EXPECT_EQ(query.text("//dcc:uniqueIdentifier"), "EX-1");
  EXPECT_EQ(query.text("//dcc:issueDate"), "2999-01-02");
  EXPECT_EQ(query.text("//dcc:respPerson[dcc:mainSigner='true']//dcc:name/dcc:content"), "Approver N. N.");
  EXPECT_EQ(query.text("//dcc:metaData[@refType='abc_rawDataHash']//dcc:data//dcc:content"),
            sha256_of_file(folder / run));

  const auto kept = ResultsFile::certificates(folder / run);
  ASSERT_EQ(kept.size(), 1U);
  EXPECT_EQ(kept[0].xml, xml);
  EXPECT_EQ(kept[0].laboratory_toml, example_laboratory());
  const auto verified = abcal({"verify", run});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out, HasSubstr("certificates: 1 entries"));
}

TEST_F(IssueTest, ANumberIsGivenOnceAndARunHasOneCertificate) {
  ASSERT_EQ(abcal(issue("EX-1")).exit_code, 0);
  EXPECT_THAT(abcal(issue("EX-1")).err, HasSubstr("EX-1 was issued on"));
  const auto second = abcal(issue("EX-2"));
  EXPECT_EQ(second.exit_code, 1);
  EXPECT_THAT(second.err, HasSubstr("amend it with --replaces EX-1"));
  EXPECT_EQ(ResultsFile::certificates(folder / run).size(), 1U);
}

TEST_F(IssueTest, AnAmendmentNamesWhatItReplacesAndWhy) {
  ASSERT_EQ(abcal(issue("EX-1", {"--dcc", "a.xml"})).exit_code, 0);
  EXPECT_EQ(abcal(issue("EX-2", {"--replaces", "EX-1"})).exit_code, 2);
  const auto amended =
      abcal(issue("EX-2", {"--replaces", "EX-1", "--reason", "customer's address", "--dcc", "b.xml"}));
  ASSERT_EQ(amended.exit_code, 0) << amended.err;
  const CertificateXml query(test::read_file(folder / "b.xml"));
  EXPECT_EQ(query.text("//dcc:reportAmendedSubstituted/dcc:typeOfChange"), "amended");
  EXPECT_EQ(query.text("//dcc:reportAmendedSubstituted/dcc:replacedUniqueIdentifier"), "EX-1");
  EXPECT_EQ(query.text("//dcc:previousReport/dcc:value"), sha256_of_file(folder / "a.xml"));
  EXPECT_THAT(query.text("//dcc:statement[@refType='abc_amendment']"), HasSubstr("customer's address"));
  EXPECT_THAT(abcal(issue("EX-3", {"--replaces", "EX-1", "--reason", "again"})).err,
              HasSubstr("EX-1 is replaced by EX-2 already"));
  EXPECT_THAT(abcal(issue("EX-3", {"--replaces", "EX-0", "--reason", "other"})).err,
              HasSubstr("--replaces EX-2"));
}

TEST_F(IssueTest, WhoMeasuredCannotApprove) {
  const auto self =
      abcal(issue("EX-1", {"--approved-by", "Approver N. N.", "--measured-by", "Approver N. N."}));
  EXPECT_EQ(self.exit_code, 1);
  EXPECT_THAT(self.err, HasSubstr("a person other than the one who measured"));
  const auto stranger = abcal(issue("EX-1", {"--approved-by", "Nobody"}));
  EXPECT_THAT(stranger.err, AllOf(HasSubstr("\"Nobody\""), HasSubstr("who may approve")));
  EXPECT_THAT(abcal(issue("EX-1", {"--approved-by", "Operator N. N."})).err, HasSubstr("who may approve"));
  EXPECT_TRUE(ResultsFile::certificates(folder / run).empty());
}

TEST_F(IssueTest, AllThatIsWrongIsSaidTogetherAndNothingIsWritten) {
  std::string laboratory = example_laboratory();
  laboratory = replaced(laboratory, "condition = \"no visible damage\"", "condition = \"\"");
  laboratory = replaced(laboratory, "due = 2030-12-31", "due = 1999-12-31");
  laboratory = replaced(laboratory, "unit = \"g/g_loc\"", "unit = \"V/g_loc\"");
  laboratory = replaced(laboratory, "sensitivity = [\"mg/g\"]", "sensitivity = [\"mV/g\"]");
  test::write_file(folder / "lab.toml", laboratory);
  const std::string before = sha256_of_file(folder / (run + ".results"));
  const auto refused = abcal(issue("EX-1", {"--dcc", "a.xml"}));
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, AllOf(HasSubstr("[job] condition"), HasSubstr("due"), HasSubstr("1999-12-31"),
                                 HasSubstr("one of \"g/g_loc\", \"g/(m/s2)\""), HasSubstr("mV/g")))
      << refused.err;
  EXPECT_FALSE(std::filesystem::exists(folder / "a.xml"));
  EXPECT_EQ(sha256_of_file(folder / (run + ".results")), before);
}

TEST_F(IssueTest, AChangedCertificateIsFound) {
  ASSERT_EQ(abcal(issue("EX-1")).exit_code, 0);
  ASSERT_EQ(abcal(issue("EX-2", {"--replaces", "EX-1", "--reason", "why"})).exit_code, 0);
  for (const std::string sql :
       {"update certificate set xml = replace(xml, 'no visible', 'visible') where id = 1",
        "update certificate set reason = 'another' where id = 2",
        "update certificate set approved_by = 'X' where id = 1", "delete from certificate where id = 1"}) {
    std::filesystem::copy_file(folder / (run + ".results"), folder / "kept");
    SqliteDatabase(folder / (run + ".results"), SqliteDatabase::Mode::kReadWrite).execute(sql);
    const auto verified = abcal({"verify", run});
    EXPECT_EQ(verified.exit_code, 1) << sql;
    EXPECT_THAT(verified.out, HasSubstr("bad  certificates")) << sql;
    std::filesystem::rename(folder / "kept", folder / (run + ".results"));
  }
  EXPECT_EQ(abcal({"verify", run}).exit_code, 0);
}

TEST_F(IssueTest, ARunThatWasChangedGetsNoCertificate) {
  std::filesystem::permissions(folder / run, std::filesystem::perms::owner_write,
                               std::filesystem::perm_options::add);
  SqliteDatabase(folder / run, SqliteDatabase::Mode::kReadWrite)
      .execute("update dwell set r_u = r_u + 1e-6 where id = 1");
  const auto refused = abcal(issue("EX-1"));
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err, HasSubstr("SHA-256"));
}

TEST_F(IssueTest, ASignatureIsVerifiedByXmlsec1) {
  const auto shell = [&](const std::string& command) {
    return std::system(("cd '" + folder.path().string() + "' && " + command + " > log 2>&1").c_str());
  };
  if (shell("command -v xmlsec1 && command -v openssl") != 0)
    GTEST_SKIP() << "xmlsec1 or openssl is not installed";
  const std::string subject = "-subj '/O=Example laboratory/CN=example.org' -days 30 -nodes -x509";
  ASSERT_EQ(shell("openssl req -newkey rsa:2048 -keyout key.pem -out cert.pem " + subject), 0);
  ASSERT_EQ(shell("openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -keyout ec.pem -out ec-cert.pem " +
                  subject),
            0);
  std::vector<std::string> schema;
  if (const auto schemas = test::shared_data("dcc/xsd")) schema = {"--schemas", schemas->string()};
  const auto signing = [&](const std::string& key, const std::string& certificate,
                           std::vector<std::string> more) {
    more.insert(more.end(), {"--sign", key, "--certificate", certificate, "--dcc", key + ".xml"});
    more.insert(more.end(), schema.begin(), schema.end());
    return more;
  };

  EXPECT_THAT(abcal(issue("EX-1", signing("key.pem", "ec-cert.pem", {}))).err,
              HasSubstr("does not belong to the key"));
  EXPECT_THAT(abcal(issue("EX-1", signing("lab.toml", "cert.pem", {}))).err, HasSubstr("no private key"));
  EXPECT_TRUE(ResultsFile::certificates(folder / run).empty());

  ASSERT_EQ(abcal(issue("EX-1", signing("key.pem", "cert.pem", {}))).exit_code, 0);
  const auto second =
      abcal(issue("EX-2", signing("ec.pem", "ec-cert.pem", {"--replaces", "EX-1", "--reason", "why"})));
  ASSERT_EQ(second.exit_code, 0) << second.err;
  EXPECT_EQ(shell("xmlsec1 --verify --trusted-pem cert.pem key.pem.xml"), 0)
      << test::read_file(folder / "log");
  EXPECT_EQ(shell("xmlsec1 --verify --trusted-pem ec-cert.pem ec.pem.xml"), 0)
      << test::read_file(folder / "log");
  // One digit changed, and it does not verify any more.
  const std::string xml = test::read_file(folder / "key.pem.xml");
  test::write_file(folder / "changed.xml", replaced(xml, "EX-1", "EX-7"));
  EXPECT_NE(shell("xmlsec1 --verify --trusted-pem cert.pem changed.xml"), 0);
  EXPECT_EQ(abcal({"verify", run}).exit_code, 0);
}

}  // namespace
}  // namespace abcal
