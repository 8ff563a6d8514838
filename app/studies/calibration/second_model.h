#pragma once

#include <cstdint>

#include "app/studies/trials/measured_run.h"

namespace abcal {

/// A run at rest on one face as docs/theory has it (model.md, effects.md), written apart from the simulator
/// and from the estimators: no time but that of the plan, no instruments, readings that are drawn. Where an
/// item may do one of two things, it does the one that the simulator does not: a drift of the sensitivity
/// acts after what bends the response, and hysteresis with a width is that of Preisach's relays.
/// @param bench  with its truth drawn; of the stage's errors those of the theory are read
/// @param seed   of the noise and of the step errors without memory
MeasuredRecords measure_by_theory(const StudyBench& bench, std::uint64_t seed);

}  // namespace abcal
