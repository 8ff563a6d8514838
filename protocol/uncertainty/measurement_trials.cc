#include "protocol/uncertainty/measurement_trials.h"

#include <fmt/format.h>

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <string>

#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/uncertainty/random_shapes.h"

namespace abcal {
namespace {

/// As the analysis of these records takes them: in one run each item's noise is weighed again.
std::vector<MeasuredItem> measured_of(const SeriesRuns& each, bool one_run) {
  std::vector<MeasuredItem> out = each.runs;
  for (std::size_t m = 0; m < out.size() && one_run; ++m) out[m].own = &*each.own[m]->solution;
  return out;
}

MeasurementOptions options_of_measurement(const RunRecord& record, bool one_run) {
  MeasurementOptions out = options_of(record.stage_record);
  out.separates_what_repeats = !one_run || out.stage.has_value();
  return out;
}

/// An item in a run of a trial: its drawn readings and their own fit.
struct Again {
  CollectedReadings data;
  EffectSolution solution;
  RunInformation information;
};

}  // namespace

MeasurementTrials::MeasurementTrials(std::span<const RunRecord> records, std::span<const ItemInRun> places,
                                     int item, std::uint64_t seed)
    : records_(records),
      item_(static_cast<std::size_t>(item)),
      seed_(seed),
      each_(fit_each_run(records, places, {})),
      one_run_(are_of_one_run(places)),
      runs_of_item_(static_cast<double>(std::ranges::count(places, item, &ItemInRun::item))),
      options_(options_of_measurement(records.front(), one_run_)),
      measured_(measured_of(each_, one_run_)),
      truths_(measured_, options_) {
  if (!truths_.fit().converged) throw UnusableData("the common fit of these runs did not converge");
  for (std::size_t m = 0; m < records.size(); ++m) draws_.emplace_back(*each_.own[m], records[m]);
}

OutputVector MeasurementTrials::error_of(std::uint64_t trial) const {
  RandomStream effects(seed_, StreamPurpose::kEffects, trial);
  RandomStream noise(seed_, StreamPurpose::kReadings, trial);
  const EffectSizes& sizes = draws_.front().sizes();
  const MeasurementTruth truth = truths_.draw([&](const std::string& key) {
    return key.empty() ? effects.normal() : standard_draw(sizes.shape_of(key), effects);
  });
  const std::size_t first = truths_.fit().items[item_].first;
  Vector12 line = truth.lines[item_];
  std::vector<std::unique_ptr<Again>> again;
  std::vector<MeasuredItem> measured = measured_;
  for (std::size_t m = 0; m < measured_.size(); ++m) {
    const ItemFit& own = *each_.own[m];
    const EffectModel& model = draws_[m].model();
    const Eigen::Index unknowns = model.layout().count();
    JointDraw draw;
    draw.value = truth.in_runs[m].head(unknowns);
    for (std::size_t n = 0; n < model.angles(); ++n)
      draw.steps.push_back(truth.in_runs[m](unknowns + static_cast<Eigen::Index>(n)) / model.step_factor(n));
    draws_[m].draw_signs(effects, draw);
    draws_[m].draw_noise(draws_[m].choose_noise(noise), noise, draw);
    // The offset contains the mean of the noise process over the runs of the item.
    if (static_cast<std::size_t>(measured_[m].item) == item_)
      line.tail<3>() += draw.process_mean.cwiseProduct(draws_[m].units().tail<3>()) / runs_of_item_;
    Again& made = *again.emplace_back(std::make_unique<Again>());
    made.data = own.data;
    made.data.readings = draws_[m].effect_readings_of(draw);
    EffectFitOptions options = own.options;
    options.unit = model.unit();
    made.solution = solve_effects(made.data.readings, options);
    if (!made.solution.fit.converged)
      throw std::runtime_error(
          fmt::format("trial {}: the drawn readings of {} have no solution", trial, records_[m].source));
    made.information =
        run_information(made.data, made.solution, one_run_ ? RunNoise::kMostProbable : RunNoise::kMean);
    made.information.source = records_[m].source;
    measured[m].information = &made.information;
    if (measured[m].own != nullptr) measured[m].own = &made.solution;
  }
  const MeasurementFit fit = fit_measurement(measured, options_);
  if (!fit.converged)
    throw std::runtime_error(fmt::format("trial {}: the common fit of its readings did not converge", trial));
  return outputs_of_line(fit.items[item_].line + draws_[first].draw_voltmeter(effects)) -
         outputs_of_line(line);
}

void MeasurementTrials::operator()(std::uint64_t first, std::size_t count, double* out) const {
  for (std::size_t i = 0; i < count; ++i) {
    const OutputVector error = error_of(first + i);
    for (Eigen::Index k = 0; k < kStudyOutputs; ++k) out[static_cast<std::size_t>(k) * count + i] = error(k);
  }
}

}  // namespace abcal
