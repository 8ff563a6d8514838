#pragma once

#include <algorithm>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/port_list.h"

namespace abcal::wire {

/// A port cannot be opened because another program has it open (Fault::kCannotOpen).
class PortHeld final : public InstrumentError {
 public:
  PortHeld(std::string_view port, std::string_view detail, std::vector<PortHolder> holders)
      : InstrumentError(port, Fault::kCannotOpen, detail), holders_(std::move(holders)) {}

  /// Whether a program of this name is among those that had it open.
  bool is_held_by(std::string_view program) const {
    return std::ranges::count(holders_, program, &PortHolder::program) > 0;
  }

  const std::vector<PortHolder>& holders() const { return holders_; }

 private:
  std::vector<PortHolder> holders_;
};

}  // namespace abcal::wire
