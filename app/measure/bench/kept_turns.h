#pragma once

#include <memory>

#include "drivers/instrument/mounted_stage.h"

namespace abcal {

/// The turns of stages that count modulo 360, kept in a file of this user for each stage (by maker, model and
/// serial number), so that another run, a resume or a restart knows how far the cable is wound. Without a
/// state folder they are kept in this process alone.
std::shared_ptr<CountedTurns> make_kept_turns();

}  // namespace abcal
