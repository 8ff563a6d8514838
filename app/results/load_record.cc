#include "app/results/load_record.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "app/results/other_file.h"
#include "protocol/record/import_csv.h"

namespace abcal {

LoadedRecord load_record(const std::filesystem::path& path, int item) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) throw std::runtime_error(path.string() + ": no such file");
  if (std::filesystem::is_directory(path, error)) {
    throw std::runtime_error(path.string() + ": is a folder; required: a run file or a CSV");
  }
  if (!std::filesystem::is_regular_file(path, error))
    throw std::runtime_error(path.string() + ": not a file; required: a run file or a CSV");
  if (RunFile::looks_like_run_file(path)) {
    StoredRun run = RunFile::load(path, std::max(item, 1));
    if (item == 0 && run.items.size() > 1)
      throw std::invalid_argument(fmt::format(
          "{} has {} items; required: a run of one. `abcal report {} --item K --csv FILE` gives the "
          "averaged readings of one item",
          path.string(), run.items.size(), path.string()));
    RunRecord record = run.record;
    return {std::move(record), std::move(run)};
  }
  refuse_other_file(path, kRunOrCsv);
  return {import_csv(path), std::nullopt};
}

}  // namespace abcal
