#pragma once

#include <string>

namespace abcal {

/// `abcal run BENCH --repeat K`: several runs of one accelerometer, and their summary.
struct CampaignOptions {
  std::string bench_file;
  std::string output;  ///< "a" or "a.run" makes a-1.run, a-2.run, ...; empty: the bench file's name and time.
  int repeat = 0;
  bool remount = false;                ///< A person remounts the accelerometer between the runs.
  bool keep_complete_runs = false;     ///< Runs that are complete are kept, only the others are measured.
  bool without_missing_items = false;  ///< Measure the other items if some are missing.
  bool json = false;
};

/// Measures, stores and summarises. A failure of one run ends the campaign; the earlier runs are kept.
/// @return the exit code of the program
/// @throws as `abcal run`; std::invalid_argument if an output file exists, for --remount without a terminal
int run_campaign(const CampaignOptions& options);

}  // namespace abcal
