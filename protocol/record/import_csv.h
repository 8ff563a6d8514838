#pragma once

#include <filesystem>
#include <istream>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/plan/run_config.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// Every problem of a CSV at once. what() lists them, one a line: "FILE: line 12, r_u: found ...; required:
/// ...".
class CsvError : public std::runtime_error {
 public:
  CsvError(const std::string& source, std::vector<Problem> problems);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// Averaged readings of the three experiments from a CSV: `experiment,n,alpha_deg,r_u,r_v,r_w`, optional
/// columns `u_u,u_v,u_w` (standard uncertainty of each mean, R), `time_s`, `count`, `temperature_degc`,
/// `flags` (bits of DwellFlag) and `closing` (0 or 1); columns in any order, others ignored; `#` begins a
/// comment line. RFC 4180 quotes; comma, or semicolon with decimal comma; LF or CRLF; a byte order mark is
/// skipped. Without a column `closing`, an alpha of 360 degrees is the closing angle if the same experiment
/// has an alpha of 0. Missing angles are allowed: the analysis reports whether the rest determines the fit.
/// Encoder angles are absent.
///
/// Comments "# key: value" hold the data without columns, with the keys of a run file's table `meta`:
/// `response_unit` (names R), `g_loc.*`, `tolerances.*`, `alignment.*`, `protocol.step_deg` and
/// `protocol.steps`, `continuations`, `row_order: time` (without times: the rows are in the order of
/// measurement). Absent entries have their defaults; g_loc is then not known.
/// @throws CsvError with every problem: missing or repeated column, text in a number or in
///         a comment that must hold a number, not finite, repeated row,
///         unknown experiment, too few angles in an experiment (3 are needed)
/// @throws std::runtime_error the file cannot be read
RunRecord import_csv(const std::filesystem::path& path);

/// Like import_csv(path), from a stream; `source` names it in messages.
RunRecord import_csv(std::istream& input, const std::string& source);

}  // namespace abcal
