#include "sim/firmware/scpi_status.h"

#include <utility>

namespace abcal::sim {
namespace {

constexpr unsigned kMessageAvailable = 1U << 4U;
constexpr unsigned kStandardEvents = 1U << 5U;
constexpr unsigned kService = 1U << 6U;

}  // namespace

void ScpiStatus::error(int code) {
  if (code <= -100 && code > -200) return happen(kCommandError);
  if (code <= -200 && code > -300) return happen(kExecutionError);
  happen(kDeviceError);
}

unsigned ScpiStatus::take_standard() {
  return std::exchange(standard_, 0U);
}

unsigned ScpiStatus::take_event(Group group) {
  return std::exchange(event_[group], 0U);
}

void ScpiStatus::clear() {
  standard_ = 0;
  event_ = {};
}

unsigned ScpiStatus::status_byte(bool errors_waiting, bool output_waiting) const {
  const auto summary = [&](Group group, unsigned bit) {
    return (event_[group] & enable_[group]) != 0 ? bit : 0U;
  };
  unsigned byte = summary(kOperation, layout_.operation) | summary(kQuestionable, layout_.questionable) |
                  summary(kAlarm, layout_.alarm) | summary(kMeasurement, layout_.measurement);
  if (errors_waiting) byte |= layout_.error_queue;
  if (output_waiting) byte |= kMessageAvailable;
  if ((standard_ & standard_enable) != 0) byte |= kStandardEvents;
  if ((byte & service_enable) != 0) byte |= kService;
  return byte;
}

}  // namespace abcal::sim
