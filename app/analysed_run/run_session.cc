#include "app/analysed_run/run_session.h"

#include <utility>

#include "app/results/analysis/load_record.h"
#include "app/results/analysis/recompute.h"
#include "app/results/analysis/result_text.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {

/// Keeps the analysis of the run that was analysed last.
class RunSession::Analyst final : public RunAnalyst {
 public:
  explicit Analyst(ResultListener listener) : listener_(std::move(listener)) {}

  Conclusion analyse(const MeasuredRun& run) override {
    analysed_ = analyse_run(run.items);
    Conclusion conclusion;
    Verdict worst = Verdict::kUsable;
    for (AnalysedItem& item : analysed_.items) {
      if (item.stored.own_progress().dropped_at) item.results.clear();
      if (item.results.empty()) continue;
      const CalibrationResult& result = item.result();
      if (!conclusion.verdict.empty() && result.verdict >= worst) continue;
      worst = result.verdict;
      conclusion.verdict = verdict_words(worst);
      const std::string which = about_item(item.stored, "", "");
      conclusion.reason = worst == Verdict::kUsable || which.empty()
                              ? result.why
                              : Message("{item}: {why}", which, result.why);
    }
    return conclusion;
  }

  void announce(const MeasuredRun& run) override {
    if (listener_) listener_(outcome(run));
  }

  void keep(ResultsFile& results, const MeasuredRun&, const std::string& utc) const override {
    for (const AnalysedItem& item : analysed_.items) {
      for (const CalibrationResult& each : item.results) keep_analysis(results, utc, each, item.stored);
      // The common fit of all items also has a result for an item that was dropped.
      if (item.results.empty())
        keep_analysis(results, utc,
                      analysed_.joint.items.at(static_cast<std::size_t>(item.stored.item) - 1).result,
                      item.stored);
    }
  }

  std::size_t least_analyses() const override { return estimators().size(); }

  RunOutcome outcome(MeasuredRun run) const {
    RunOutcome outcome;
    outcome.path = std::move(run.path);
    outcome.sha256 = std::move(run.sha256);
    outcome.measured_before = run.measured_before;
    if (run.is_levelling()) {
      for (StoredRun& item : run.items) outcome.items.push_back({std::move(item), {}});
    } else {
      static_cast<AnalysedRun&>(outcome) = analysed_;
    }
    return outcome;
  }

 private:
  ResultListener listener_;
  AnalysedRun analysed_;
};

std::shared_ptr<RunAnalyst> make_run_analyst(ResultListener listener) {
  return std::make_shared<RunSession::Analyst>(std::move(listener));
}

bool RunOutcome::is_levelling() const {
  return !has_experiments(stored().header.plan);
}

namespace {

MeasuringSession::Options with_analyst(MeasuringSession::Options options,
                                       std::shared_ptr<RunAnalyst> analyst) {
  options.analyst = std::move(analyst);
  return options;
}

}  // namespace

RunSession::RunSession(Options options)
    : RunSession(options, std::make_shared<Analyst>(options.result_listener)) {}

RunSession::RunSession(Options options, const std::shared_ptr<Analyst>& analyst)
    : MeasuringSession(with_analyst(std::move(options), analyst)), analyst_(analyst) {}

RunOutcome RunSession::outcome(MeasuredRun run) const {
  return analyst_->outcome(std::move(run));
}

RunOutcome RunSession::start(const StartRequest& request) {
  return outcome(MeasuringSession::start(request));
}

RunOutcome RunSession::level(const StartRequest& request) {
  return outcome(MeasuringSession::level(request));
}

RunOutcome RunSession::resume(const ResumeRequest& request) {
  return outcome(MeasuringSession::resume(request));
}

RunOutcome RunSession::replay(const ReplayRequest& request) {
  return outcome(MeasuringSession::replay(request));
}

}  // namespace abcal
