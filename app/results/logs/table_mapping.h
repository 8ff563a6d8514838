#pragma once

#include <filesystem>
#include <string>

#include "protocol/record/table_columns.h"

namespace abcal {

/// The file beside a table that keeps what the table does not state: "a.csv.mapping.toml".
std::filesystem::path mapping_path(const std::filesystem::path& table);

/// The options with what the mapping of the table states and they do not. Without a mapping the options
/// alone.
/// @param words  receives "unit and columns as a.csv.mapping.toml states"; empty: nothing is from a mapping
/// @throws std::runtime_error  with every problem of the mapping
TableOptions with_mapping(const std::filesystem::path& table, const TableOptions& options,
                          std::string& words);

/// Writes the options into the mapping of the table, in place of the one that is there.
/// @throws std::invalid_argument  nothing is stated
/// @throws std::runtime_error
void keep_mapping(const std::filesystem::path& table, TableOptions options);

}  // namespace abcal
