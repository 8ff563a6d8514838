#include "app/session/session_observer.h"

#include <utility>

#include "protocol/record/run_file.h"

namespace abcal {

void SessionObserver::phase(std::size_t position, RunPhase phase) {
  const bool holding = phase == RunPhase::kHolding;
  if (held_ && !holding) tell(ContinuedEvent{position});
  held_ = holding;
  tell(PhaseEvent{position, phase});
  if (phase == RunPhase::kMoving) tell(AngleBegunEvent{position});
  if (holding) tell(HeldEvent{position});
}

void SessionObserver::dwell(std::size_t position, const DwellRecord& dwell) {
  tell(DwellDoneEvent{position, dwell});
}

void SessionObserver::dwells(std::size_t position, std::span<const ItemDwell> dwells) {
  // Of several items the only one that is left is named, unless it is the first.
  if (dwells.size() == 1 && dwells.front().item == 1) return dwell(position, dwells.front().dwell);
  DwellDoneEvent done{position, dwells.front().dwell};
  for (const ItemDwell& each : dwells)
    done.items.push_back({each.item, each.dwell.mean, each.dwell.flags, each.dwell.temperature_degc});
  tell(std::move(done));
}

void SessionObserver::notice(std::string_view kind, std::string_view text) {
  if (kind == kFlagEvent) {
    tell(FlagEvent{std::string(text)});
  } else if (kind == kPortLostEvent) {
    tell(PortLostEvent{std::string(text)});
  } else if (kind == kReconnectedEvent) {
    tell(PortBackEvent{std::string(text)});
  } else {
    tell(NoticeEvent{std::string(kind), std::string(text)});
  }
}

}  // namespace abcal
