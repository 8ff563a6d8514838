#include "app/laboratory/certificate/issue_certificate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>

#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"
#include "protocol/record/verify_run.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

/// The simulated run of the suite, and a training register of its own: no other issues for simulated runs.
class IssueTest : public CertificateTest {
 protected:
  static void SetUpTestSuite() {
    CertificateTest::SetUpTestSuite();
    register_folder_ = new test::TemporaryFolder;
    template_ = new test::TrainingRegister(register_folder_->path());
    test::TrainingRegister::leave();
  }
  static void TearDownTestSuite() {
    delete template_;
    delete register_folder_;
    CertificateTest::TearDownTestSuite();
  }
  void SetUp() override {
    run = own_run();
    test::write_file(folder / "lab.toml", example_laboratory());
    registered.emplace(*template_, folder.path());
  }
  std::vector<std::string> issue(std::vector<std::string> more = {}) const {
    more.insert(more.begin(), {"issue", run, "--laboratory", "lab.toml"});
    return more;
  }
  /// Issues, and @returns the number.
  std::string issued(const std::vector<std::string>& more = {}) {
    const auto result = abcal(issue(more));
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return test::number_of(result.out);
  }
  std::string run;
  std::optional<test::TrainingRegister> registered;

 private:
  static inline test::TemporaryFolder* register_folder_ = nullptr;
  static inline test::TrainingRegister* template_ = nullptr;
};

TEST_F(IssueTest, AnIssuedCertificateIsKeptAndVerified) {
  const auto result = abcal(issue({"--dcc", "a.xml"}));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const std::string number = test::number_of(result.out);
  EXPECT_THAT(
      result.out,
      AllOf(HasSubstr("TRAINING: this certificate certifies nothing"),
            HasSubstr("measured by Operator N. N. (stated, not verified), approved by Approver N. N.")));
  EXPECT_THAT(number, testing::MatchesRegex("T-20[0-9][0-9]-0001"));
  const std::string xml = test::read_file(folder / "a.xml");
  EXPECT_THAT(xml, AllOf(Not(HasSubstr("DRAFT")), HasSubstr("TRAINING"), HasSubstr("SIMULATED")));
  const CertificateXml query(xml);
  EXPECT_EQ(query.text("//dcc:uniqueIdentifier"), number);
  EXPECT_EQ(query.text("//dcc:respPerson[dcc:mainSigner='true']//dcc:name/dcc:content"), "Approver N. N.");
  EXPECT_EQ(query.text("//dcc:metaData[@refType='abc_rawDataHash']//dcc:data//dcc:content"),
            sha256_of_file(folder / run));
  EXPECT_EQ(query.text("//dcc:statement[@refType='abc_traceability']/dcc:traceable"), "");

  const auto kept = ResultsFile::certificates(folder / run);
  ASSERT_EQ(kept.size(), 1U);
  EXPECT_EQ(kept[0].xml, xml);
  EXPECT_EQ(kept[0].laboratory_toml, example_laboratory());
  const auto verified = abcal({"verify", run});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out,
              AllOf(HasSubstr("certificates: 1 entries"),
                    HasSubstr("register, certificate " + number + ": issued, approved by Approver N. N.")));
}

TEST_F(IssueTest, ACertificateNamesTheEntryOfTheRegisterThatGaveItsNumber) {
  const std::string number = issued({"--dcc", "a.xml"});
  const auto audit = nlohmann::json::parse(registered->lab({"list", "audit", "--json"}))["audit"];
  nlohmann::json given;
  for (const auto& entry : audit)
    if (entry["subject"] == "certificate/" + number && entry["what"] == "number given") given = entry;
  ASSERT_TRUE(given.is_object());
  const std::string entry = given["entry"], hash = given["chain"];
  const auto register_of =
      nlohmann::json::parse(registered->lab({"list", "laboratory", "--json"}))["laboratory"][0]["identity"];
  const std::string identity = register_of;

  const CertificateXml query(test::read_file(folder / "a.xml"));
  EXPECT_EQ(query.text("//dcc:statement[@refType='abc_register']/dcc:reference"),
            "register " + identity + ", entry " + entry + ", SHA-256 " + hash);
  ASSERT_EQ(abcal({"report", run, "--html", "a.html"}).exit_code, 0);
  const std::string page = test::read_file(folder / "a.html");
  EXPECT_THAT(page, HasSubstr("Register " + identity + ", entry " + entry + ", " + hash.substr(0, 32)));
  EXPECT_THAT(page, Not(HasSubstr(hash)));

  // Everything that left the register with the certificate is evidence.
  registered->lab({"backup", "kept.json"});
  const auto good = abcal({"lab", "verify", "--against", "a.xml", "--against", "kept.json", "--against", run,
                           "--against", run + ".results", "--against", entry + ":" + hash.substr(0, 32)});
  EXPECT_EQ(good.exit_code, 0) << good.out;
  EXPECT_THAT(good.out, AllOf(HasSubstr("good  against a.xml, entry " + entry + ": as it says"),
                              HasSubstr("good  against a.xml, number " + number),
                              HasSubstr("good  against kept.json, entry "),
                              HasSubstr("good  against " + run + ", certificate " + number),
                              HasSubstr("good  against line of a page, entry " + entry)));
  EXPECT_THAT(abcal({"verify", run}).out,
              HasSubstr("good  register against certificate " + number + ", entry " + entry));
}

TEST_F(IssueTest, ARegisterThatWasCopiedBackIsFoundByTheFirstCertificate) {
  std::filesystem::copy(folder / "register.db", folder / "old.db");
  const std::string first = issued({"--dcc", "a.xml"});
  std::filesystem::copy(folder / "register.db", folder / "new.db");
  std::filesystem::copy(folder / "old.db", folder / "register.db",
                        std::filesystem::copy_options::overwrite_existing);
  // The results go as well: who copies the register back can remove them.
  std::filesystem::remove(folder / (run + ".results"));
  ASSERT_EQ(abcal({"analyse", run}).exit_code, 0);
  ASSERT_EQ(issued({"--dcc", "b.xml"}), first) << "the number is given twice";
  EXPECT_EQ(abcal({"lab", "verify"}).exit_code, 0) << "the copy is consistent";
  EXPECT_EQ(abcal({"lab", "verify", "--against", "b.xml"}).exit_code, 0);
  const auto found = abcal({"lab", "verify", "--against", "b.xml", "--against", "a.xml", "--json"});
  EXPECT_EQ(found.exit_code, 1);
  const auto json = nlohmann::json::parse(found.out);
  EXPECT_FALSE(json["good"]);
  std::vector<std::string> bad;
  for (const auto& check : json["checks"])
    if (!check["good"])
      bad.push_back(check["what"].get<std::string>() + ": " + check["kind"].get<std::string>());
  EXPECT_THAT(bad, testing::ElementsAre(testing::MatchesRegex("against a.xml, entry [0-9]+: rewriting"),
                                        "against a.xml, number " + first + ": rewriting"));
  // The line on paper is enough.
  const CertificateXml query(test::read_file(folder / "a.xml"));
  std::string line = query.text("//dcc:statement[@refType='abc_register']/dcc:reference");
  line = line.substr(line.find("entry ") + 6);
  line = line.substr(0, line.find(',')) + ":" + line.substr(line.find("SHA-256 ") + 8, 32);
  EXPECT_EQ(abcal({"lab", "verify", "--against", line}).exit_code, 1);
  std::filesystem::copy(folder / "new.db", folder / "register.db",
                        std::filesystem::copy_options::overwrite_existing);
  EXPECT_EQ(abcal({"lab", "verify", "--against", "a.xml", "--against", line}).exit_code, 0);
}

TEST_F(IssueTest, WhatIsNoEvidenceOfARegisterIsRefused) {
  const auto refused = [&](const std::string& file) {
    const auto result = abcal({"lab", "verify", "--against", file});
    EXPECT_EQ(result.exit_code, 2) << file << result.out;
    return result.err;
  };
  EXPECT_THAT(refused("lab.toml"),
              HasSubstr("--against lab.toml: is no evidence of a register; required: a backup"));
  EXPECT_THAT(refused("none.xml"), HasSubstr("none.xml"));
  EXPECT_THAT(refused(run), HasSubstr("has no certificate"));
  ASSERT_EQ(abcal({"report", run, "--dcc", "draft.xml", "--laboratory", "lab.toml", "--draft"}).exit_code, 0);
  EXPECT_THAT(refused("draft.xml"), HasSubstr("draft.xml: a draft"));
  test::write_file(folder / "other.xml", "<other/>");
  EXPECT_THAT(refused("other.xml"), HasSubstr("other.xml: XML, but not a certificate of abcal"));
  (void)issued({"--dcc", "a.xml"});
  const std::string xml = test::read_file(folder / "a.xml");
  test::write_file(folder / "b.xml", replaced(xml, "<dcc:reference>register ", "<dcc:reference>Register "));
  EXPECT_THAT(refused("b.xml"), HasSubstr("statement abc_register is \"Register "));
}

TEST_F(IssueTest, ASimulatedRunIsIssuedByATrainingRegisterOnly) {
  const auto without_register = [&](std::vector<std::string> more) {
    test::TrainingRegister::leave();
    more.insert(more.end(), {"--number", "EX-1", "--approved-by", "Approver N. N."});
    const auto result = abcal(issue(more));
    registered->use();
    return result;
  };
  const auto refused = without_register({});
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err,
              AllOf(HasSubstr("instruments: found simulated"), HasSubstr("default sizes are used")));
  EXPECT_TRUE(ResultsFile::certificates(folder / run).empty());
}

TEST_F(IssueTest, ANumberIsTheRegistersAndARunHasOneCertificate) {
  EXPECT_EQ(abcal(issue({"--number", "EX-1"})).exit_code, 2);
  EXPECT_EQ(abcal(issue({"--approved-by", "Operator N. N."})).exit_code, 2);
  const std::string number = issued();
  const auto second = abcal(issue());
  EXPECT_EQ(second.exit_code, 1);
  EXPECT_THAT(second.err, HasSubstr("--replaces " + number));
  EXPECT_EQ(ResultsFile::certificates(folder / run).size(), 1U);
}

TEST_F(IssueTest, AnAmendmentNamesWhatItReplacesAndWhy) {
  const std::string first = issued({"--dcc", "a.xml"});
  EXPECT_EQ(abcal(issue({"--replaces", first})).exit_code, 2);
  const std::string second = issued({"--replaces", first, "--reason", "customer's address", "--amendment",
                                     "administrative", "--dcc", "b.xml"});
  const CertificateXml query(test::read_file(folder / "b.xml"));
  EXPECT_EQ(query.text("//dcc:reportAmendedSubstituted/dcc:typeOfChange"), "amended");
  EXPECT_EQ(query.text("//dcc:reportAmendedSubstituted/dcc:replacedUniqueIdentifier"), first);
  EXPECT_EQ(query.text("//dcc:previousReport/dcc:value"), sha256_of_file(folder / "a.xml"));
  EXPECT_THAT(query.text("//dcc:statement[@refType='abc_amendment']"), HasSubstr("customer's address"));
  EXPECT_THAT(abcal(issue({"--replaces", first, "--reason", "again", "--amendment", "administrative"})).err,
              HasSubstr("--replaces " + second));
  EXPECT_THAT(abcal(issue({"--replaces", "EX-0", "--reason", "other", "--amendment", "administrative"})).err,
              HasSubstr("--replaces " + second));
}

TEST_F(IssueTest, AnAdministrativeAmendmentChangesNoResultAndATechnicalOneListsEveryChange) {
  const std::string first = issued({"--dcc", "a.xml"});
  const std::string reason = "address of the customer";
  const auto amend = [&](const std::string& number, const std::string& kind, const std::string& name) {
    return abcal(issue({"--replaces", number, "--reason", reason, "--amendment", kind, "--dcc", name}));
  };
  const auto references = [&](const std::string& name) {
    std::string all;
    for (const std::string& one : CertificateXml(test::read_file(folder / name))
                                      .texts("//dcc:statement[@refType='abc_amendment']/dcc:reference"))
      all += one + "\n";
    return all;
  };
  const std::string moved = replaced(example_laboratory(), "2 Example Street", "3 Example Street");
  // A limit, the condition of the item, and the language, each under the reason "address of the customer".
  for (const auto& [changed, found] :
       {std::pair{replaced(moved, "upper = 1.02", "upper = 1.05"), "1.02"},
        {replaced(moved, "no visible damage", "a scratch"),
         "no visible damage → Condition on receipt: a scratch"},
        {replaced(moved, "language = \"en\"", "language = \"de\""), "en → de"}}) {
    test::write_file(folder / "lab.toml", changed);
    const auto refused = amend(first, "administrative", "refused.xml");
    EXPECT_EQ(refused.exit_code, 1) << found;
    EXPECT_THAT(refused.err, AllOf(HasSubstr("an administrative amendment of certificate " + first +
                                             " for the reason \"" + reason + "\" would change"),
                                   HasSubstr(found), HasSubstr("or --amendment technical"),
                                   Not(HasSubstr("3 Example Street"))));
    EXPECT_FALSE(std::filesystem::exists(folder / "refused.xml"));
  }
  EXPECT_EQ(ResultsFile::certificates(folder / run).size(), 1U);

  // The address alone may change, and is listed as the one change.
  test::write_file(folder / "lab.toml", moved);
  const auto second = amend(first, "administrative", "b.xml");
  ASSERT_EQ(second.exit_code, 0) << second.err;
  EXPECT_THAT(references("b.xml"), HasSubstr("2 Example Street → 3 Example Street\n"));
  EXPECT_EQ(references("b.xml").find("scratch"), std::string::npos);

  // A technical one may change a number, and lists it with its old and its new value.
  test::write_file(folder / "lab.toml", replaced(moved, "upper = 1.02", "upper = 1.05"));
  const auto third = amend(test::number_of(second.out), "technical", "c.xml");
  ASSERT_EQ(third.exit_code, 0) << third.err;
  EXPECT_THAT(references("c.xml"), testing::ContainsRegex("1\\.02.* → .*1\\.05"));
  EXPECT_THAT(references("c.xml"), Not(HasSubstr("Example Street")));
}

TEST_F(IssueTest, ACertificateWithoutItsRunIsVerifiedWithItsStatus) {
  const std::string number = issued({"--dcc", "a.xml"});
  std::filesystem::remove(folder / run);
  const auto verify = [&](std::vector<std::string> more = {}) {
    more.insert(more.begin(), {"verify", "a.xml"});
    return abcal(more);
  };
  const auto valid = verify();
  EXPECT_EQ(valid.exit_code, 0) << valid.out << valid.err;
  EXPECT_THAT(valid.out, AllOf(HasSubstr("it is not signed"), HasSubstr("valid, issued on 20"),
                               HasSubstr("is as the laboratory issued it, and holds")));
  EXPECT_EQ(abcal({"lab", "status", number}).exit_code, 0);
  EXPECT_EQ(verify({"--require", "signed"}).exit_code, 2);

  // A record that it rests on is withdrawn: the run of the certificate told the register which.
  const auto affected = abcal({"lab", "affected", "EX-ANGLE-0815"});
  EXPECT_THAT(affected.out, AllOf(HasSubstr("EX-ANGLE-0815: 1 run, 1 certificate\n"),
                                  HasSubstr("calibration EX-ANGLE-0815: angle of the stage"),
                                  HasSubstr("certificate " + number), HasSubstr("Example customer")));
  EXPECT_THAT(abcal({"lab", "letters", "EX-ANGLE-0815", "-o", "letters"}).err,
              HasSubstr("nothing of this name was withdrawn"));
  registered->lab({"withdraw", "calibration", "EX-ANGLE-0815", "--reason", "encoder was loose"});
  const auto doubtful = verify({"--json"});
  EXPECT_EQ(doubtful.exit_code, 1);
  EXPECT_THAT(doubtful.out, HasSubstr("it rests on calibration EX-ANGLE-0815, withdrawn on 20"));
  registered->lab({"letters", "EX-ANGLE-0815", "-o", "letters"});
  const std::string letter = test::read_file(folder / "letters" / "letter-01-Example-customer.html");
  EXPECT_THAT(letter, AllOf(HasSubstr("DRAFT of a letter. Nothing was sent."), HasSubstr(number),
                            HasSubstr("encoder was loose"), HasSubstr("2 Example Street")));

  registered->lab({"withdraw", "certificate", number, "--reason", "wrong item"});
  const auto withdrawn = verify({"--json"});
  EXPECT_EQ(withdrawn.exit_code, 1);
  const auto json = nlohmann::json::parse(withdrawn.out);
  EXPECT_EQ(json["certificate"], number);
  EXPECT_EQ(json["status"], "withdrawn");
  EXPECT_EQ(abcal({"lab", "status", number}).exit_code, 1);

  // Without a register and without a signature nothing shows that the file is the laboratory's.
  test::TrainingRegister::leave();
  const auto unknown = verify();
  EXPECT_EQ(unknown.exit_code, 1);
  EXPECT_THAT(unknown.out, AllOf(HasSubstr("nothing shows that the laboratory issued this file"),
                                 HasSubstr("is known to the laboratory's register only")));
}

TEST_F(IssueTest, ACertificateOfAnotherItemIsNotReplaced) {
  const std::string first = issued();
  test::write_file(folder / "first.xml", ResultsFile::certificates(folder / "a.run").front().xml);
  registered->log_in("Operator N. N.");
  measure(replaced(certificate_bench(), "SN-42", "SN-43"), "other.run", folder);
  measure(certificate_bench(), "again.run", folder);
  registered->log_in("Approver N. N.");
  const auto replace_by = [&](const std::string& measured) {
    return abcal({"issue", measured, "--laboratory", "lab.toml", "--replaces", first, "--reason", "range",
                  "--amendment", "technical", "--replaced", "first.xml"});
  };
  const auto other = replace_by("other.run");
  EXPECT_EQ(other.exit_code, 2);
  EXPECT_THAT(other.err, AllOf(HasSubstr("--replaced first.xml: certificate " + first +
                                         " is of Maker M-3 SN-42, another item"),
                               HasSubstr("required: one of Maker M-3 SN-43")));
  EXPECT_TRUE(ResultsFile::certificates(folder / "other.run").empty());
  const auto again = replace_by("again.run");
  EXPECT_EQ(again.exit_code, 0) << again.err;
}

TEST_F(IssueTest, ALaboratoryFileOfAnotherLaboratoryIsRefused) {
  test::write_file(folder / "lab.toml", replaced(example_laboratory(), "name = \"Example laboratory\"",
                                                 "name = \"Another house\""));
  const auto refused = abcal(issue());
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("[laboratory] name: found \"Another house\"; required: \"Example "
                                     "laboratory\", the laboratory of the register"));
  EXPECT_TRUE(ResultsFile::certificates(folder / run).empty());
}

TEST_F(IssueTest, WhoMeasuredCannotApprove) {
  // The events of the run state who measured, whatever name is given.
  EXPECT_THAT(abcal(issue({"--measured-by", "Third P."})).err, HasSubstr("by the events of the run"));
  registered->lab({"add", "person", "Second N. N.", "--role", "r", "--may", "approve"}, true);
  registered->lab({"retire", "person", "Operator N. N.", "--reason", "test"});
  EXPECT_THAT(abcal(issue()).err, HasSubstr("who may measure"));
  EXPECT_TRUE(ResultsFile::certificates(folder / run).empty());
}

TEST_F(IssueTest, ARunOfTheApproverNeedsAnotherApprover) {
  // With a register the operator of a run is the person logged in.
  test::write_file(folder / "bench.toml",
                   replaced(certificate_bench(), "name = \"Operator N. N.\"", "name = \"\""));
  const auto made = abcal({"run", "bench.toml", "-o", "own.run"});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  run = "own.run";
  EXPECT_THAT(abcal(issue()).err, HasSubstr("a person other than the one who measured"));
  registered->lab({"add", "person", "Second N. N.", "--role", "r", "--may", "approve"}, true);
  registered->log_in("Second N. N.");
  const auto result = abcal(issue());
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("measured by Approver N. N., approved by Second N. N."));
  // A person who may not measure cannot start a run, not even under another name.
  EXPECT_THAT(abcal({"run", "bench.toml", "-o", "b.run"}).err, HasSubstr("may not measure"));
  registered->log_in("Operator N. N.");
  test::write_file(folder / "bench.toml",
                   replaced(certificate_bench(), "name = \"Operator N. N.\"", "name = \"X\""));
  EXPECT_EQ(abcal({"run", "bench.toml", "-o", "b.run"}).exit_code, 2);
  registered->lab({"logout"});
  EXPECT_THAT(abcal({"run", "bench.toml", "-o", "b.run"}).err, HasSubstr("abcal lab login"));
  EXPECT_FALSE(std::filesystem::exists(folder / "b.run"));
}

TEST_F(IssueTest, TheRegisterFindsWhatIsTakenAwayFromARun) {
  const std::string number = issued();
  const std::filesystem::path results = folder / (run + ".results");
  SqliteDatabase(results, SqliteDatabase::Mode::kReadWrite).execute("delete from certificate");
  const auto deleted = abcal({"verify", run});
  EXPECT_EQ(deleted.exit_code, 1);
  EXPECT_THAT(deleted.out, HasSubstr("certificate " + number + ": the register knows it as issued"));
  std::filesystem::remove(results);
  EXPECT_EQ(abcal({"analyse", run}).exit_code, 0);
  EXPECT_EQ(abcal({"verify", run}).exit_code, 1);
  EXPECT_EQ(abcal(issue()).exit_code, 1);  // A second number is refused, too.
}

TEST_F(IssueTest, AllThatIsWrongIsSaidTogetherAndNothingIsWritten) {
  std::string laboratory = example_laboratory();
  laboratory = replaced(laboratory, "condition = \"no visible damage\"", "condition = \"\"");
  laboratory = replaced(laboratory, "due = 2030-12-31", "due = 1999-12-31");
  laboratory = replaced(laboratory, "unit = \"g/g_n\"", "unit = \"V/g_loc\"");
  laboratory = replaced(laboratory, "sensitivity = [\"mg/g_n\"]", "sensitivity = [\"mV/g_n\"]");
  test::write_file(folder / "lab.toml", laboratory);
  const std::string before = sha256_of_file(folder / (run + ".results"));
  const auto refused = abcal(issue({"--dcc", "a.xml"}));
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err,
              AllOf(HasSubstr("[job] condition"), HasSubstr("due"), HasSubstr("1999-12-31"),
                    HasSubstr("one of \"g/(m/s2)\", \"g/g_n\", \"g/g_loc\""), HasSubstr("mV/g_n")))
      << refused.err;
  EXPECT_FALSE(std::filesystem::exists(folder / "a.xml"));
  EXPECT_EQ(sha256_of_file(folder / (run + ".results")), before);
}

TEST_F(IssueTest, AChangedCertificateIsFound) {
  (void)issued({"--replaces", issued(), "--reason", "why", "--amendment", "technical"});
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
  const auto refused = abcal(issue());
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err, HasSubstr("SHA-256"));
}

/// The X.509 certificate of a signature as its lines of Base64, without the line feed at the end.
std::string x509_in(const std::string& xml) {
  const std::string tag = "<ds:X509Certificate>";
  const std::size_t from = xml.find(tag) + tag.size();
  return xml.substr(from, xml.find("\n</ds:X509Certificate>") - from);
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
  for (const char* certificate : {"cert.pem", "ec-cert.pem"})
    registered->lab({"key", "Approver N. N.", "--kind", "person", "--certificate", certificate});
  const auto signing = [&](const std::string& key, const std::string& certificate,
                           std::vector<std::string> more) {
    more.insert(more.end(), {"--sign", key, "--certificate", certificate, "--dcc", key + ".xml"});
    return more;
  };

  EXPECT_THAT(abcal(issue(signing("key.pem", "ec-cert.pem", {}))).err,
              HasSubstr("does not belong to the key"));
  EXPECT_THAT(abcal(issue(signing("lab.toml", "cert.pem", {}))).err, HasSubstr("no private key"));
  EXPECT_TRUE(ResultsFile::certificates(folder / run).empty());

  const std::string number = issued(signing("key.pem", "cert.pem", {}));
  (void)issued(signing("ec.pem", "ec-cert.pem",
                       {"--replaces", number, "--reason", "why", "--amendment", "technical"}));
  EXPECT_EQ(shell("xmlsec1 --verify --trusted-pem cert.pem key.pem.xml"), 0)
      << test::read_file(folder / "log");
  EXPECT_EQ(shell("xmlsec1 --verify --trusted-pem ec-cert.pem ec.pem.xml"), 0)
      << test::read_file(folder / "log");
  // XAdES-BES: the signature also covers when and with which certificate it was made.
  const CertificateXml signed_xml(test::read_file(folder / "key.pem.xml"));
  EXPECT_EQ(signed_xml.texts("//ds:SignedInfo/ds:Reference").size(), 2U);
  EXPECT_EQ(signed_xml.text("//ds:SignedInfo/ds:Reference[2]/@URI"),
            "#" + signed_xml.text("//xades:SignedProperties/@Id"));
  const auto accepted = abcal({"verify", "key.pem.xml"});
  EXPECT_THAT(accepted.out, AllOf(HasSubstr("verifies by a key of Approver N. N.; XAdES-BES, signed on 20"),
                                  HasSubstr("amended by")));
  // A second certificate of the same key under another name, put in the place of the first.
  ASSERT_EQ(
      shell("openssl req -x509 -new -key key.pem -days 30 -out other.pem -subj '/CN=Another house' && "
            "openssl x509 -in other.pem -outform DER -out other.der && base64 other.der | tee other.txt"),
      0);
  const std::string own = x509_in(test::read_file(folder / "key.pem.xml"));
  test::write_file(folder / "exchanged.xml", replaced(test::read_file(folder / "key.pem.xml"), own,
                                                      test::read_file(folder / "other.txt")));
  const auto exchanged = abcal({"verify", "exchanged.xml"});
  EXPECT_EQ(exchanged.exit_code, 1);
  EXPECT_THAT(exchanged.out, HasSubstr("its certificate is not the one that was signed"));
  // The time of signing is signed.
  const std::string at = signed_xml.text("//xades:SigningTime");
  test::write_file(folder / "other_time.xml",
                   replaced(test::read_file(folder / "key.pem.xml"), at, "2020" + at.substr(4)));
  EXPECT_NE(shell("xmlsec1 --verify --trusted-pem cert.pem other_time.xml"), 0);
  EXPECT_EQ(abcal({"verify", "other_time.xml"}).exit_code, 1);
  // A signature whose certificate was taken out is no unsigned certificate.
  test::write_file(folder / "no_x509.xml", replaced(test::read_file(folder / "key.pem.xml"), own, ""));
  EXPECT_THAT(abcal({"verify", "no_x509.xml"}).out, HasSubstr("it has no X.509 certificate"));
  // Signed by version 1.0.0, whose signatures have no XAdES.
  const std::string archived =
      test::read_file(test::source_folder() / "tests/data/register_step_4/signed.xml");
  test::write_file(folder / "v1.xml", archived);
  test::write_file(folder / "v1.pem",
                   "-----BEGIN CERTIFICATE-----\n" + x509_in(archived) + "\n-----END CERTIFICATE-----\n");
  const std::string helper =
      (std::filesystem::path(test::abcal_program()).parent_path() / "abcal-sign").string();
  EXPECT_EQ(shell(helper + " verify v1.xml v1.pem"), 0) << test::read_file(folder / "log");
  EXPECT_EQ(shell("xmlsec1 --verify --trusted-pem v1.pem v1.xml"), 0) << test::read_file(folder / "log");
  test::write_file(folder / "v1.xml", replaced(archived, ">EX-2026-0001<", ">EX-2026-0002<"));
  EXPECT_NE(shell(helper + " verify v1.xml v1.pem"), 0);
  // One digit changed, and it does not verify any more.
  const std::string xml = test::read_file(folder / "key.pem.xml");
  test::write_file(folder / "changed.xml", replaced(xml, number, "T-7"));
  EXPECT_NE(shell("xmlsec1 --verify --trusted-pem cert.pem changed.xml"), 0);
  EXPECT_EQ(abcal({"verify", run}).exit_code, 0);
}

}  // namespace
}  // namespace abcal
