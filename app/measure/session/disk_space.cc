#include "app/measure/session/disk_space.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>
#include <system_error>

namespace abcal {
namespace {

// Sizes in a run file, rounded up from measured ones.
constexpr double kBytesOfReading = 70.0;
constexpr double kBytesOfAngle = 1500.0;           // Its row, its row of the plan, its events.
constexpr double kBytesOfRecordedReading = 200.0;  // The bytes of the wire and the row that holds them.
constexpr double kBytesOfRecordedSecond = 5000.0;  // Questions to a moving stage.
constexpr double kBytesAlways = 8e6;               // Header, the write-ahead log (at most 4 MB), results.
/// Free space below this multiple of the estimate gives a warning.
constexpr std::uintmax_t kAmple = 3;

std::string in_megabytes(std::uintmax_t bytes) {
  return fmt::format("{:.1f} MB", static_cast<double>(bytes) / 1e6);
}

}  // namespace

std::uintmax_t estimated_run_bytes(const DiskNeed& need) {
  const auto angles = static_cast<double>(need.angles);
  double bytes = kBytesAlways +
                 angles * (kBytesOfAngle + kBytesOfReading * static_cast<double>(need.readings_per_angle));
  if (need.with_recording) {
    bytes += need.duration_s * (kBytesOfRecordedSecond + kBytesOfRecordedReading * need.rate_hz);
  }
  return static_cast<std::uintmax_t>(std::ceil(bytes));
}

std::optional<Message> check_disk_space(const std::filesystem::path& run_file, const DiskNeed& need,
                                        std::optional<std::uintmax_t> free_bytes) {
  const std::uintmax_t required = estimated_run_bytes(need);
  if (!free_bytes || *free_bytes >= kAmple * required) return std::nullopt;
  const std::string file = run_file.string();
  const auto free = in_megabytes(*free_bytes), wanted = in_megabytes(required);
  const Message found = need.with_recording
                            ? Message(
                                  "{file}: {free} are free on this disk; required: about {required} for "
                                  "{angles} angles of {readings} readings with a recording",
                                  file, free, wanted, need.angles, need.readings_per_angle)
                            : Message(
                                  "{file}: {free} are free on this disk; required: about {required} for "
                                  "{angles} angles of {readings} readings",
                                  file, free, wanted, need.angles, need.readings_per_angle);
  if (*free_bytes < required) {
    throw Telling<std::runtime_error>(
        Message("{found}. Free some space, or choose another disk with -o", found));
  }
  return Message("{found}. Make sure that nothing else fills the disk during the run", found);
}

std::optional<std::uintmax_t> free_disk_space(const std::filesystem::path& file) {
  std::error_code error;
  const std::filesystem::path folder = file.has_parent_path() ? file.parent_path() : ".";
  const std::filesystem::space_info space = std::filesystem::space(folder, error);
  if (error || space.available == static_cast<std::uintmax_t>(-1)) return std::nullopt;
  return space.available;
}

}  // namespace abcal
