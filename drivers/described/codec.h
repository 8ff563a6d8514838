#pragma once

#include <deque>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/stage_description.h"
#include "drivers/wire/frame.h"

/// Lines of controllers that a description describes (docs/drivers/described.md).
namespace abcal::described {

/// A longer line is no reply.
inline constexpr std::size_t kLongestLine = 1024;

/// One line, up to its CR, LF or both.
wire::FrameVerdict check_line(std::string_view bytes);

/// A line without its end and without blanks around it.
std::string normal_line(std::string_view line);

/// Removes from a stream of bytes the lines that answer nothing, and the echoes of commands.
class LineFilter {
 public:
  explicit LineFilter(const StageDescription& description)
      : ignored_(description.ignored), echoes_(description.echoes) {}

  /// Whether any line is removed at all.
  bool is_needed() const { return echoes_ || !ignored_.empty(); }
  void sent(std::string_view command);
  /// The bytes of whole lines that remain; an incomplete line is kept for the next call.
  std::string pass(std::string_view bytes);
  void forget() { begun_.clear(); }

 private:
  bool is_removed(const std::string& line);

  const std::vector<ReplyForm> ignored_;
  const bool echoes_;
  std::deque<std::string> echo_;  ///< Lines that are expected to come back.
  std::string begun_;
};

}  // namespace abcal::described
