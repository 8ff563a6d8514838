#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <string>
#include <vector>

#include "drivers/instrument/reply_pattern.h"

namespace abcal {

/// State of one axis after a halt. There is no "probably": an axis that did not acknowledge may be moving.
enum class AxisHalt {
  kHalted,       ///< Its controller has confirmed standstill.
  kUnreachable,  ///< Its controller did not confirm it: it may be moving.
};

/// Result of a halt for each axis of a stage.
struct HaltReport {
  std::array<AxisHalt, 2> axes{AxisHalt::kUnreachable, AxisHalt::kUnreachable};  ///< By index(StageAxis).

  static HaltReport of_both(bool halted) {
    const AxisHalt both = halted ? AxisHalt::kHalted : AxisHalt::kUnreachable;
    return {{both, both}};
  }
  bool all_halted() const { return axes[0] == AxisHalt::kHalted && axes[1] == AxisHalt::kHalted; }
  bool operator==(const HaltReport&) const = default;
};

/// For messages and records: "axis X: halted; axis Z: unreachable, may be moving".
std::string in_words(const HaltReport& report);

/// How to halt the axes on one port, or to leave a thermal chamber, without the driver, e.g. from another
/// process on an inherited descriptor after this one has died in the middle of a command: plain data.
/// wire::carry_out() does it.
struct HaltRecipe {
  /// A question whose reply reports whether the axes are at rest, or, without `standing`, separates older
  /// replies from later ones. It may also be a command; each waits for its reply.
  struct Question {
    bool operator==(const Question&) const = default;

    std::string bytes;
    ReplyPattern reply;     ///< Replies to this question; others are skipped.
    ReplyPattern standing;  ///< Replies that report standstill; empty: does not matter.
    /// Several devices may answer: all replies within this time after the first must report standstill.
    std::chrono::milliseconds listen{0};
  };

  bool operator==(const HaltRecipe&) const = default;

  std::string driver;                          ///< For messages: "pi_gcs".
  std::array<bool, 2> axes{};                  ///< Axes on this port, by index(StageAxis).
  std::string end_partial;                     ///< Ends a half-written command so that it is not carried out.
  std::string stop;                            ///< Stops all axes; its reply is not awaited.
  std::vector<Question> questions;             ///< In this order, after each stop.
  std::chrono::milliseconds reply_time{1000};  ///< For a reply; a stop is repeated after it.
  std::vector<std::string> further_stops{};    ///< Commands behind `stop`, each after the gap.
  /// Least time between two commands, also after `end_partial`: an earlier one would be lost.
  std::chrono::milliseconds gap{0};
  std::string reply_end{};  ///< Terminator of a reply; empty: CR, LF or both.
  /// Replies have no visible end: patterns are searched for in the newest kLongestHaltReply bytes since the
  /// question. Otherwise a pattern is for one whole reply without its terminator, and a longer reply is
  /// skipped up to its terminator.
  bool binary = false;
  /// For a chamber: its action afterwards, in words ("is driven to 23 degC"). Empty for a stage.
  std::string chamber{};
};

}  // namespace abcal
