#include "app/commands/table_options.h"

#include <fmt/format.h>

#include <string_view>

#include "app/commands/shell_word.h"
#include "app/system/output.h"

namespace abcal {

void add_table_options(CLI::App& command, TableOptions& options) {
  command.add_option(
      "--columns", options.columns,
      "of a table: names of its columns in their order, in place of a header: t,x,y,z; \"-\" is "
      "ignored (docs/your_file.md)");
  command.add_option("--unit", options.unit, "of a table: unit of its readings, such as g, m/s2, V or LSB");
  command.add_option("--topic", options.topic, "of a log with several (ROS bag, ULog): the topic to be read");
  command.add_option("--time-unit", options.time_unit, "of a time series: s, ms, us or ns");
  command.add_flag("--keep-mapping", options.keep,
                   "of a table: keep these four in FILE.mapping.toml beside it, which states them when the "
                   "table is read again");
}

std::string with_table_options(const std::string& file, const TableOptions& options) {
  if (options.is_empty() || options.keep) return file;  // The mapping states what is kept.
  std::string words = typed_word(file);
  const auto add = [&](std::string_view option, const std::string& value) {
    // After "=", names that begin with "-" are no option.
    if (!value.empty()) words += fmt::format(" {}={}", option, typed_word(value));
  };
  add("--columns", options.columns);
  add("--unit", options.unit);
  add("--time-unit", options.time_unit);
  add("--topic", options.topic);
  return words;
}

void say_how_read(const std::string& file, const RunRecord& record) {
  for (const std::string& line : record.read_as) print_log("{}: {}\n", file, line);
}

}  // namespace abcal
