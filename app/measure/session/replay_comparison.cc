#include "app/measure/session/replay_comparison.h"

#include <algorithm>

namespace abcal {
namespace {

bool is_measured_alike(const DwellRecord& a, const DwellRecord& b) {
  return a.mean == b.mean && a.count == b.count && a.lost == b.lost && a.encoder_x == b.encoder_x &&
         a.encoder_z == b.encoder_z;
}

}  // namespace

std::string end_of_run(const StoredRun& run) {
  for (const RunEvent& event : run.events) {
    for (const RunState state : {RunState::kInterrupted, RunState::kComplete, RunState::kAbandoned}) {
      if (event.kind == to_string(state)) return event.text;
    }
  }
  return "its program ended without a message (killed, or power lost)";
}

ReplayComparedEvent compare_replay(const StoredRun& recorded, const StoredRun& replayed) {
  ReplayComparedEvent comparison;
  comparison.replayed = replayed.measured.size();
  for (std::size_t k = 0; k < replayed.measured.size(); ++k) {
    const auto found = std::find(recorded.measured.begin(), recorded.measured.end(), replayed.measured[k]);
    if (found == recorded.measured.end()) continue;
    const auto before = static_cast<std::size_t>(found - recorded.measured.begin());
    if (is_measured_alike(recorded.dwells[before], replayed.dwells[k])) ++comparison.same;
  }
  comparison.recorded_end = end_of_run(recorded);
  comparison.ended_alike = comparison.recorded_end == end_of_run(replayed);
  return comparison;
}

}  // namespace abcal
