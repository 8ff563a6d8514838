#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>

#include "protocol/record/witnessed_line.h"

namespace abcal {

/// The member "do" of a line.
enum class WitnessAct {
  kBegin,  ///< "begin": a run begins.
  kLink,   ///< "link": a dwell of a run is stored.
  kClose,  ///< "close": a run is complete.
  kHead,   ///< "head": the last entry of a register's audit trail.
};

/// A request to a witness. Members that its act does not use are as initialised here. Links and heads are
/// SHA-256 as 64 hexadecimal digits in lower case; texts are UTF-8 of at most kLongestWitnessedText bytes.
struct WitnessRequest {
  WitnessAct what = WitnessAct::kBegin;
  std::string run;     ///< Begin, link, close: identity of the run; not empty.
  std::string bench;   ///< Begin: name of the bench.
  std::string person;  ///< Begin: the operator, as the run file has it.
  /// Begin: the link after which angles are witnessed: the first link of the run, or, if it continues, the
  /// last link of its dwells. Head: last link of the register.
  std::string head;
  bool simulated = false;         ///< Begin: the instruments are simulated; such a run has no links.
  std::int64_t k = 0;             ///< Link: number of the dwell, from 1. Close: number of dwells.
  std::string previous;           ///< Link: the link before; the head of the run for k = 1.
  std::string now;                ///< Link: "this". Close: last link of the dwells; the head if k = 0.
  std::string events;             ///< Close: last link of the run's events.
  std::string register_identity;  ///< Head: "register"; not empty.
  std::int64_t entries = 0;       ///< Head: number of entries of the register.

  bool operator==(const WitnessRequest&) const = default;
};

/// Longest text of a request, in bytes.
inline constexpr std::size_t kLongestWitnessedText = 200;

/// The content of a line: the request, and what the witness adds to it.
struct WitnessStatement : WitnessRequest {
  std::int64_t counter = 0;        ///< Number of the line in the log, from 1, without gaps.
  std::string utc;                 ///< System time, as format_utc() writes it.
  std::string boot_id;             ///< Names the start of the computer; empty: not known.
  std::int64_t since_boot_ns = 0;  ///< Time since the start of the computer (CLOCK_BOOTTIME).
  std::int64_t uid = 0;            ///< User ID of the process that asked.
  std::string before;              ///< "log": SHA-256 of the line before; empty for the first line.

  bool operator==(const WitnessStatement&) const = default;
};

/// "begin", "link", "close" or "head".
std::string_view to_string(WitnessAct act);

/// The act of that name. @throws std::invalid_argument
WitnessAct witness_act_from(const std::string& name);

/// Throws unless texts are valid UTF-8 and not too long, links hexadecimal, and numbers in their range.
/// @throws std::invalid_argument that names the member, what was found and what is required
void require_valid(const WitnessRequest& request);

/// The line of a statement, which must be valid.
std::string to_line(const WitnessStatement& statement);

/// Parses a line. Only the bytes that to_line() writes are accepted.
/// @throws std::invalid_argument for anything else
WitnessStatement parse_witness_line(const std::string& line);

/// A request as a JSON object: its act as "do", and the members of that act, named as in a line.
std::string to_json(const WitnessRequest& request);

/// Parses a request; the order of members does not matter.
/// @throws std::invalid_argument for malformed JSON or unknown members
WitnessRequest parse_witness_request(const std::string& json);

/// Whether the line was signed by the owner of a public key (PEM). False for a text that is not a key.
bool is_witnessed_by(const WitnessedLine& witnessed, const std::string& public_pem);

/// The witness refuses a request: it contradicts what it has signed, or is invalid. what() states what was
/// found and what is required. A repetition would be refused, too.
class WitnessRefusal : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace abcal
