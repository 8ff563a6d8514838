#include "app/commands/table_options.h"

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
}

void say_how_read(const std::string& file, const RunRecord& record) {
  for (const std::string& line : record.read_as) print_log("{}: {}\n", file, line);
}

}  // namespace abcal
