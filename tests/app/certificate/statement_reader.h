#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/document/document.h"

namespace abcal::test {

// Reads the statements of a certificate as a customer would: from its XML, its page, its text, with nothing
// of the program that writes them but the parser of XML. Units are its own.

/// A number as it is printed: its value, and one unit of its last digit.
struct PrintedNumber {
  double value = 0.0, digit = 0.0;
};

/// One statement in SI units (V/(m/s2), rad, m/s2, 1).
struct Claim {
  std::string where;  ///< "XML abc_offsets", "page: Results"
  std::string
      quantity;  ///< "intrinsic_sensitivity_u"; of the change of the output for one g_loc: "g_loc*..."
  PrintedNumber value, expanded;
  std::string factor;   ///< k as printed; empty: none is given.
  std::string verdict;  ///< As the schema names it; empty: no decision.
};

/// The statements of a certificate, and all contradictions that one place has within itself: a verdict that
/// does not follow from the printed numbers and limits, a stated limit that is not the converted one, a
/// covariance or a budget that does not belong to U/k.
struct Reading {
  std::vector<Claim> claims;
  std::vector<std::string> contradictions;
  double g_loc_mps2 = 0.0;
  int calibrations = 1, decisions = 0, budget_lines = 0, marked_outside = 0, marked_raised = 0;
};

/// The SI unit's number in one of a unit of D-SI: 1e-3 for "\milli\volt".
double factor_of_d_si(const std::string& unit);

/// @param last  the last calibration of the certificate; else the first, before adjustment
Reading read_xml(const std::string& xml, bool last = true);

/// The statements of certificate_json(). @param xml  its source, for the definitions of units
Reading read_json(const nlohmann::ordered_json& certificate, const std::string& xml, bool last = true);

/// @param xml  for the value of local gravity, and the meaning of units that are counts
Reading read_page(const Document& page, const Reading& xml);

/// Lines of the text of pages, as pdftotext or a terminal shows them.
Reading read_text(const std::string& text, const Reading& xml);

/// Any two statements of one quantity that say different things, in words.
std::vector<std::string> disagreements(const std::vector<Claim>& claims);

/// Statements of pages that none of the calibrations makes in the same words: pages show all of them.
std::vector<std::string> not_stated(const std::vector<Claim>& claims,
                                    const std::vector<Reading>& calibrations);

}  // namespace abcal::test
