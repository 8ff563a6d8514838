#pragma once

#include <array>
#include <chrono>
#include <deque>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/console/event.h"
#include "drivers/instrument/clock.h"
#include "protocol/record/run_file.h"

namespace abcal::console {

/// Findings of a check, for pages.
nlohmann::ordered_json findings_json(const std::vector<Finding>& findings);

/// What a page shows of the bench, put together from events: each event becomes one message, and snapshot()
/// is all that a page needs to begin with, or to catch up. Messages are JSON (docs/console.md). Of what can
/// grow without end only the latest is kept. For one thread.
class LiveView {
 public:
  /// `about` never changes: names, pace, versions. `clock` is real time, for log and time left.
  LiveView(nlohmann::ordered_json about, const Clock& clock);

  std::string apply(const Event& event);
  std::string snapshot() const;

  /// A line of the log that does not come from the measuring thread.
  std::string log(LogLine::Grade grade, std::string text) { return apply(LogLine{grade, std::move(text)}); }

 private:
  using Json = nlohmann::ordered_json;

  void begin(const RunBegan& began);
  Json on(const ActivitySeen& seen);
  Json on(const RunBegan&) { return nullptr; }  ///< begin() does it.
  Json on(const PhaseSeen& seen);
  Json on(const DwellSeen& seen);
  Json on(const StageSeen& seen);
  Json on(const StripSeen& seen);
  Json on(const LogLine& line);
  Json on(const ChecksSeen& seen);
  Json on(const ItemChecked& seen);
  Json on(const ItemDropped& seen);
  Json on(const QueueSeen& seen);
  Json on(const PortsSeen& seen);
  Json on(const LevelSeen& seen);
  Json on(const RunEnded& ended);
  Json on(const HaltSeen& seen);
  Json on(const FaultSeen& seen);
  Json on(const GuardSeen& seen);
  Json on(const InterruptedSeen& seen);
  Json phase_json() const;

  void store(const DwellSeen& seen);
  void store_items(const DwellSeen& seen);
  Json fit_of(int experiment) const;
  Json progress() const;

  Json about_;
  const Clock& clock_;
  ActivitySeen activity_;
  std::optional<RunBegan> run_;
  std::map<std::size_t, ItemDwell> dwells_;  ///< By position in the plan; of several items the first's.
  /// One of several items, as far as it was measured.
  struct ItemSeen {
    ItemSummary summary;
    std::size_t measured = 0;
    std::optional<ItemReading> last;
    std::string dropped;  ///< Why it takes no part any more; empty: it does.
  };
  static Json item_json(const ItemSeen& item);
  Json items_json() const;
  std::vector<ItemSeen> items_;  ///< Empty: there is one.
  std::optional<PhaseSeen> phase_;
  std::optional<RunEnded> ended_;
  std::optional<HaltSeen> halt_;  ///< The last of the current or last activity.
  std::optional<FaultSeen> fault_;
  std::string guard_;
  std::optional<InterruptedRun> interrupted_;
  std::optional<ChecksSeen> checks_;
  Json queue_, ports_, levelling_;
  std::array<StageSeen, 2> stage_{StageSeen{StageAxis::kX, {}, {}}, StageSeen{StageAxis::kZ, {}, {}}};
  std::deque<Json> strip_;              ///< Of all items.
  std::map<int, std::size_t> streams_;  ///< In the strip, by item.
  std::deque<Json> log_;
  std::optional<Clock::Instant> last_dwell_;  ///< Unless the run was held since.
  std::deque<double> dwell_intervals_s_;      ///< Real time from one angle to the next.
};

}  // namespace abcal::console
