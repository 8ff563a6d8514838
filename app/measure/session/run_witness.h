#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "app/witness/witness_client.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// Has a run witnessed while it is measured (docs/witness.md): its beginning, each angle, its end. A witness
/// that does not answer delays the run by 2 s at most and never ends it: the angles are then not witnessed.
/// Used by the thread that writes the run file.
class RunWitness {
 public:
  /// @param client  null: nothing is witnessed
  /// @param warn  called with what is not witnessed, and why
  RunWitness(std::unique_ptr<WitnessClient> client, std::function<void(const std::string&)> warn);

  /// A run begins or continues: its angles are witnessed from now on. Statements that the file lacks, because
  /// its program was killed before it had stored them, are fetched.
  /// @param file  that is written
  /// @param simulated  the clock of the run jumps: only beginning and end are witnessed
  /// @throws RunFileError if the file is not what was witnessed; WitnessRefusal
  void begin(RunFile& file, const std::string& bench, const std::string& person, bool simulated);

  /// All angles are measured: waits up to 2 s for the signatures of the last ones. Call before
  /// RunFile::complete().
  void await_angles();

  /// A run that is complete, and not closed yet: its end is witnessed.
  void end(RunFile& file);

  /// Like end(), for a run whose program was killed after its last angle.
  /// @throws RunFileError if the file is not what was witnessed; WitnessRefusal
  void finish(RunFile& file);

 private:
  void fetch_missing(RunFile& file);
  void require_as_witnessed(const std::filesystem::path& path) const;

  std::unique_ptr<WitnessClient> client_;
  std::function<void(const std::string&)> warn_;
  std::string run_;
  bool has_begun_ = false, simulated_ = false;
  std::int64_t posted_ = 0;  ///< Number of the last link that was posted, or was signed before.
  bool has_warned_ = false;  ///< That angles are not witnessed.
};

}  // namespace abcal
