// The register cannot forget: the head of its audit is named outside it, time has an order, a witness signs.
// A forger who can write the database computes every hash; these tests forge that way.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/laboratory/register/register.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"
#include "tests/app/laboratory/register_fixtures.h"

namespace abcal::lab {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

class RegisterHeadTest : public OnDatabase {
 protected:
  static NumberRequest request_for(const std::string& run) {
    return {sha256_of(run), "Maker M-3 SN-42", "Operator N. N.", {}, {}};
  }
  /// Issues the certificate of a run at two times. @returns what leaves the laboratory with it
  static RegisterEvidence issue(Register& made, const std::string& run, int when) {
    const LoggedIn approver = login(made, "Approver N. N.", when);
    const ReservedNumber reserved = made.reserve_number(approver, request_for(run), at(when));
    made.record_issued(approver, reserved.number, sha256_of("xml of " + run), "2026-03-01", at(when + 1));
    RegisterEvidence evidence;
    evidence.name = run + ".xml";
    evidence.register_identity = made.facts().identity;
    evidence.head = reserved.head;
    evidence.certificate = NamedCertificate{reserved.number, sha256_of(run), sha256_of("xml of " + run)};
    return evidence;
  }
  /// A register as it was when the backup was made: an old copy put in the place of the newer one.
  Register copied_back(const std::string& backup) {
    return Register::restore(new_location(), backup, at(90));
  }

  /// Changes the audit by a statement and rebuilds its chain up to the head with right hashes.
  static void forge(const std::string& where, const std::string& sql) {
    Database database(where);
    database.execute(sql);
    std::string link, count = "0";
    for (const auto& row : database.query(7,
                                          "select entry, utc, who, what, subject, before_json, after_json "
                                          "from audit order by entry")) {
      link = next_link(link, row);
      count = row[0];
      database.execute("update audit set chain = :chain where entry = :entry",
                       {{"chain", link}, {"entry", count}});
    }
    database.execute("update audit_head set entries = :count, chain = :chain where id = 1",
                     {{"count", count}, {"chain", link}});
  }
  static std::string bad_against(Register& in, const RegisterEvidence& evidence) {
    std::string words;
    for (const RegisterFinding& finding : in.compare_with(evidence))
      if (!finding.good) words += "[" + finding.kind + "] " + finding.what + ": " + finding.found + "\n";
    return words;
  }
  static std::vector<std::string> acts(Register& in, std::size_t from) {
    std::vector<std::string> words;
    for (const AuditEntry& entry : in.audit())
      if (entry.entry >= from) words.push_back(entry.what);
    return words;
  }
  static void add_item(Register& in, const LoggedIn& by, const std::string& name, int when) {
    in.add_item(by, {name, "Maker", "M-3", name, "", ""}, at(when));
  }
};
ABCAL_ON_BOTH_DATABASES(RegisterHeadTest);

TEST_P(RegisterHeadTest, AClockThatIsSetBackIsAnEntryOfItsOwn) {
  Register made = with_people();
  const LoggedIn admin = login(made, "Admin N. N.");
  const std::size_t from = made.audit().size() + 1;
  add_item(made, admin, "A", 100);
  add_item(made, admin, "B", 99);  // Not more than 1 s: a clock that is corrected.
  add_item(made, admin, "C", 97);
  EXPECT_THAT(acts(made, from), ElementsAre("item added", "item added",
                                            "clock set back: it says 2026-03-01T12:01:37.000Z, and said "
                                            "2026-03-01T12:01:39.000Z at entry " +
                                                std::to_string(from + 1),
                                            "item added"));
  EXPECT_EQ(made.audit().back().utc, format_utc(at(97)));
  EXPECT_EQ(bad(made), "");
  const auto findings = made.verify();
  EXPECT_THAT(findings.at(1).found,
              HasSubstr("the clock was set back 1 times, last at entry " + std::to_string(from + 2)));
}

TEST_P(RegisterHeadTest, AnEntryThatIsDatedBeforeItsPredecessorIsFoundThoughEveryHashIsRight) {
  Register made = with_people();
  (void)issue(made, "a", 10);
  ASSERT_EQ(bad(made), "");
  const std::size_t last = made.audit().size();
  forge(location, "update audit set utc = '2025-07-13T12:00:11.000Z' where entry = " + std::to_string(last));
  EXPECT_EQ(bad(made), "times of the audit: entry " + std::to_string(last) +
                           " of 2025-07-13T12:00:11.000Z is before entry " + std::to_string(last - 1) +
                           " of 2026-03-01T12:00:10.000Z; required: times that do not run backwards without "
                           "an entry that says so\n");
  // An entry that says something else of the clock is no excuse.
  forge(location,
        "update audit set subject = 'clock', what = 'clock set back', before_json = '', after_json = ''"
        " where entry = " +
            std::to_string(last));
  EXPECT_THAT(bad(made), HasSubstr("times of the audit: entry " + std::to_string(last)));
  forge(location, "update audit set utc = 'yesterday' where entry = 2");
  EXPECT_THAT(bad(made), HasSubstr("entry 2 has the time \"yesterday\""));
}

TEST_P(RegisterHeadTest, InARegisterOfVersion10AnEntryHasTheTimeAtWhichItsCommandBegan) {
  Register made = with_people();
  const LoggedIn admin = login(made, "Admin N. N.");
  add_item(made, admin, "A", 1000);
  add_item(made, admin, "B", 1000);
  const std::string last = std::to_string(made.audit().size());
  const auto as_of_1_0 = [&](const std::string& utc) {
    forge(location, "update audit set utc = '" + utc + "' where entry = " + last);
    nlohmann::json backup = nlohmann::json::parse(made.backup());
    backup["step"] = 3;
    auto& steps = backup["tables"]["schema_step"];
    while (steps.size() > 3) steps.erase(steps.size() - 1);
    backup["tables"].erase("witnessed_head");
    return backup.dump();
  };
  // Another person wrote while a command waited.
  Register waited = Register::restore(new_location(), as_of_1_0(format_utc(at(700))), at(2000));
  EXPECT_EQ(bad(waited), "");
  EXPECT_EQ(waited.audit().back().subject, "schema_step/4");
  // From then on the time of an entry is that of its writing.
  add_item(waited, login(waited, "Admin N. N.", 2001), "C", 2002);
  forge(waited.location(),
        "update audit set utc = '2026-03-01T12:25:00.000Z' where entry ="
        " (select max(entry) from audit)");
  EXPECT_THAT(bad(waited), HasSubstr("times of the audit"));
  // A forged date is no waiting. The backup is whole, so that it is restored, and `verify` judges it.
  Register forged = Register::restore(new_location(), as_of_1_0("2025-07-13T12:00:11.000Z"), at(2000));
  EXPECT_THAT(bad(forged), HasSubstr("times of the audit: entry " + last));
}

TEST_P(RegisterHeadTest, TheHeadOfANumberIsThatOfItsEntryAndTheSameEachTime) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  const ReservedNumber first = made.reserve_number(approver, request_for("a"), at(3));
  const AuditEntry entry = made.audit().back();
  EXPECT_EQ(entry.subject, "certificate/EX-2026-0001");
  EXPECT_EQ(first.head.entries, static_cast<std::int64_t>(entry.entry));
  EXPECT_EQ(first.head.sha256, entry.chain);
  EXPECT_EQ(first.head.sha256.size(), 64U);
  (void)login(made, "Operator N. N.", 4);
  const ReservedNumber again = made.reserve_number(approver, request_for("a"), at(5));
  EXPECT_EQ(again.number, first.number);
  EXPECT_EQ(again.head.entries, first.head.entries);
  EXPECT_EQ(again.head.sha256, first.head.sha256);
  EXPECT_TRUE(first.warnings.empty() && again.warnings.empty());
}

TEST_P(RegisterHeadTest, ARegisterThatWasCopiedBackIsFoundByTheCertificateOfTheNumberThatItGivesTwice) {
  Register made = with_people();
  const std::string before = made.backup();
  const RegisterEvidence first = issue(made, "a", 10);
  const RegisterEvidence later = evidence_of_backup("later.json", made.backup());
  EXPECT_EQ(bad_against(made, first), "");
  EXPECT_EQ(bad_against(made, later), "");
  EXPECT_EQ(bad_against(made, evidence_of_backup("before.json", before)), "");

  Register back = copied_back(before);
  EXPECT_EQ(bad(back), "") << "an old copy is consistent";
  EXPECT_THAT(bad_against(back, first),
              AllOf(HasSubstr("[rollback] a.xml, entry " + std::to_string(first.head->entries)),
                    HasSubstr("found " + std::to_string(first.head->entries - 2) +
                              " entries; required: at least " + std::to_string(first.head->entries)),
                    HasSubstr("[rollback] a.xml, number EX-2026-0001: rollback: found no certificate")));
  EXPECT_THAT(bad_against(back, later), HasSubstr("[rollback] later.json, entry"));

  const RegisterEvidence second = issue(back, "b", 20);
  EXPECT_EQ(second.certificate->number, first.certificate->number) << "the number is given twice";
  EXPECT_EQ(bad(back), "");
  EXPECT_EQ(bad_against(back, second), "");
  EXPECT_THAT(bad_against(back, first),
              AllOf(HasSubstr("[fork] a.xml, entry " + std::to_string(first.head->entries)),
                    HasSubstr("required: " + first.head->sha256), HasSubstr(second.head->sha256),
                    HasSubstr("[fork] a.xml, number EX-2026-0001: fork: found the number given to run " +
                              sha256_of("b"))));
}

TEST_P(RegisterHeadTest, ACopyFromBetweenNumberAndIssueIsFound) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  const ReservedNumber reserved = made.reserve_number(approver, request_for("a"), at(3));
  const std::string between = made.backup();
  RegisterEvidence evidence;
  evidence.name = "a.xml";
  evidence.head = reserved.head;
  evidence.certificate = NamedCertificate{reserved.number, sha256_of("a"), sha256_of("xml")};
  Register back = copied_back(between);
  EXPECT_THAT(
      bad_against(back, evidence),
      HasSubstr("[rollback] a.xml, number EX-2026-0001: rollback: found a number that is not issued"));
  made.record_issued(approver, reserved.number, sha256_of("xml"), "2026-03-01", at(4));
  EXPECT_EQ(bad_against(made, evidence), "");
  evidence.certificate->xml_sha256 = sha256_of("another xml");
  EXPECT_THAT(bad_against(made, evidence),
              AllOf(HasSubstr("[rewriting] a.xml, number EX-2026-0001"), HasSubstr(sha256_of("xml")),
                    HasSubstr(sha256_of("another xml"))));
}

TEST_P(RegisterHeadTest, ARewrittenEntryIsFoundByAnyLaterCertificate) {
  Register made = with_people();
  const std::string early = made.backup();
  const RegisterEvidence first = issue(made, "a", 10), second = issue(made, "b", 20);
  const std::string late = made.backup();
  forge(location, "update audit set who = 'Nobody' where entry = 1");
  EXPECT_EQ(bad(made), "") << "the chain is rebuilt";
  for (const RegisterEvidence* evidence : {&first, &second})
    EXPECT_THAT(bad_against(made, *evidence),
                HasSubstr("[rewriting] " + evidence->name + ", entry " +
                          std::to_string(evidence->head->entries) + ": rewriting: found SHA-256"));
  // A backup shows which entry it is.
  for (const std::string& backup : {early, late})
    EXPECT_THAT(bad_against(made, evidence_of_backup("kept.json", backup)),
                AllOf(HasSubstr("[rewriting] kept.json, entry 1"), HasSubstr("by Nobody at"),
                      HasSubstr("by Admin N. N. at")));
  // The line of a printed certificate has the first 32 digits.
  RegisterEvidence line;
  line.name = "line of a page";
  line.head = AuditHead{first.head->entries, first.head->sha256.substr(0, 32)};
  EXPECT_THAT(bad_against(made, line), HasSubstr("[fork or rewriting] line of a page, entry"));
  Register whole = copied_back(late);
  EXPECT_EQ(bad_against(whole, line), "");
}

TEST_P(RegisterHeadTest, AForkIsFoundAtItsFirstEntry) {
  Register made = with_people();
  const std::string before = made.backup();
  const std::size_t common = made.audit().size();
  const LoggedIn admin = login(made, "Admin N. N.", 10);
  add_item(made, admin, "A", 11);
  const RegisterEvidence kept = evidence_of_backup("kept.json", made.backup());
  Register other = copied_back(before);
  const LoggedIn again = login(other, "Admin N. N.", 20);
  for (const char* item : {"B", "C", "D"}) add_item(other, again, item, 21);
  EXPECT_EQ(bad(other), "");
  EXPECT_THAT(bad_against(other, kept),
              AllOf(HasSubstr("[fork] kept.json, entry " + std::to_string(common + 1) + ": fork: found"),
                    HasSubstr("required: \"logged in\" of person/Admin N. N. by Admin N. N. at "
                              "2026-03-01T12:00:10.000Z"),
                    HasSubstr("copied back to entry " + std::to_string(common) + " or before")));
}

TEST_P(RegisterHeadTest, EvidenceOfAnotherRegisterAndOfADamagedBackupIsSaid) {
  Register made = with_people();
  const std::string backup = made.backup();
  RegisterEvidence evidence = evidence_of_backup("kept.json", backup);
  evidence.register_identity = "0123";
  evidence.certificate = NamedCertificate{"EX-1", "run", "xml"};
  EXPECT_EQ(bad_against(made, evidence),
            "[another register] kept.json: it is of register 0123; required: "
            "this one, " +
                made.facts().identity + "\n");
  std::string damaged = backup;
  damaged.replace(damaged.find("register made"), 8, "Register");
  EXPECT_THAT(refusal([&] { (void)evidence_of_backup("kept.json", damaged); }),
              HasSubstr("kept.json: the backup is not whole: audit: entry 1, or one before it, was changed"));
  EXPECT_THAT(refusal([&] { (void)evidence_of_backup("kept.json", "{}"); }), HasSubstr("abcal lab backup"));
}

TEST_P(RegisterHeadTest, ACertificateThatIsDatedBeforeTheLastOneHasAWarning) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  EXPECT_TRUE(made.reserve_number(approver, request_for("a"), at(500)).warnings.empty());
  EXPECT_TRUE(made.reserve_number(approver, request_for("b"), at(499)).warnings.empty());
  const auto warnings = made.reserve_number(approver, request_for("c"), at(400)).warnings;
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_THAT(warnings[0], AllOf(HasSubstr("the clock says 2026-03-01T12:06:40.000Z, before "
                                           "2026-03-01T12:08:19.000Z of entry"),
                                 HasSubstr("certificate/EX-2026-0002"), HasSubstr("a clock that is right")));
}

/// A witness as the register knows it: it signs heads that grow, and each entry once.
class Witness {
 public:
  HeadWitness hook() {
    return [this](std::int64_t entries, const std::string& sha256) -> std::optional<WitnessedLine> {
      if (silent) return std::nullopt;
      if (entries < last_.entries || (entries == last_.entries && sha256 != last_.sha256))
        throw RegisterError("the witness refuses: it signed entry " + std::to_string(last_.entries));
      last_ = {entries, sha256};
      ++asked;
      return WitnessedLine{"head " + std::to_string(entries) + " " + sha256, "signed"};
    };
  }
  bool silent = false;
  int asked = 0;

 private:
  AuditHead last_;
};

TEST_P(RegisterHeadTest, AWitnessSignsTheHeadsOfNumbersAndCertificates) {
  Witness witness;
  Register made = with_people();
  made.set_witness(witness.hook());
  const RegisterEvidence first = issue(made, "a", 10);
  const auto rows = nlohmann::json::parse(made.backup())["tables"]["witnessed_head"];
  // Before and after the number, and after the issue; the head before the issue is that after the number.
  ASSERT_EQ(rows.size(), 3U);
  EXPECT_EQ(witness.asked, 4);
  EXPECT_EQ(rows[1]["entries"], std::to_string(first.head->entries));
  EXPECT_EQ(rows[1]["line"], "head " + std::to_string(first.head->entries) + " " + first.head->sha256);
  EXPECT_EQ(rows[1]["signature"], "signed");
  EXPECT_EQ(rows[2]["entries"], std::to_string(made.audit().size()));
  EXPECT_EQ(bad(made), "");
  Register copy = Register::restore(new_location(), made.backup(), at(30));
  EXPECT_THAT(copy.verify().back().found, HasSubstr("3, the newest of entry"));
  // An audit that is cut off with its head, but leaves what the witness signed.
  forge(copy.location(), "delete from audit where entry = (select max(entry) from audit)");
  EXPECT_THAT(bad(copy), HasSubstr("witnessed heads: 3, the newest of entry"));
}

TEST_P(RegisterHeadTest, TheWitnessRefusesARegisterThatWasCopiedBackAndNothingIsWritten) {
  Witness witness;
  Register made = with_people();
  const std::string before = made.backup();
  made.set_witness(witness.hook());
  (void)issue(made, "a", 10);
  Register back = copied_back(before);
  back.set_witness(witness.hook());
  const LoggedIn approver = login(back, "Approver N. N.", 20);
  EXPECT_THAT(refusal([&] { (void)back.reserve_number(approver, request_for("b"), at(21)); }),
              HasSubstr("the witness refuses: it signed entry"));
  EXPECT_TRUE(back.certificates().empty());

  // Copied back between number and issue, as while a signature is waited for.
  const LoggedIn here = login(made, "Approver N. N.", 22);
  const ReservedNumber reserved = made.reserve_number(here, request_for("c"), at(23));
  Register between = copied_back(made.backup());
  made.record_issued(here, reserved.number, sha256_of("xml"), "2026-03-01", at(24));
  between.set_witness(witness.hook());
  const LoggedIn there = login(between, "Approver N. N.", 25);
  const std::string bare = "EX-2026-0002";
  EXPECT_EQ(reserved.number, bare);
  // One entry more than at the copy, as many as the true register has: another hash.
  EXPECT_THAT(refusal([&] { between.record_issued(there, bare, sha256_of("xml"), "2026-03-01", at(26)); }),
              HasSubstr("the witness refuses"));
  EXPECT_EQ(between.certificates().back().state, "reserved");
}

TEST_P(RegisterHeadTest, AWitnessThatDoesNotAnswerIsAWarning) {
  Witness witness;
  witness.silent = true;
  Register made = with_people();
  made.set_witness(witness.hook());
  const LoggedIn approver = login(made, "Approver N. N.");
  const ReservedNumber reserved = made.reserve_number(approver, request_for("a"), at(3));
  EXPECT_THAT(reserved.warnings,
              ElementsAre(AllOf(HasSubstr("the witness does not answer"), HasSubstr("is not witnessed"))));
  EXPECT_EQ(made.record_issued(approver, reserved.number, sha256_of("xml"), "2026-03-01", at(4)).size(), 1U);
  EXPECT_EQ(made.certificates().back().state, "issued");
  EXPECT_TRUE(nlohmann::json::parse(made.backup())["tables"]["witnessed_head"].empty());
  EXPECT_EQ(bad(made), "");
}

}  // namespace
}  // namespace abcal::lab
