#include "protocol/record/verify_run.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>

#include "protocol/record/run_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/sha256.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

std::string read_file(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_file(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

TEST(Sha256, IsThatOfThePublishedExample) {
  const test::TemporaryFolder folder;
  write_file(folder / "a", "abc");  // FIPS 180-4, appendix
  EXPECT_EQ(sha256_of_file(folder / "a"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Sha256, DoesNotDependOnThePieces) {
  const std::string bytes(20000, 'x');
  for (const std::size_t piece : {std::size_t{1}, std::size_t{9}, std::size_t{4095}, std::size_t{4096},
                                  std::size_t{4097}, std::size_t{9000}}) {
    Sha256 hash;
    for (std::size_t at = 0; at < bytes.size(); at += piece)
      hash.add(std::string_view(bytes).substr(at, piece));
    EXPECT_EQ(hash.hexadecimal(), sha256_of(bytes)) << piece;
  }
}

TEST(NextLink, DependsOnWhereOneFieldEndsAndOnTheLinkBefore) {
  EXPECT_NE(next_link("", {"ab", "c"}), next_link("", {"a", "bc"}));
  EXPECT_NE(next_link("", {"a"}), next_link("x", {"a"}));
  EXPECT_EQ(next_link("x", {"a"}), next_link("x", {"a"}));
}

class VerifyTest : public testing::Test {
 protected:
  VerifyTest() {
    RunHeader header;
    header.labels["operator.name"] = "day shift";
    header.plan.push_back({1, 1, false, Angle{}, Angle{}, Angle{}});
    RunFile file = RunFile::create(path, header);
    file.append_event("2026-03-01T12:00:00.000Z", "started", Message("run started"));
    DwellRecord dwell;
    dwell.experiment = dwell.n = 1;
    dwell.mean = Eigen::Vector3d(0.1, 0.2, 0.3);
    file.append_dwell(0, dwell, {}, {});
    file.append_event("2026-03-01T12:01:00.000Z", "flag", Message("vibration"));
    hash = file.close_complete("2026-03-01T12:02:00.000Z", {});
    ResultsFile results(path, hash);
    results.add_analysis("2026-03-01T12:03:00.000Z", "1.0", "abc", "{\"a\": 1}");
    results.add_analysis("2026-03-01T12:03:00.000Z", "1.0", "joint", "{\"a\": 2}");
  }

  void make_writable() { make_writable(path); }
  static void make_writable(const std::filesystem::path& file) {
    std::filesystem::permissions(file, std::filesystem::perms::owner_write,
                                 std::filesystem::perm_options::add);
  }
  /// The checks that are not good; every one, as words.
  std::string bad() const {
    std::string words;
    for (const IntegrityCheck& check : verify_run(path))
      if (!check.good) words += check.what + ": " + check.found + "\n";
    return words;
  }

  test::TemporaryFolder folder;
  std::filesystem::path path = folder / "a.run";
  std::string hash;
};

TEST_F(VerifyTest, ARunAsItWasWrittenIsGood) {
  EXPECT_EQ(bad(), "");
  // State, events, references, dwells, readings, hash, results file, analyses, certificates.
  EXPECT_EQ(verify_run(path).size(), 9U);
}

TEST_F(VerifyTest, AnyChangedByteOfTheRunIsFound) {
  make_writable();
  const std::string bytes = read_file(path);
  int found = 0;
  // One in every 97 bytes, over the whole file: header, schema, rows and unused space alike.
  for (std::size_t at = 0; at < bytes.size(); at += 97) {
    std::string changed = bytes;
    changed[at] = static_cast<char>(changed[at] ^ 0x01);
    write_file(path, changed);
    try {
      EXPECT_NE(bad(), "") << "byte " << at;
      ++found;
    } catch (const RunFileError&) {
      continue;  // No run file at all any more.
    }
  }
  EXPECT_GT(found, 0);
  write_file(path, bytes);
  EXPECT_EQ(bad(), "");
}

TEST_F(VerifyTest, AChangedEventBreaksTheChainEvenInARunThatIsOpen) {
  const std::filesystem::path open = folder / "open.run";
  {
    RunFile file = RunFile::create(open, {});
    file.append_event("t1", "started", Message("a"));
    file.append_event("t2", "flag", Message("b"));
    file.append_event("t3", "flag", Message("c"));
  }
  const auto chain = [&] {
    for (const IntegrityCheck& check : verify_run(open))
      if (check.what == "event log") return check;
    return IntegrityCheck{};
  };
  EXPECT_TRUE(chain().good);
  SqliteDatabase(open, SqliteDatabase::Mode::kReadWrite).execute("update event set text = 'x' where id = 2");
  EXPECT_FALSE(chain().good);
  EXPECT_THAT(chain().found, HasSubstr("entry 2"));
  SqliteDatabase(open, SqliteDatabase::Mode::kReadWrite).execute("update event set text = 'b' where id = 2");
  EXPECT_TRUE(chain().good);
  SqliteDatabase(open, SqliteDatabase::Mode::kReadWrite).execute("delete from event where id = 2");
  EXPECT_FALSE(chain().good);
}

// SQLite would read a log that lies beside a closed run, and show what is in it.
TEST_F(VerifyTest, ALogThatAnotherProgramPutsBesideAClosedRunIsNotRead) {
  const std::filesystem::path copy = folder / "copy.run";
  std::filesystem::copy_file(path, copy);
  make_writable(copy);
  {
    SqliteDatabase changed(copy, SqliteDatabase::Mode::kReadWrite);
    changed.use_write_ahead_log();
    changed.execute("pragma wal_checkpoint(truncate); update dwell set r_u = 0.9");
    std::filesystem::copy_file(copy.string() + "-wal", path.string() + "-wal");
  }
  const auto words = [&](const auto& read) {
    try {
      read();
    } catch (const RunFileError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  for (const std::string& refused : {words([&] { (void)RunFile::load(path); }),
                                     words([&] { verify_run(path); }), words([&] { read_as_stored(path); })})
    EXPECT_THAT(refused, HasSubstr("a.run-wal: is not of "));
}

TEST_F(VerifyTest, ARunThatWasChangedGivesNoResult) {
  EXPECT_NO_THROW(read_as_stored(path));
  make_writable(path);
  SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).execute("update environment set utc = 'x'; vacuum");
  EXPECT_THROW(read_as_stored(path), RunFileError);
  std::filesystem::remove(ResultsFile::path_beside(path));
  EXPECT_NO_THROW(read_as_stored(path)) << "nothing names another hash";
}

TEST_F(VerifyTest, NothingIsWrittenThroughALink) {
  const std::filesystem::path results = ResultsFile::path_beside(path), other = folder / "other";
  std::filesystem::rename(results, other);
  std::filesystem::create_symlink(other, results);
  const std::string bytes = read_file(other);
  EXPECT_THROW(ResultsFile(path, hash), RunFileError);
  EXPECT_THROW((void)keep_time_stamp(path, "token"), RunFileError);
  EXPECT_EQ(read_file(other), bytes);
  // Nor is a new run begun whose results would lead elsewhere.
  std::filesystem::create_symlink(folder / "nowhere", folder / "b.run.results");
  EXPECT_THROW(RunFile::create(folder / "b.run", {}), RunFileError);
}

TEST_F(VerifyTest, AChangedAnalysisIsFound) {
  SqliteDatabase(ResultsFile::path_beside(path), SqliteDatabase::Mode::kReadWrite)
      .execute("update analysis set result_json = '{}' where estimator = 'abc'");
  EXPECT_THAT(bad(), HasSubstr("analyses: entry 1"));
}

TEST_F(VerifyTest, CertificatesOfBeforeItemsStayLinked) {
  const std::filesystem::path results = ResultsFile::path_beside(path);
  IssuedCertificate first;
  first.number = "1";
  ResultsFile(path, hash).add_certificate(first);
  // The form that an earlier abcal wrote.
  SqliteDatabase(results, SqliteDatabase::Mode::kReadWrite)
      .execute("alter table certificate drop column item");
  EXPECT_EQ(bad(), "");
  ASSERT_EQ(ResultsFile::certificates(path).size(), 1U);
  EXPECT_EQ(ResultsFile::certificates(path, 1).size(), 1U);
  IssuedCertificate second;
  second.number = "2";
  second.replaces = "1";
  ResultsFile(path, hash).add_certificate(second);
  EXPECT_EQ(bad(), "");
  EXPECT_EQ(ResultsFile::certificates(path).back().item, 0);
  // An item that is written into an old entry is found.
  SqliteDatabase(results, SqliteDatabase::Mode::kReadWrite)
      .execute("update certificate set item = 2 where number = '1'");
  EXPECT_THAT(bad(), HasSubstr("certificates: entry 1"));
}

TEST_F(VerifyTest, EachItemHasCertificatesOfItsOwn) {
  const auto certificate = [](const std::string& number, int item, const std::string& replaces = "") {
    IssuedCertificate one;
    one.number = number;
    one.item = item;
    one.replaces = replaces;
    return one;
  };
  ResultsFile results(path, hash);
  results.add_certificate(certificate("1", 1));
  results.add_certificate(certificate("2", 2));
  EXPECT_THROW(results.add_certificate(certificate("3", 2)), RunFileError);
  EXPECT_THROW(results.add_certificate(certificate("3", 2, "1")), RunFileError);
  EXPECT_THROW(results.add_certificate(certificate("3", 3, "1")), RunFileError);
  EXPECT_THROW(results.add_certificate(certificate("1", 3)), RunFileError);
  results.add_certificate(certificate("3", 2, "2"));
  EXPECT_EQ(ResultsFile::certificates(path, 2).size(), 2U);
  EXPECT_EQ(ResultsFile::certificates(path, 1).size(), 1U);
  EXPECT_EQ(bad(), "");
  SqliteDatabase(ResultsFile::path_beside(path), SqliteDatabase::Mode::kReadWrite)
      .execute("update certificate set item = 1 where number = '3'");
  EXPECT_THAT(bad(), HasSubstr("certificates: entry 3"));
}

TEST_F(VerifyTest, MissingResultsAreSaidAndAnOpenRunHasNoHash) {
  std::filesystem::remove(ResultsFile::path_beside(path));
  EXPECT_THAT(bad(), HasSubstr("missing"));
  const std::filesystem::path open = folder / "open.run";
  RunFile::create(open, {}).append_event("t1", "started", Message("a"));
  EXPECT_THAT(verify_run(open).front().found, HasSubstr("only a closed run has a hash"));
}

TEST_F(VerifyTest, EventsSayWho) {
  SqliteDatabase file(path, SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(file.value("select count(*) from event where who = 'day shift'"), "3");
}

}  // namespace
}  // namespace abcal
