#pragma once

#include <string>
#include <vector>

#include "tests/app/certificate/statement_reader.h"

namespace abcal::test {

/// The relations between statements of different names that a customer can verify, with the printed numbers
/// and the coefficients of correlation of the XML alone: M is the inverse of S and has the uncertainty of S
/// and of the offsets; the intrinsic sensitivities and angles are those of the rows of S, the bias is offset
/// by sensitivity, and the change of the output for one g_loc is the sensitivity per m/s2 times g_loc, whose
/// uncertainty only the latter has. A quantity whose U was raised to a scope may have a larger one than it
/// follows from the others, never a smaller one.
/// @param reading  claims of the same calibration
/// @return every relation that does not hold, in words
std::vector<std::string> broken_relations(const std::string& xml, const Reading& reading, bool last = true);

}  // namespace abcal::test
