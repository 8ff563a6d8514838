#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "protocol/record/sqlite.h"

namespace abcal {

inline constexpr std::int64_t kRunFileApplicationId = 0x4142434C;  // "ABCL"
/// 1: the first; 2: events are chained and name the person; 3: sessions, items, roles, compact and chained
/// readings; 4: the witness; 5: faces, constant rate; 6: links cover every column, and events and conditions.
inline constexpr std::int64_t kRunFileVersion = 6;

/// Makes the tables and views of a version in an empty file, and marks it as a run file.
/// @param version  from 3
void create_run_schema(SqliteDatabase& database, std::int64_t version = kRunFileVersion);

/// Makes a table that only some runs have: `wire` (with the recording of the wire), `item_drop` (continued
/// without an item), `message` (has events with messages).
void create_optional_table(SqliteDatabase& database, std::string_view name);

/// Version of the tables of an open run file.
std::int64_t run_file_version(SqliteDatabase& database);

/// Whether plan and dwells of an open run file state their face, and whether the stage passed or was at rest
/// (since version 5).
bool has_faces(SqliteDatabase& database);

/// Whether the losses within a dwell of an open run file are in the table reading_gap (since version 5),
/// before in a column of `reading`.
bool has_reading_gaps(SqliteDatabase& database);

/// Whether the links of an open run file cover every column of every table (since version 6).
bool links_all(SqliteDatabase& database);

/// Opens a run file of any version up to the present, without checking for damage, which takes as long as
/// reading all of it.
/// @throws RunFileError if it is not a run file, is newer than this program, or has a table, column, view,
/// index or trigger that no run file of its version has; if a closed run has a log beside it
SqliteDatabase open_run_file_unchecked(const std::filesystem::path& path, SqliteDatabase::Mode mode);

/// Like open_run_file_unchecked(), but tries again once if the disk fails.
/// @throws RunFileError also for a damaged file; DiskError: it could not be read
SqliteDatabase open_run_file(const std::filesystem::path& path, SqliteDatabase::Mode mode);

/// The state of a run file, read without checking for damage; tries again once if the disk fails.
/// @throws as open_run_file()
std::optional<std::string> state_of_run_file(const std::filesystem::path& path);

/// The first bytes of a file, fewer if it is shorter; none if it is not a readable file
/// (SqliteDatabase::first_bytes). @throws DiskError
std::string first_bytes(const std::filesystem::path& path, std::size_t count);
/// Whether an SQLite file is a bag of ROS 2, whose readings are read as a table: it is no run file.
bool is_ros2_bag(const std::filesystem::path& path);
/// Whether a file begins as an SQLite file does. @throws DiskError
bool begins_as_sqlite(const std::filesystem::path& path);

/// Whether a file has a write-ahead log, as its own header states: a connection that only reads does not
/// change a file without one. @throws DiskError
bool uses_write_ahead_log(const std::filesystem::path& path);

/// Turns a file of version 2 to 4, which is open for writing, into one of version 5: step by step, all in one
/// transaction. Files of version 5 stay as they are, since their links do. Closed runs are never changed.
/// @throws RunFileError for a version that cannot be continued
void upgrade_run_schema(SqliteDatabase& database, const std::filesystem::path& path);

/// The step from version 2 to 5, within a transaction. The dwells become those of one session, with the times
/// that version 2 gave them: pauses between its sessions are not in them.
void upgrade_run_schema_2_to_5(SqliteDatabase& database);

/// The step from version 3 to 4, within a transaction. The links stay valid: meta `schema` stays as it was.
void upgrade_run_schema_3_to_4(SqliteDatabase& database);

/// The step from version 4 to 5, within a transaction: all existing rows are of face 1, which adds nothing to
/// the links.
void upgrade_run_schema_4_to_5(SqliteDatabase& database);

}  // namespace abcal
