#include "abcal/study.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <stop_token>
#include <utility>

#include "app/library/data.h"
#include "app/studies/trials/study_json.h"
#include "protocol/uncertainty/run_uncertainty.h"
#include "protocol/uncertainty/simulation_sets.h"

namespace abcal::v1 {

struct [[gnu::visibility("hidden")]] MonteCarloStudy::Data {
  ::abcal::RunUncertainty study;
  Covariance covariance;
  Eigen::MatrixXd coverage_interval;
};

namespace {

constexpr int kOutputs = ::abcal::kStudyOutputs;

Covariance covariance_of(const ::abcal::RunUncertainty& study) {
  Covariance covariance;
  covariance.matrix = study.combined.covariance;
  covariance.values = ::abcal::to_vector(study.value);
  for (int k = 0; k < kOutputs; ++k) {
    covariance.labels.emplace_back(::abcal::output_symbol(k));
    covariance.units.push_back(::abcal::output_unit(k, study.response_unit));
  }
  return covariance;
}

Eigen::MatrixXd intervals_of(const ::abcal::MonteCarloResult& result) {
  Eigen::MatrixXd intervals = Eigen::MatrixXd::Constant(kOutputs, 2, std::nan(""));
  for (std::size_t k = 0; k < result.coverage.size(); ++k)
    intervals.row(static_cast<Eigen::Index>(k)) << result.coverage[k].symmetric.low,
        result.coverage[k].symmetric.high;
  return intervals;
}

}  // namespace

std::uint64_t MonteCarloStudy::trials() const {
  return data_->study.combined.trials;
}
bool MonteCarloStudy::interrupted() const {
  return data_->study.interrupted;
}
const Covariance& MonteCarloStudy::covariance() const {
  return data_->covariance;
}
const Eigen::MatrixXd& MonteCarloStudy::coverage_interval() const {
  return data_->coverage_interval;
}
std::vector<std::string> MonteCarloStudy::warnings() const {
  return data_->study.warnings;
}
std::string MonteCarloStudy::to_json() const {
  return ::abcal::study_json(data_->study).dump(2);
}

MonteCarloStudy monte_carlo(const Record& record, const MonteCarloChoices& choices) {
  ::abcal::UncertaintyOptions options;
  if (choices.trials == 0) {
    options.trials.reset();
  } else {
    options.trials = choices.trials;
  }
  options.digits = choices.digits;
  options.seed = choices.seed;
  options.threads = choices.threads;
  options.resolution = choices.resolution;
  std::stop_source stop;
  options.stop = stop.get_token();
  if (choices.progress) {
    options.progress = [&](std::uint64_t done, std::uint64_t planned) {
      if (!choices.progress(done, planned)) stop.request_stop();
    };
  }
  MonteCarloStudy::Data data;
  data.study = ::abcal::run_uncertainty(record.data().record, options);
  data.covariance = covariance_of(data.study);
  data.coverage_interval = intervals_of(data.study.combined);
  return MonteCarloStudy(std::make_shared<const MonteCarloStudy::Data>(std::move(data)));
}

std::vector<std::string> simulation_sets() {
  return ::abcal::simulation_set_names();
}

std::string simulation_set(const std::string& set, std::uint64_t trials, std::uint64_t seed,
                           unsigned threads) {
  ::abcal::SimulationOptions options;
  if (trials > 0) options.trials = trials;
  options.seed = seed;
  options.threads = threads;
  return ::abcal::study_json(::abcal::run_simulation_set(set, options)).dump(2);
}

}  // namespace abcal::v1
