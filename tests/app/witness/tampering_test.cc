#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <random>
#include <utility>

#include "app/results/analysis/recompute.h"
#include "tests/app/witness/evidence_fixtures.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class TamperingTest : public EvidenceTest {
 protected:
  /// The checks that are not good, as words; what SQLite or the reader refuses counts as found.
  std::string bad() const {
    try {
      std::string words;
      for (const IntegrityCheck& check : verify_and_recompute(path))
        if (!check.good) words += check.what + ": " + check.found + "\n";
      return words;
    } catch (const RunFileError& error) {
      return error.what();
    }
  }
  /// The attack of before: change the run, take its results away, have them made again.
  void change_and_make_results_again(const std::string& sql) {
    change(sql);
    std::filesystem::remove(results());
    const auto analysed = abcal({"analyse", path.filename().string()});
    if (analysed.exit_code == 0) {
      EXPECT_THAT(analysed.err, HasSubstr("created again"));
    }
  }
};

TEST_F(TamperingTest, AnUntouchedRunIsGood) {
  EXPECT_EQ(bad(), "");
  const auto verified = abcal({"verify", path.filename().string()});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out,
              testing::AllOf(HasSubstr("as the bench file gives them"), HasSubstr("analyses recomputed"),
                             HasSubstr("neither a signature nor a time stamp")));
}

class OneTampering : public TamperingTest,
                     public testing::WithParamInterface<std::pair<const char*, const char*>> {};

TEST_P(OneTampering, IsFoundThoughTheResultsAreMadeAgain) {
  const auto [sql, words] = GetParam();
  change_and_make_results_again(sql);
  EXPECT_THAT(bad(), HasSubstr(words)) << sql;
  EXPECT_NE(abcal({"verify", path.filename().string()}).exit_code, 0);
}

INSTANTIATE_TEST_SUITE_P(
    Each, OneTampering,
    testing::Values(std::pair{"update dwell set r_u = r_u * 1.0005", "mean"},
                    std::pair{"update reading set u = u * 1.0005", "dwells"},
                    std::pair{"drop table reading", "reading"},
                    std::pair{"delete from reading where dwell = 3", "dwells"},
                    std::pair{"update dwell set encoder_x_deg = encoder_x_deg + 1", "position window"},
                    std::pair{"update dwell set u_u = -1", "standard uncertainty"},
                    std::pair{"delete from reading where dwell = 5; delete from dwell where id = 5",
                              "38 of 39 angles are measured"},
                    std::pair{"update meta set value = '9.8x' where key = 'g_loc.value_mps2'",
                              "not a number"},
                    std::pair{"update meta set value = '9.9' where key = 'g_loc.value_mps2'", "dwells"},
                    std::pair{"update plan set alpha_deg = alpha_deg + 1 where position = 4", "plan"},
                    std::pair{"update dwell set flags = 32", "dwells"},
                    std::pair{"update event set text = 'X' where id = 1", "event log"},
                    std::pair{"delete from seal", "seal"}));

TEST_F(TamperingTest, AForgedAnalysisDoesNotFollowFromTheDwells) {
  SqliteDatabase kept(results(), SqliteDatabase::Mode::kReadWrite);
  SqliteStatement row = kept.prepare(
      "select utc, program_version, estimator, result_json from analysis where estimator = 'abc'");
  ASSERT_TRUE(row.step());
  std::string json = row.text(3);
  const std::string utc = row.text(0), version = row.text(1);
  row.reset();
  const std::size_t at = json.find("\"intrinsic_sensitivity\"");
  const std::size_t value = json.find("\"value\":", at) + 8;
  json.insert(value, json[value] == '1' ? "1" : "9");  // 1.002 becomes 11.002
  kept.execute("delete from analysis");
  kept.prepare(
          "insert into analysis(utc, program_version, estimator, result_json, chain)"
          " values(:utc, :version, 'abc', :json, :chain)")
      .set("utc", std::string_view(utc))
      .set("version", std::string_view(version))
      .set("json", std::string_view(json))
      .set("chain", std::string_view(next_link("", {utc, version, "abc", json})))
      .run();
  EXPECT_THAT(bad(), HasSubstr("results: the analysis abc"));
}

TEST_F(TamperingTest, AnalysesThatWereRemovedAreMissed) {
  SqliteDatabase(results(), SqliteDatabase::Mode::kReadWrite).execute("delete from analysis");
  const auto verified = abcal({"verify", path.filename().string()});
  EXPECT_EQ(verified.exit_code, 1);
  EXPECT_THAT(verified.out,
              HasSubstr("results: no analysis is stored of joint, abc, norm; required: that of joint"));
  // They can be made again from the readings.
  EXPECT_EQ(abcal({"analyse", path.filename().string()}).exit_code, 0);
  EXPECT_EQ(bad(), "");
  // The last ones alone: the chain is whole.
  SqliteDatabase(results(), SqliteDatabase::Mode::kReadWrite).execute("delete from analysis");
  EXPECT_EQ(abcal({"analyse", path.filename().string(), "--estimator", "abc"}).exit_code, 0);
  EXPECT_THAT(bad(), HasSubstr("no analysis is stored of joint, norm"));
}

TEST_F(TamperingTest, WhatNoChainCoversIsSaid) {
  const auto verified = abcal({"verify", path.filename().string()});
  EXPECT_THAT(verified.out, HasSubstr("Not covered, in RUN.results: run.note"));
  EXPECT_THAT(abcal({"verify", path.filename().string(), "--json"}).out, HasSubstr("\"not_covered\""));
}

TEST_F(TamperingTest, ThreeHundredRandomChangesOfAByteAreFound) {
  std::ifstream in(path, std::ios::binary);
  std::string bytes{std::istreambuf_iterator<char>(in), {}};
  in.close();
  std::filesystem::permissions(path, std::filesystem::perms::owner_write, std::filesystem::perm_options::add);
  std::mt19937_64 engine(20260301);
  std::uniform_int_distribution<std::size_t> position(0, bytes.size() - 1);
  std::uniform_int_distribution<int> difference(1, 255);
  for (int k = 0; k < 300; ++k) {
    const std::size_t at = position(engine);
    std::string changed = bytes;
    changed[at] = static_cast<char>(static_cast<unsigned char>(changed[at]) ^
                                    static_cast<unsigned>(difference(engine)));
    std::ofstream(path, std::ios::binary | std::ios::trunc) << changed;
    bool found = false;
    try {
      for (const IntegrityCheck& check : verify_run(path)) found = found || !check.good;
    } catch (const std::exception&) {
      found = true;  // No run file at all any more, and it says so.
    }
    EXPECT_TRUE(found) << "byte " << at;
  }
}

TEST_F(TamperingTest, MissingResultsMadeAgainSayThatEarlierOnesAreUnknown) {
  std::filesystem::remove(results());
  EXPECT_THAT(abcal({"analyse", path.filename().string()}).err, HasSubstr("created again"));
  const auto verified = abcal({"verify", path.filename().string()});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out, HasSubstr("earlier analyses are"));
}

TEST_F(TamperingTest, ARequiredSealThatIsMissingFails) {
  const auto untrusted = abcal({"verify", path.filename().string(), "--require", "signed"});
  EXPECT_EQ(untrusted.exit_code, 1);
  EXPECT_THAT(untrusted.out, HasSubstr("no key is trusted; --require signed requires"));  // By whom?
  test::write_file(folder / "key.pem", "none\n");
  const auto unsigned_run =
      abcal({"verify", path.filename().string(), "--require", "signed", "--key", "key.pem"});
  EXPECT_EQ(unsigned_run.exit_code, 1);
  EXPECT_THAT(unsigned_run.out, HasSubstr("no signature by a trusted key"));
  const auto unstamped =
      abcal({"verify", path.filename().string(), "--require", "timestamped", "--authority", "key.pem"});
  EXPECT_EQ(unstamped.exit_code, 1);
  EXPECT_THAT(unstamped.out, HasSubstr("no time stamp by a trusted authority"));
}

}  // namespace
}  // namespace abcal
