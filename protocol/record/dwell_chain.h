#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"

namespace abcal {

/// meta `schema` of a run file.
inline constexpr std::string_view kRunSchemaName = "abcal.run/6";

/// First link of the chain of dwells: SHA-256, in hexadecimal, over everything stored before the first angle
/// (facts but state and timing, instruments, items, registers, plan).
std::string head_link(SqliteDatabase& database);

/// The link of a dwell that is stored: SHA-256, in hexadecimal, over the link before, the columns of its
/// session that are known at its beginning, all its own but the link, and all of its readings; since version
/// 6 also over the events, conditions and dropped items up to the dwell. docs/run_file.md defines the bytes.
std::string dwell_link(SqliteDatabase& database, std::int64_t dwell, std::string_view before);

/// The last link of a run file's dwells, which names its readings and everything before them; empty in a file
/// of version 2, and before the first angle.
/// @throws RunFileError if the file is not a run file
std::string last_dwell_link(const std::filesystem::path& run);

/// Dwells that were stored together, in one transaction, so that a run has all of them or none, and that a
/// witness signs them at once: those of all items at an angle of the plan, or at all angles of a sweep.
struct StoredTogether {
  std::int64_t position = 0;    ///< In the plan: of the first angle.
  std::size_t angles = 1;       ///< Angles of the plan.
  int experiment = 0, n = 0;    ///< Those of the first angle; 0: a check pose.
  bool is_swept = false;        ///< The stage passed the angles; else it stood.
  bool is_check = false;        ///< Measured again for comparison: one angle, also of a sweep.
  double reading_time_s = 0.0;  ///< Number of readings over the rate of the item; 0: the rate is not known.
  std::string link;             ///< Link of the last dwell.
};

/// The dwells of a run file of version 3 or later, in the order of their writing.
/// @param from  ID of the first one that is asked for
std::vector<StoredTogether> stored_together(SqliteDatabase& database, std::int64_t from = 0);

/// The links of a run file of version 3 or later.
struct RunLinks {
  std::string head;  ///< head_link(): identifies the run.
  std::vector<StoredTogether> stored;
  std::string closing;  ///< closing_link().
};
/// @throws RunFileError if the file is not a run file
RunLinks run_links(const std::filesystem::path& run);

/// SHA-256, in hexadecimal, over everything that no link of a dwell covers: all facts with state and timing,
/// the last link of the events, ends of sessions, conditions of the room, dropped items, the seal, and the
/// recording of the wire.
std::string closing_link(SqliteDatabase& database);

/// A reading as its row holds it, without the dwell.
struct ReadingRow {
  std::int64_t k = 0;
  Eigen::Vector3d output = Eigen::Vector3d::Zero();  ///< Values that are not finite are stored as null.
  std::int64_t skipped = 0;
  std::int64_t late_ns = 0;
  std::variant<std::monostate, std::int64_t, double> temperature_steps;  ///< monostate: null.
};

/// Computes dwell_link() of the dwell that is written last while its readings are written, and stores it.
class DwellLink {
 public:
  /// @param dwell its row is written, without a link; none of its readings has been added
  DwellLink(SqliteDatabase& database, std::int64_t dwell);
  void add(const ReadingRow& reading);
  void store();

 private:
  SqliteDatabase& database_;
  std::int64_t dwell_;
  Sha256 hash_;
};

}  // namespace abcal
