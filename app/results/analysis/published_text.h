#pragma once

#include <string>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// The numbers of the published formula in five lines of text, with what they are.
std::string published_text(const PublishedResult& published);

}  // namespace abcal
