#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace abcal::sim {

/// Where the status byte of a model has its summaries; 0: it has no such bit.
struct ScpiStatusLayout {
  unsigned error_queue = 0;
  unsigned operation = 1U << 7U;
  unsigned questionable = 1U << 3U;
  unsigned alarm = 0;
  unsigned measurement = 0;
};

/// The status registers of an IEEE 488.2 instrument: past events (event registers, cleared by reading), masks
/// that select them (enable registers), and the status byte that summarises the selected events.
class ScpiStatus {
 public:
  /// Bits of the standard event register.
  enum Event : unsigned {
    kOperationComplete = 1U << 0U,
    kDeviceError = 1U << 3U,
    kExecutionError = 1U << 4U,
    kCommandError = 1U << 5U,
    kPowerOn = 1U << 7U,
  };
  enum Group : std::size_t { kOperation, kQuestionable, kAlarm, kMeasurement, kGroups };

  explicit ScpiStatus(ScpiStatusLayout layout = {}) : layout_(layout) {}

  void happen(unsigned events) { standard_ |= events; }
  void latch(Group group, unsigned bits) { event_[group] |= bits; }
  /// An error of the queue counts as an event, by its number (SCPI 1999, chapter 21).
  void error(int code);

  unsigned take_standard();
  unsigned take_event(Group group);

  /// *CLS: clears the events; the masks stay.
  void clear();
  /// STATus:PRESet: clears all masks except that of the standard events.
  void preset() { enable_ = {}; }

  unsigned standard_enable = 0;  ///< *ESE
  unsigned service_enable = 0;   ///< *SRE
  unsigned& enable(Group group) { return enable_[group]; }

  /// *STB?
  unsigned status_byte(bool errors_waiting, bool output_waiting) const;

 private:
  ScpiStatusLayout layout_;
  unsigned standard_ = kPowerOn;
  std::array<unsigned, kGroups> event_{};
  std::array<unsigned, kGroups> enable_{};
};

}  // namespace abcal::sim
