#pragma once

#include <map>
#include <string>
#include <vector>

#include "app/laboratory/register/records.h"

// Rules of the audit, for those that write it and those that check it: each entry is chained to the one
// before, and its time is not before that one's, unless an entry records that the clock was set back.

namespace abcal::lab {

/// A finding in a register, between it and a run, or between it and evidence from outside.
struct RegisterFinding {
  std::string what;
  bool good = false;
  std::string found;  ///< In words.
  /// "rollback", "fork", "rewriting", "fork or rewriting", "another register"; empty: none of them.
  std::string kind = {};
};

/// `what` of the finding of check_audit_times().
inline constexpr const char* kTimesOfAudit = "times of the audit";

/// Subject of the entry that follows when a register of an older schema is brought to step 4.
inline constexpr const char* kTimesFromHere = "schema_step/4";

/// Whether a time is before an earlier one by more than 1 s: clocks are corrected by fractions of a second.
/// @param earlier_utc  both as format_utc() writes them; false if one is not
bool runs_backwards(const std::string& earlier_utc, const std::string& utc);

/// `what` and subject of the entry that precedes one whose time is before that of its predecessor.
std::string clock_set_back(const AuditEntry& predecessor, const std::string& utc);
inline constexpr const char* kClock = "clock";

/// The chain of an entry. @param previous  chain of the entry before; empty: there is none
std::string chain_of(const std::string& previous, const AuditEntry& entry);

/// Follows the chain from the first entry to the head.
/// @param last  receives the last state of each row
RegisterFinding check_audit_chain(const std::vector<AuditEntry>& entries, const AuditHead& head,
                                  std::map<std::string, std::string>& last);

/// Whether time runs backwards without an entry that records it; names these entries.
RegisterFinding check_audit_times(const std::vector<AuditEntry>& entries);

}  // namespace abcal::lab
