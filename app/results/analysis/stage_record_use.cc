#include "app/results/analysis/stage_record_use.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <stdexcept>
#include <string>

#include "app/bench_file/stage_record_file.h"
#include "app/results/analysis/estimators.h"
#include "protocol/record/sha256.h"

namespace abcal {

void use_stored_stage_record(StoredRun& run) {
  if (run.record.stage_record.record || run.header.stage_record.empty()) return;
  const auto record = std::make_shared<const StageRecord>(parse_stage_record(
      run.header.stage_record, fmt::format("the record of the stage in {}", run.record.source)));
  run.record.stage_record = {record, months_between(record->learned_utc(), run.header.created_utc)};
}

std::string sha256_of_stage_record(const StoredRun& run) {
  if (declared_estimator(run.record).name != "joint") return {};
  if (run.record.stage_record.record) return run.record.stage_record.record->sha256;
  return run.header.stage_record.empty() ? std::string() : sha256_of(run.header.stage_record);
}

void use_stage_record(std::span<StoredRun> items, const std::shared_ptr<const StageRecord>& record,
                      const std::filesystem::path& file) {
  if (record->was_taught_by(sha256_of_file(file)))
    throw std::invalid_argument(
        fmt::format("{}: this run taught the record of the stage, whose information would count twice; "
                    "required: a record that other runs taught, or none",
                    file.string()));
  for (StoredRun& item : items) {
    const bool is_run = !item.header.bench_toml.empty();
    if (is_run) {
      if (const auto differ = differences(record->identity, stage_identity(item)); !differ.empty())
        throw std::invalid_argument(
            fmt::format("{}: the record is of another stage: {}", file.string(), fmt::join(differ, "; ")));
    }
    // A CSV has no date: its record is taken as if it was learned now.
    item.record.stage_record = {
        record, is_run ? months_between(record->learned_utc(), item.header.created_utc) : 0.0};
  }
}

}  // namespace abcal
