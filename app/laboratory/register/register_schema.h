#pragma once

#include <span>
#include <string>
#include <string_view>

#include "app/laboratory/register/database.h"

namespace abcal::lab {

/// A table of the register and its columns, in the order in which a backup has them.
struct TableDescription {
  std::string_view name;
  std::span<const std::string_view> columns;
  std::string_view order;  ///< Columns that order its rows.
  int since_step = 1;      ///< The schema step that made it.
};

/// The newest schema step: registers of an older one are brought to it when they are opened.
inline constexpr int kNewestSchemaStep = 5;

/// Every table of the newest schema.
std::span<const TableDescription> register_tables();

/// "select a, b from TABLE order by ..." for all columns of a table.
std::string select_all(const TableDescription& table);

/// Makes the tables, step by step, from where the database is. Within a transaction.
/// @param database_step  0: an empty database
/// @param to_step        the last step to be made
void apply_schema_steps(Database& database, int database_step, const std::string& utc,
                        int to_step = kNewestSchemaStep);

/// The schema step of a register. @throws RegisterError if it is newer than this program
int schema_step(Database& database);

}  // namespace abcal::lab
