// A comparison takes stored results in place of fits. Whatever happens to a run and its results, it gives the
// numbers of a fit to the readings.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <vector>

#include "app/laboratory/compare/compared_result.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/stored_result.h"
#include "app/system/version.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"
#include "tests/app/bench_text.h"
#include "tests/app/in_process_run.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

std::string bench_of_items(int items, unsigned seed, const std::string& estimator) {
  std::string text =
      "[bench]\nname = \"bench 1\"\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n" +
      quick_calibration(fmt::format("draw = \"stated\"\nseed = {}\n", seed));
  text.insert(text.find("check_poses"), fmt::format("estimator = \"{}\"\n", estimator));
  for (int k = 1; k <= items; ++k)
    text += fmt::format(
        "[[item]]\nmaker = \"MicroStrain\"\nmodel = \"3DM-GV7-AR\"\nserial_number = \"SN-{0}\"\n"
        "[item.accelerometer]\ndriver = \"microstrain_mip\"\nport = \"simulated\"\nrate_hz = 200.0\n"
        "serial_number = \"SN-{0}\"\n",
        k);
  return text;
}

/// The numbers of a comparison, or what it says in place of them.
struct Answer {
  std::vector<ComparedResult> results;
  std::string error;
};

Answer answer_of(const std::filesystem::path& run, const std::string& estimator, ResultSource source) {
  try {
    return {load_compared({run.string()}, estimator, source), {}};
  } catch (const std::exception& error) {
    return {{}, error.what()};
  }
}

template <class Value>
void expect_same(const std::optional<Value>& stored, const std::optional<Value>& fresh) {
  ASSERT_EQ(stored.has_value(), fresh.has_value());
  EXPECT_TRUE(!stored || (stored->array() == fresh->array()).all());
}

/// @return how many of the results were stored ones
std::size_t expect_the_numbers_of_a_fit(const std::filesystem::path& run, const std::string& estimator) {
  const Answer kept = answer_of(run, estimator, ResultSource::kStored);
  const Answer fresh = answer_of(run, estimator, ResultSource::kReadings);
  EXPECT_EQ(kept.error, fresh.error);
  EXPECT_EQ(kept.results.size(), fresh.results.size());
  std::size_t stored = 0;
  for (std::size_t k = 0; k < std::min(kept.results.size(), fresh.results.size()); ++k) {
    const ComparedResult& a = kept.results[k];
    const ComparedResult& b = fresh.results[k];
    stored += a.is_stored ? 1 : 0;
    EXPECT_FALSE(b.is_stored);
    EXPECT_EQ(a.what, b.what);
    EXPECT_EQ(a.notes, b.notes);
    EXPECT_EQ(a.unit_name, b.unit_name);
    EXPECT_EQ(a.g_loc.has_value(), b.g_loc.has_value());
    EXPECT_TRUE(!a.g_loc || !b.g_loc || a.g_loc->value == b.g_loc->value);
    EXPECT_EQ(a.g_loc_source, b.g_loc_source);
    EXPECT_TRUE((a.values.array() == b.values.array()).all());
    EXPECT_TRUE((a.covariance.array() == b.covariance.array()).all());
    expect_same(a.type_a, b.type_a);
    expect_same(a.matrix, b.matrix);
    EXPECT_TRUE(!a.matrix || (a.output_covariance.array() == b.output_covariance.array()).all());
    const std::optional<PublishedResult>& published = a.run->items.front().results.front().published;
    EXPECT_EQ(published.has_value(), b.run->items.front().results.front().published.has_value());
    if (!published || !b.run->items.front().results.front().published) continue;
    const PublishedResult& again = *b.run->items.front().results.front().published;
    EXPECT_TRUE((published->covariance.array() == again.covariance.array()).all());
    EXPECT_TRUE((published->covariance_intrinsic.array() == again.covariance_intrinsic.array()).all());
  }
  return stored;
}

void change_byte(const std::filesystem::path& path, std::mt19937_64& engine) {
  std::string bytes;
  {
    std::ifstream in(path, std::ios::binary);
    bytes.assign(std::istreambuf_iterator<char>(in), {});
  }
  std::filesystem::permissions(path, std::filesystem::perms::owner_write, std::filesystem::perm_options::add);
  std::uniform_int_distribution<std::size_t> position(0, bytes.size() - 1);
  std::uniform_int_distribution<unsigned> difference(1, 255);
  char& byte = bytes[position(engine)];
  byte = static_cast<char>(static_cast<unsigned char>(byte) ^ difference(engine));
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
}

/// Measures runs, and changes each of them and its results in every way, one after the other.
/// @return how many answers were compared
std::size_t compare_answers(unsigned runs) {
  std::size_t compared = 0, stored = 0;
  for (unsigned seed = 1; seed <= runs; ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    const test::TemporaryFolder folder;
    std::mt19937_64 engine(seed);
    const std::string estimator = seed % 3 == 0 ? "abc" : seed % 3 == 1 ? "joint" : "norm";
    const int items = seed % 5 == 0 ? 2 : 1;
    const std::filesystem::path run = folder / "a.run";
    const std::filesystem::path results = ResultsFile::path_beside(run);
    test::InProcessRun(bench_of_items(items, seed, estimator == "norm" ? "joint" : estimator), run)
        .run_to_end();
    const auto ask = [&](const char* state) {
      SCOPED_TRACE(state);
      ++compared;
      return expect_the_numbers_of_a_fit(run, estimator);
    };
    stored += ask("as measured");
    // A measurement of this run and another one; below, one of its runs is damaged.
    const std::filesystem::path measurement = folder / "both.measurement";
    const bool has_measurement = items == 1 && seed % 4 == 0;
    const auto ask_measurement = [&](const char* state) {
      SCOPED_TRACE(state);
      if (!has_measurement) return;
      ++compared;
      EXPECT_EQ(expect_the_numbers_of_a_fit(measurement, "joint"), 0U);
    };
    if (has_measurement) {
      const std::filesystem::path second = folder / "b.run";
      test::InProcessRun(bench_of_items(1, seed + 1000, "joint"), second).run_to_end();
      write_measurement(measurement, {"2026-03-01T00:00:00.000Z",
                                      program_version(),
                                      1,
                                      {{run, sha256_of_file(run)}, {second, sha256_of_file(second)}},
                                      {}});
    }
    ask_measurement("two runs in a measurement");
    const std::filesystem::path kept = folder / "kept.results";
    std::filesystem::copy_file(results, kept);
    const auto restore = [&] {
      std::filesystem::copy_file(kept, results, std::filesystem::copy_options::overwrite_existing);
    };
    // Another version has another result.
    ResultsFile(run, sha256_of_file(run))
        .add_analysis("2026-03-01T00:00:00.000Z", "0.9.0 (0000000)", estimator, "{}");
    EXPECT_EQ(ask("amended by another version"), 0U);
    restore();
    // Somebody changes a stored value, and does not mend the chain.
    SqliteDatabase(results, SqliteDatabase::Mode::kReadWrite)
        .execute("update analysis set result_json = replace(result_json, '\"value\":0.0', '\"value\":0.5')");
    EXPECT_EQ(ask("a stored value changed"), 0U);
    restore();
    change_byte(results, engine);
    ask("a byte of the results changed");
    restore();
    std::filesystem::rename(results, folder / "elsewhere");
    EXPECT_EQ(ask("without results"), 0U);
    std::filesystem::rename(folder / "elsewhere", results);
    change_byte(run, engine);
    EXPECT_EQ(ask("a byte of the run changed"), 0U);
    ask_measurement("a byte of a run of the measurement changed");
  }
  EXPECT_GT(stored, 0U) << "no stored result was used, and nothing was compared";
  return compared;
}

TEST(StoredResultTest, GivesTheNumbersOfAFitWhateverHappensToTheFiles) {
  EXPECT_EQ(compare_answers(10), 64U);
}

TEST(LongStoredResultTest, GivesTheNumbersOfAFitOverTwoHundredRuns) {
  EXPECT_EQ(compare_answers(200), 1280U);
}

TEST(StoredResultTest, IsTakenOnlyOfItsEstimatorAndVersion) {
  const test::TemporaryFolder folder;
  const std::filesystem::path run = folder / "a.run";
  test::InProcessRun(bench_of_items(1, 4, "joint"), run).run_to_end();
  const CheckedRun checked = read_as_stored(run);
  ASSERT_EQ(stored_analyses(run).back().program_version, program_version());
  const std::optional<CalibrationResult> stored = stored_result(checked, "joint");
  ASSERT_TRUE(stored);
  EXPECT_EQ(stored->estimator, "joint");
  EXPECT_EQ(stored->why.english(), analyse(checked.items.front().record, "joint").why.english());
  // The stored text that names another version, estimator, item or verdict is not the result asked for.
  const auto add_changed = [&](const std::function<void(nlohmann::json&)>& change) {
    nlohmann::json json;
    for (const StoredAnalysis& analysis : stored_analyses(run))
      if (analysis.estimator == "joint") json = nlohmann::json::parse(analysis.result_json);
    change(json);
    ResultsFile(run, sha256_of_file(run))
        .add_analysis("2026-03-01T00:00:00.000Z", program_version(), "joint", json.dump());
  };
  for (const auto& change : std::vector<std::function<void(nlohmann::json&)>>{
           [](auto& json) { json["estimator"] = "abc"; }, [](auto& json) { json["item"] = 1; },
           [](auto& json) { json["verdict"] = "doubtful"; },
           [](auto& json) { json["offset"][0]["value"] = nullptr; },
           [](auto& json) { json["schema"] = "abcal.result/0"; },
           [](auto& json) { json.erase("covariance"); }}) {
    const std::filesystem::path results = ResultsFile::path_beside(run);
    std::filesystem::copy_file(results, folder / "kept", std::filesystem::copy_options::overwrite_existing);
    add_changed(change);
    EXPECT_FALSE(stored_result(checked, "joint"));
    std::filesystem::copy_file(folder / "kept", results, std::filesystem::copy_options::overwrite_existing);
    EXPECT_TRUE(stored_result(checked, "joint"));
  }
}

TEST(StoredResultTest, ARunNamedTwiceIsRefusedBeforeAnyIsRead) {
  const test::TemporaryFolder folder;
  const std::filesystem::path run = folder / "a.run";
  test::InProcessRun(bench_of_items(1, 7, "joint"), run).run_to_end();
  std::filesystem::copy_file(run, folder / "copy.run");
  // This one cannot be analysed, which only its readings show.
  std::ofstream(folder / "bad.csv") << "experiment,n,alpha_deg,r_u,r_v,r_w\n1,1,0,x,y,z\n";
  for (const ResultSource source : {ResultSource::kStored, ResultSource::kReadings}) {
    try {
      (void)load_compared({(folder / "bad.csv").string(), run.string(), (folder / "copy.run").string()}, {},
                          source);
      ADD_FAILURE() << "a copy is no other measurement";
    } catch (const CompareError& error) {
      EXPECT_THAT(error.what(), HasSubstr("hold the same measurement; required: each measurement once"));
    }
  }
}

}  // namespace
}  // namespace abcal
