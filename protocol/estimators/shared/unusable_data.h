#pragma once

#include <stdexcept>
#include <string>

#include "drivers/text/message.h"

namespace abcal {

/// These data cannot be analysed: they contradict the assumptions of the analysis, or do not determine its
/// result. what() states the value found and the value required. An estimator refuses data with this
/// exception only; any other exception that leaves it is a fault of the program.
class UnusableData : public Telling<std::runtime_error> {
 public:
  using Telling::Telling;
  explicit UnusableData(const std::string& text) : UnusableData(Message::bare(text)) {}
};

}  // namespace abcal
