#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "app/measure/session/measuring_session.h"
#include "app/results/analysis/analyses.h"

namespace abcal {

/// A complete run and its results. A levelling, and an item that was dropped, have no results.
struct RunOutcome : AnalysedRun {
  std::filesystem::path path;
  std::string sha256;  ///< SHA-256 of the closed file; empty: readers keep it open, it is closed later.
  bool measured_before = false;  ///< The angles were measured earlier; now only closed and analysed.

  bool is_levelling() const;
  /// Data common to all items (state, plan, timing, events), and the first item's own.
  const StoredRun& stored() const { return items.front().stored; }
};

/// Called once with a complete run and its result: when the file is closed, or before waiting for programs
/// that read it.
using ResultListener = std::function<void(const RunOutcome& outcome)>;

/// Analyses the runs of a session by every estimator.
/// @param listener  may be empty
std::shared_ptr<RunAnalyst> make_run_analyst(ResultListener listener = {});

/// A measuring session whose complete runs are analysed. Documentation of the calls: MeasuringSession.
class RunSession : public MeasuringSession {
 public:
  struct Options : MeasuringSession::Options {
    ResultListener result_listener;  ///< May be empty.
  };

  explicit RunSession(Options options);

  RunOutcome start(const StartRequest& request);
  RunOutcome level(const StartRequest& request);
  RunOutcome resume(const ResumeRequest& request);
  RunOutcome replay(const ReplayRequest& request);

 private:
  class Analyst;
  friend std::shared_ptr<RunAnalyst> make_run_analyst(ResultListener listener);
  RunSession(Options options, const std::shared_ptr<Analyst>& analyst);
  RunOutcome outcome(MeasuredRun run) const;

  std::shared_ptr<Analyst> analyst_;
};

}  // namespace abcal
