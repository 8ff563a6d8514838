#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/correction_registers.h"

namespace abcal {

/// Progress of an adjustment.
enum class AdjustmentState {
  kBegun,       ///< The old content is stored; registers may have been written.
  kDeclined,    ///< A person declined; nothing was written.
  kWritten,     ///< Written and read back.
  kVerified,    ///< A run afterwards agrees with the prediction.
  kSaving,      ///< Storing in the instrument has begun; it may have succeeded.
  kSaved,       ///< Kept by the instrument when it is switched off.
  kUndone,      ///< The old content is back, and was read back.
  kUndoFailed,  ///< It could not be brought back.
};
std::string_view to_string(AdjustmentState state);

/// One adjustment of an instrument, with all data needed to undo it.
struct Adjustment {
  int item = 1;  ///< Number of the item in the run.
  std::string utc;
  std::string driver, model, serial_number;
  std::string label;  ///< Serial number on the label, where the instrument reports none.
  RegisterTexts before, after;
  AdjustmentState state = AdjustmentState::kBegun;
  bool saved = false;   ///< The instrument was commanded to store `after`; an undo must be stored, too.
  std::string as_left;  ///< Run file of the verification.
  std::string why;      ///< Reason of a failure; empty: none.

  /// Whether the registers may differ from their content before the adjustment.
  bool can_be_undone() const;
  /// Whether it neither succeeded nor was undone: the program was killed, or could not undo it.
  bool is_unfinished() const;
};

/// The adjustments that were made with one run: `RUN.adjustments.json` next to it. Every change is on the
/// disk before the function returns.
class AdjustmentLog {
 public:
  /// Reads the file if it exists. @throws std::runtime_error if it cannot be read
  explicit AdjustmentLog(const std::filesystem::path& run);

  static std::filesystem::path path_beside(const std::filesystem::path& run);

  const std::filesystem::path& path() const { return path_; }
  const std::vector<Adjustment>& all() const { return all_; }
  /// The last one of an item that can be undone; null: none.
  const Adjustment* last_to_undo(int item) const;

  /// @throws std::runtime_error if it cannot be stored
  void begin(Adjustment adjustment);
  /// Replaces the stored adjustment that has the same time and item.
  void update(const Adjustment& adjustment);

 private:
  void store() const;

  std::filesystem::path path_;
  std::vector<Adjustment> all_;
};

}  // namespace abcal
