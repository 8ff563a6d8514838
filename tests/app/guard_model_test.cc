// A model of program, guard, port and axis: every order of two faults, each before or after the answers to
// the one before. The pairs that leave an axis moving with nobody to halt it are those that docs/halting.md
// names, no more and no less.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <compare>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "tests/app/guard_faults.h"

namespace abcal {
namespace {

using testing::Contains;
using testing::IsEmpty;

enum class Process { kRuns, kEnds, kSuspends, kFrozen, kGone };

/// In the middle of a move.
struct State {
  auto operator<=>(const State&) const = default;

  Process program = Process::kRuns;
  Process guard = Process::kRuns;
  bool is_plugged = true;
  bool was_lost = false;  ///< The port, since the program got its duplicate of it.
  bool moves = true;
  std::vector<FaultKind> faults{};  ///< So far.

  /// The program can act, whether it moves the axis, ends or is about to suspend itself.
  bool program_acts() const { return program != Process::kFrozen && program != Process::kGone; }
};

/// Duties of program and guard; each can be left out, to see that the search finds the loss.
struct Rules {
  bool guard_outlives_its_owner = true;
  bool another_guard_takes_over = true;
};

/// The states after one answer of program, guard or the port.
std::vector<State> answers(const State& now, const Rules& rules) {
  std::vector<State> next;
  const auto become = [&](auto change) { change(next.emplace_back(now)); };
  if (!now.is_plugged) become([](State& s) { s.is_plugged = true; });
  // The guard: no beat, a dead owner, one that ends or asks for the halt, a port that was gone.
  if (now.moves && now.guard == Process::kRuns && now.is_plugged &&
      (now.program != Process::kRuns || now.was_lost))
    become([](State& s) { s.moves = false; });
  if (now.program_acts() && now.moves) {
    if (now.guard == Process::kFrozen) become([](State& s) { s.guard = Process::kGone; });
    if (now.guard == Process::kGone) {
      if (now.is_plugged && !now.was_lost)
        become([](State& s) { s.moves = false; });
      else if (rules.another_guard_takes_over)
        become([](State& s) { s.guard = Process::kRuns; });
    }
    if (now.program == Process::kEnds && !rules.guard_outlives_its_owner)
      become([](State& s) { s.program = s.guard = Process::kGone; });
  }
  // It has waited for the halt, or for the first attempt at one.
  if (now.program == Process::kEnds && !now.moves) become([](State& s) { s.program = Process::kGone; });
  if (now.program == Process::kSuspends && (!now.moves || (now.guard == Process::kRuns && !now.is_plugged)))
    become([](State& s) { s.program = Process::kFrozen; });
  return next;
}

/// The states after a fault that is possible now.
std::vector<State> faults(const State& now) {
  std::vector<State> next;
  for (const auto& [kind, name] : kFaults.rows) {
    State after = now;
    after.faults.push_back(kind);
    switch (kind) {
      case FaultKind::kKillProgram:
        after.program = Process::kGone;
        break;
      case FaultKind::kFreezeProgram:
        if (now.program_acts()) after.program = Process::kFrozen;
        break;
      case FaultKind::kEndProgram:
        if (now.program == Process::kRuns) after.program = Process::kEnds;
        break;
      case FaultKind::kSuspendProgram:
        if (now.program == Process::kRuns) after.program = Process::kSuspends;
        break;
      case FaultKind::kKillGuard:
        after.guard = Process::kGone;
        break;
      case FaultKind::kFreezeGuard:
        if (now.guard == Process::kRuns) after.guard = Process::kFrozen;
        break;
      case FaultKind::kUnplug:
        after.is_plugged = false;
        after.was_lost = true;
        break;
    }
    next.push_back(std::move(after));
  }
  return next;
}

/// The orders of at most `most` faults after which an axis moves and nothing more happens, in words:
/// "guard frozen, program killed".
std::set<std::string> losses(std::size_t most, const Rules& rules = {}) {
  std::set<State> seen{State{}};
  std::set<std::string> lost;
  for (std::vector<State> open(seen.begin(), seen.end()); !open.empty();) {
    const State now = std::move(open.back());
    open.pop_back();
    const std::vector<State> answered = answers(now, rules);
    const bool is_guarded = now.program == Process::kRuns && now.guard == Process::kRuns;
    if (now.moves && answered.empty() && !is_guarded) {
      std::string words;
      for (const FaultKind kind : now.faults)
        words += (words.empty() ? "" : ", ") + std::string(kFaults.of(kind));
      lost.insert(words);
    }
    for (const State& each : answered)
      if (seen.insert(each).second) open.push_back(each);
    if (now.faults.size() == most) continue;
    for (const State& each : faults(now))
      if (seen.insert(each).second) open.push_back(each);
  }
  return lost;
}

TEST(GuardModel, NoSingleFaultIsLost) {
  EXPECT_THAT(losses(1), IsEmpty());
}

TEST(GuardModel, OfTwoFaultsThoseAreLostThatTheDocumentationNames) {
  EXPECT_EQ(losses(2), named_losses());
}

TEST(GuardModel, WithoutOneOfTheRulesMoreIsLost) {
  EXPECT_THAT(losses(2, {.guard_outlives_its_owner = false, .another_guard_takes_over = true}),
              Contains("port gone, program ended"));
  EXPECT_THAT(losses(2, {.guard_outlives_its_owner = true, .another_guard_takes_over = false}),
              Contains("port gone, guard killed"));
}

}  // namespace
}  // namespace abcal
