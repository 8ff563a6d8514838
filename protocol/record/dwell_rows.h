#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "drivers/instrument/clock.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_record.h"
#include "protocol/record/sqlite.h"

namespace abcal {

/// Origin of the times of a session's dwells.
struct SessionTimes {
  std::int64_t session = 1;             ///< Row of the table `session`.
  std::int64_t origin_ns = 0;           ///< True time from the first session's beginning to this one's.
  std::optional<Clock::UtcTime> begun;  ///< UTC at its beginning.
};

/// Writes dwells with their readings and their link of the chain. Within a transaction.
class DwellWriter {
 public:
  DwellWriter(SqliteDatabase& database, const SessionTimes& times) : database_(database), times_(times) {}

  /// Values of a row in addition to the dwell and its readings.
  struct Row {
    std::optional<std::int64_t> id{};  ///< Absent: the next.
    int item = 1;
    std::span<const EncoderSample> encoder{};
  };
  void write(std::int64_t position, const DwellRecord& dwell, std::span<const StoredReading> readings,
             const Row& row);

 private:
  SqliteDatabase& database_;
  SessionTimes times_;
};

/// Temperatures as whole multiples of a step, from the first: exact for every finite double, and short where
/// the sensor's resolution is coarse.
struct TemperatureScale {
  double first_degc = 0.0;
  double step_degc = 1.0;
  bool whole = true;  ///< False: no step fits all; a multiple is the value itself then.
};
/// @return nothing where no reading has a finite temperature
std::optional<TemperatureScale> temperature_scale(std::span<const StoredReading> readings);

/// The dwells of an item that count, in the order of measurement, with their positions in the plan.
void read_counting_dwells(SqliteDatabase& database, int item,
                          const std::function<void(std::size_t position, DwellRecord dwell)>& each);

/// Every dwell with its readings, in the order of measurement.
/// @param item  whose; 0: of all items
void read_all_dwells(SqliteDatabase& database, const std::function<void(const StoredDwell& dwell)>& each,
                     int item);

struct DwellWithReadings {
  DwellRecord dwell;
  std::vector<StoredReading> readings;
};
/// A row of the tables dwell_2 and reading_2, into which an upgrade renames those of version 2.
DwellWithReadings read_dwell_of_version_2(SqliteDatabase& database, std::int64_t id);

}  // namespace abcal
