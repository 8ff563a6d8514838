#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/console/run_choice.h"
#include "app/measure/session/item_check.h"

namespace abcal::console {

/// An item and a plan that wait for the bench.
struct QueueEntry {
  std::int64_t number = 0;        ///< Identifies the entry; never reused.
  RunChoice choice;               ///< Contains an item.
  int wanted = 1;                 ///< Number of runs.
  std::vector<std::string> made;  ///< Names of the runs that are complete.
  std::string now;                ///< Name of the run in progress; empty: none.
  Message problem;                ///< Why its last run is not complete; empty: no problem.
  std::string interrupted;        ///< Name of that run, which may be resumed and then counts.

  bool is_done() const { return static_cast<int>(made.size()) >= wanted; }
};

/// The items and plans that a bench measures one after another. Kept on the disk at each change, so that it
/// outlives every process; after a restart it is paused. Knows nothing of instruments, and starts no run.
/// For one thread.
class Queue {
 public:
  using Refusal = std::optional<Message>;
  static constexpr std::size_t kMostEntries = 200;
  static constexpr int kMostRuns = 100;

  /// Reads `file`. A file that cannot be read is reported by problem(), and is not overwritten.
  explicit Queue(std::filesystem::path file);

  const Message& problem() const { return problem_; }
  bool paused() const { return paused_; }
  const std::vector<QueueEntry>& entries() const { return entries_; }
  /// The entry that is measured next; null: none is left.
  const QueueEntry* next() const;
  /// The entry of a run that is in progress; null: none.
  const QueueEntry* running() const;

  Refusal add(const RunChoice& choice, int wanted);
  /// @param by  places towards the end; entries done or in progress keep their place
  Refusal move(std::int64_t number, int by);
  Refusal remove(std::int64_t number);
  /// Adds one run to an entry; if the entry is done, as a new entry at the end.
  Refusal repeat(std::int64_t number);
  Refusal pause(bool paused);

  /// The mounted item was checked. @param of  the entry whose item should be mounted
  void checked(std::int64_t of, ItemCheck check);
  /// Something else was done at the bench: from now on the mounted item is unknown.
  void unchecked() {
    check_.reset();
    mounted_ = 0;
  }
  /// Why the entry cannot be started now, or nothing.
  Refusal may_start(std::int64_t number) const;
  /// Why the item of the entry cannot be checked now, or nothing.
  Refusal may_check(std::int64_t number) const;

  void began(std::int64_t number, const std::string& run);
  /// A run ended. @return whether it belongs to the queue
  bool ended(const std::string& run, bool complete, const Message& words);
  /// The run of an entry failed before it had a file.
  void did_not_begin(std::int64_t number);
  /// The item of the queue that was measured last.
  const ItemBefore& before() const { return before_; }
  /// The entry of the item that stays mounted, if a further run of it is wanted; null: none, or the queue is
  /// paused.
  const QueueEntry* repeats() const;

  /// For pages.
  nlohmann::ordered_json json() const;

 private:
  QueueEntry* find(std::int64_t number);
  std::vector<QueueEntry>::const_iterator waiting() const;
  Refusal keep();
  void read();

  struct Checked {
    std::int64_t of = 0;
    ItemCheck check;
  };

  std::filesystem::path file_;
  std::vector<QueueEntry> entries_;
  std::int64_t last_number_ = 0;
  bool paused_ = true;
  Message problem_;
  std::optional<Checked> check_;
  std::int64_t mounted_ = 0;  ///< The entry whose run ended last, complete, with nothing done since.
  ItemBefore before_;
};

}  // namespace abcal::console
