#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace abcal {

/// A file that a measurement consists of, as it was when the measurement was made.
struct MeasurementPart {
  std::filesystem::path path;  ///< Where it is now.
  std::string sha256;
};

/// NAME.measurement: the runs of one item on one stage that are evaluated together, in the order of their
/// beginning, and the record of the stage that the fit uses, if any. A JSON file of schema
/// abcal.measurement/1, which names the files relative to its own folder and is never changed; its analyses
/// are in NAME.measurement.results, as those of a run in RUN.results (docs/measurements.md).
struct MeasurementFile {
  std::string created_utc, program_version;
  int items = 1;  ///< Number of items in each run.
  std::vector<MeasurementPart> runs;
  std::optional<MeasurementPart> stage_record;
};

/// Whether a file begins as a measurement does.
bool looks_like_measurement(const std::filesystem::path& path);

/// Reads a measurement and finds its files: each under its name, or, where it was renamed or moved with the
/// measurement, as the file of the same folder that has its SHA-256.
/// @throws std::runtime_error not a measurement; all files that are missing or were changed, each with what
/// would help
MeasurementFile read_measurement(const std::filesystem::path& path);

/// The runs of a measurement; any other file stands for itself.
/// @throws as read_measurement()
std::vector<std::string> runs_of_file(const std::string& file);

/// A measurement as it is written, without a look at its files: whether they are there and unchanged is not
/// known.
/// @throws std::runtime_error not a measurement
MeasurementFile listed_measurement(const std::filesystem::path& path);

/// Writes a new measurement. Does nothing if the file is there already and names the same files.
/// @return whether it was written
/// @throws std::invalid_argument another file of this name exists
bool write_measurement(const std::filesystem::path& path, const MeasurementFile& measurement);

}  // namespace abcal
