#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "protocol/record/sqlite.h"

namespace abcal {

/// meta `schema` of a run file.
inline constexpr std::string_view kRunSchemaName = "abcal.run/3";

/// What the chain of dwells begins with: SHA-256, in hexadecimal, over all that stands before the first angle
/// (facts but state and timing, instruments, items, registers, plan).
std::string head_link(SqliteDatabase& database);

/// The link of a dwell: SHA-256, in hexadecimal, over the link before, the columns of its session that are
/// known at its beginning, all its own but the link, and all of its readings. docs/run_file.md says which
/// bytes.
std::string dwell_link(SqliteDatabase& database, std::int64_t dwell, std::string_view before);

/// Computes the link of the dwell that was written last, and stores it.
void link_dwell(SqliteDatabase& database, std::int64_t dwell);

}  // namespace abcal
