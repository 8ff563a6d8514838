#pragma once

#include <string>
#include <vector>

#include "protocol/uncertainty/monte_carlo.h"

namespace abcal {

/// Several processes, on one machine or several, that make the trials of one study together. All of them run
/// the same program on the same input, so each can make any trial; only the leader distributes them. The
/// leader merges the blocks in their order as it does alone, so the result has the same bits for any team.
class MonteCarloTeam {
 public:
  virtual ~MonteCarloTeam() = default;

  virtual bool leads() const = 0;

  /// Leader: one TrialBlock for every thread of the other processes; each is to be called from one thread.
  /// The others must have called, or be about to call, serve().
  virtual std::vector<TrialBlock> hands(int outputs) = 0;

  /// Leader: ends serve() of the others, which return this result.
  virtual void dismiss(const MonteCarloResult& result) = 0;

  /// Leader: ends serve() of the others, which throw std::runtime_error with this text.
  virtual void dismiss(const std::string& failure) = 0;

  /// Others: makes the blocks that the leader asks for, with `threads` threads (0: as many as there are),
  /// until it dismisses them. @returns the leader's result.
  virtual MonteCarloResult serve(int outputs, const TrialBlock& block, unsigned threads) = 0;
};

}  // namespace abcal
