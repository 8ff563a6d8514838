#include "app/measure/session/session_observer.h"

#include "protocol/record/run_file.h"

namespace abcal {

void SessionObserver::phase(std::size_t position, RunPhase phase) {
  const bool holding = phase == RunPhase::kHolding;
  if (held_ && !holding) notify(ContinuedEvent{position});
  held_ = holding;
  notify(PhaseEvent{position, phase});
  if (phase == RunPhase::kMoving) notify(AngleBegunEvent{position});
  if (holding) notify(HeldEvent{position});
}

void SessionObserver::dwells(std::size_t position, std::span<const ItemDwell> dwells) {
  DwellDoneEvent done{position, {}};
  for (const ItemDwell& each : dwells) done.dwells.emplace(each.item, each.dwell);
  notify(done);
}

void SessionObserver::notice(std::string_view kind, const Message& text, std::optional<int> item) {
  if (kind == kFlagEvent) {
    notify(FlagEvent{text, item});
  } else if (kind == kPortLostEvent) {
    notify(PortLostEvent{text});
  } else if (kind == kReconnectedEvent) {
    notify(PortBackEvent{text});
  } else {
    notify(NoticeEvent{std::string(kind), text, item});
  }
}

}  // namespace abcal
