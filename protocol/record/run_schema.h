#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "protocol/record/sqlite.h"

namespace abcal {

inline constexpr std::int64_t kRunFileApplicationId = 0x4142434C;  // "ABCL"
/// 1: the first; 2: events are chained and name the person; 3: sessions, items, roles, compact and chained
/// readings; 4: the witness; 5: faces, constant rate.
inline constexpr std::int64_t kRunFileVersion = 5;

/// Makes the tables and views of the present version in an empty file, and marks it as a run file.
void create_run_schema(SqliteDatabase& database);

/// Version of the tables of an open run file.
std::int64_t run_file_version(SqliteDatabase& database);

/// Whether plan and dwells of an open run file state their face, and whether the stage passed or was at rest
/// (since version 5).
bool has_faces(SqliteDatabase& database);

/// Whether the losses within a dwell of an open run file are in the table reading_gap (since version 5),
/// before in a column of `reading`.
bool has_reading_gaps(SqliteDatabase& database);

/// Opens a run file of any version up to the present, without checking for damage, which takes as long as
/// reading all of it.
/// @throws RunFileError if it is not a run file, or is newer than this program
SqliteDatabase open_run_file_unchecked(const std::filesystem::path& path, SqliteDatabase::Mode mode);

/// Like open_run_file_unchecked(), but tries again once if the disk fails.
/// @throws RunFileError also for a damaged file; DiskError: it could not be read
SqliteDatabase open_run_file(const std::filesystem::path& path, SqliteDatabase::Mode mode);

/// The first bytes of a file, fewer if it is shorter; none if it is not a readable file
/// (SqliteDatabase::first_bytes). @throws DiskError
std::string first_bytes(const std::filesystem::path& path, std::size_t count);
/// Whether a file begins as an SQLite file does. @throws DiskError
bool begins_as_sqlite(const std::filesystem::path& path);

/// Turns a file of an older version, which is open for writing, into one of the present: step by step, all in
/// one transaction. Closed runs are never changed.
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
