#pragma once

#include <fmt/format.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/record/sqlite.h"
#include "tests/app/bench_text.h"

namespace abcal {

/// A bench on which everything at an angle comes from the angle alone, so that a run which went on must give
/// the same bits. Noise is seeded by the angle and the number of the sample after the arrival: every move
/// lasts a whole number of sample periods (5 ms), so that the samples after it come at the same times,
/// however long the run has lasted.
inline BenchText repeatable_bench() {
  BenchText bench;
  bench.protocol += "approach_deg = 0.0\n[tolerances]\ndrift = 0.0\n";
  bench.simulation = "noise_seeded_by_angle = true\nseed = 7\n";
  bench.motion = "speed_deg_per_s = 500.0\nacceleration_deg_per_s2 = 25000.0\n";
  return bench;
}

inline std::string integrity(const std::filesystem::path& run) {
  // Opened for writing, as by the tool sqlite3: it may finish or undo half-written transactions.
  return SqliteDatabase(run, SqliteDatabase::Mode::kReadWrite).value("pragma integrity_check").value_or("");
}

/// The bits of all readings' means and of their uncertainty, in the order of the plan; empty: not measured.
inline std::vector<std::string> measured_bits(const std::filesystem::path& run) {
  const StoredRun stored = RunFile::load(run);
  std::vector<std::string> bits(stored.header.plan.size());
  for (std::size_t k = 0; k < stored.measured.size(); ++k) {
    const DwellRecord& dwell = stored.record.dwells[k];
    for (int j = 0; j < 3; ++j)
      bits.at(stored.measured[k]) += fmt::format("{:a} {:a} ", dwell.mean[j], dwell.u_mean.value()[j]);
  }
  return bits;
}

/// The numbers of a result of ABC that an interruption must not change: the estimates and the part of their
/// uncertainty that comes from noise. The part that comes from drift depends on when each angle was measured,
/// pauses included; so do all numbers of the joint estimator, which fits the drift.
inline nlohmann::json numbers(const std::string& analysis) {
  const nlohmann::json all = nlohmann::json::parse(analysis);
  nlohmann::json kept;
  const auto keep = [&](const char* key, const nlohmann::json& quantity) {
    kept[key].push_back(quantity.at("value"));
    kept[key].push_back(quantity.at("type_a"));
  };
  for (const nlohmann::json& row : all.at("sensitivity_matrix"))
    for (const nlohmann::json& quantity : row) keep("sensitivity_matrix", quantity);
  for (const char* key : {"offset", "intrinsic_sensitivity", "intrinsic_angle"})
    for (const nlohmann::json& quantity : all.at(key)) keep(key, quantity);
  return kept;
}

}  // namespace abcal
