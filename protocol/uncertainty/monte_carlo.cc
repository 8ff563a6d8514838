#include "protocol/uncertainty/monte_carlo.h"

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

#include "protocol/uncertainty/monte_carlo_team.h"

namespace abcal {

namespace {

// JCGM 101 7.9.4: M = max(J, 1e4) trials between two checks of the digits, J = 100/(1 - p).
constexpr std::uint64_t kSmallestLook = 10'000;
constexpr std::uint64_t kGridTrials = 10'000;   // that set the grid of the histograms
constexpr std::uint64_t kMostKept = 1'000'000;  // values kept of each output: 144 MB for 18 outputs
constexpr std::uint64_t kFewestForInterval = 100;

// The values of one block and the figures that the merge needs.
struct Block {
  std::uint64_t count = 0;
  std::vector<double> values;  // output k of trial i at [k * count + i]
  Eigen::VectorXd mean;
  Eigen::MatrixXd scatter;  // sum of (value - mean)(value - mean)^T
};

// Memory of one worker, so that it is not asked of the system again for every block.
struct WorkSpace {
  std::vector<double> values;  // goes into the block
  Eigen::MatrixXd centred;
};

Block make_block(int outputs, const TrialBlock& trial_block, std::uint64_t first, std::uint64_t count,
                 WorkSpace& space) {
  Block block;
  block.count = count;
  block.values = std::move(space.values);
  block.values.resize(static_cast<std::size_t>(outputs) * count);
  trial_block(first, count, block.values.data());
  const auto rows = static_cast<Eigen::Index>(count);
  const Eigen::Map<const Eigen::MatrixXd> values(block.values.data(), rows, outputs);
  block.mean = values.colwise().mean();
  if (!block.mean.allFinite()) {
    for (Eigen::Index k = 0; k < outputs; ++k) {
      for (Eigen::Index i = 0; i < rows; ++i) {
        if (std::isfinite(values(i, k))) continue;
        throw std::runtime_error("trial " + std::to_string(first + static_cast<std::uint64_t>(i)) +
                                 ": output " + std::to_string(k) + " is not finite");
      }
    }
    throw std::runtime_error("trials from " + std::to_string(first) + ": values too large to be averaged");
  }
  Eigen::MatrixXd& centred = space.centred;
  centred = values.rowwise() - block.mean.transpose();
  block.scatter.resize(outputs, outputs);
  for (Eigen::Index a = 0; a < outputs; ++a) {
    for (Eigen::Index b = a; b < outputs; ++b) {
      block.scatter(a, b) = block.scatter(b, a) = centred.col(a).dot(centred.col(b));
    }
  }
  return block;
}

// Average and its standard deviation over the looks of an adaptive run (JCGM 101 7.9.4 e to g).
class RunningAverage {
 public:
  void add(double x) {
    ++n_;
    const double delta = x - mean_;
    mean_ += delta / static_cast<double>(n_);
    squares_ += delta * (x - mean_);
  }
  double standard_deviation_of_mean() const {
    const auto n = static_cast<double>(n_);
    return std::sqrt(squares_ / (n * (n - 1.0)));
  }

 private:
  std::uint64_t n_ = 0;
  double mean_ = 0.0, squares_ = 0.0;
};

class Engine {
 public:
  Engine(int outputs, const TrialBlock& trial_block, const MonteCarloOptions& options)
      : outputs_(outputs),
        trial_block_(trial_block),
        options_(options),
        planned_(options.trials.value_or(0)),
        last_(options.trials.value_or(options.most_trials)),
        keep_(options.trials && *options.trials > kMostKept ? std::min(kGridTrials, *options.trials)
                                                            : kMostKept),
        mean_(Eigen::VectorXd::Zero(outputs)),
        scatter_(Eigen::MatrixXd::Zero(outputs, outputs)),
        kept_(static_cast<std::size_t>(outputs)),
        looks_(static_cast<std::size_t>(outputs)) {
    const double j = std::ceil(100.0 / (1.0 - options.coverage_probability) - 1e-9);
    const auto look = std::max(static_cast<std::uint64_t>(j), kSmallestLook);
    look_trials_ = (look + options_.block - 1) / options_.block * options_.block;
    for (std::vector<double>& values : kept_)
      values.reserve(static_cast<std::size_t>(std::min(last_, keep_)));
  }

  MonteCarloResult run() {
    unsigned threads =
        options_.threads != 0 ? options_.threads : std::max(1U, std::thread::hardware_concurrency());
    const std::uint64_t blocks = (last_ + options_.block - 1) / options_.block;
    threads = static_cast<unsigned>(std::min<std::uint64_t>(threads, blocks));
    const std::vector<TrialBlock> hands =
        options_.team != nullptr ? options_.team->hands(outputs_) : std::vector<TrialBlock>{};
    look_ahead_ = 4ULL * (threads + hands.size());
    {
      std::vector<std::jthread> workers;
      for (const TrialBlock& hand : hands) workers.emplace_back([this, &hand] { work(hand); });
      for (unsigned i = 1; i < threads; ++i) workers.emplace_back([this] { work(trial_block_); });
      work(trial_block_);
    }
    if (failure_) std::rethrow_exception(failure_);
    return result();
  }

 private:
  void work(const TrialBlock& trial_block) {
    WorkSpace space;
    std::unique_lock lock(mutex_);
    while (true) {
      // A worker that is much ahead of the merge waits, so that memory stays bounded.
      room_.wait(lock, [this] { return finished_ || next_block_ < next_merge_ + look_ahead_; });
      if (finished_ || options_.stop.stop_requested() || next_block_ * options_.block >= last_) return;
      const std::uint64_t index = next_block_++;
      const std::uint64_t first = index * options_.block;
      if (!spare_.empty()) {
        space.values = std::move(spare_.back());
        spare_.pop_back();
      }
      lock.unlock();
      std::optional<Block> block;
      std::exception_ptr failure;
      try {
        block = make_block(outputs_, trial_block, first, std::min(options_.block, last_ - first), space);
      } catch (...) {
        failure = std::current_exception();
      }
      lock.lock();
      if (failure) {
        if (!failure_) failure_ = failure;
        finished_ = true;
      } else if (!finished_) {
        done_.emplace(index, std::move(*block));
        merge_what_is_next();
      }
      room_.notify_all();
    }
  }

  // Merges blocks in their order, whichever thread made them, so that sums do not depend on the number of
  // threads.
  void merge_what_is_next() {
    try {
      for (auto it = done_.find(next_merge_); it != done_.end() && !finished_; it = done_.find(next_merge_)) {
        merge(it->second);
        spare_.push_back(std::move(it->second.values));
        done_.erase(it);
        ++next_merge_;
        if (options_.progress) options_.progress(trials_, planned_);
      }
    } catch (...) {
      failure_ = std::current_exception();
      finished_ = true;
    }
  }

  void merge(const Block& block) {
    const auto n_a = static_cast<double>(trials_);
    const auto n_b = static_cast<double>(block.count);
    const Eigen::VectorXd delta = block.mean - mean_;
    mean_ += delta * (n_b / (n_a + n_b));
    scatter_ += block.scatter + delta * delta.transpose() * (n_a * n_b / (n_a + n_b));
    trials_ += block.count;
    for (std::size_t k = 0; k < kept_.size(); ++k) {
      const auto begin = block.values.begin() + static_cast<std::ptrdiff_t>(k * block.count);
      const auto end = begin + static_cast<std::ptrdiff_t>(block.count);
      if (grids_.empty()) {
        kept_[k].insert(kept_[k].end(), begin, end);
      } else {
        for (auto value = begin; value != end; ++value) grids_[k].add(*value);
      }
    }
    if (!options_.trials) look(block);
    if (grids_.empty() && trials_ >= keep_ && trials_ < last_ && !finished_) pour_into_grids();
  }

  // From here on no single values are kept: the grid is set by the first 1e4, and takes all there are.
  void pour_into_grids() {
    for (std::vector<double>& values : kept_) {
      const auto n = static_cast<Eigen::Index>(std::min<std::size_t>(values.size(), kGridTrials));
      const Eigen::Map<const Eigen::VectorXd> first(values.data(), n);
      const double centre = first.mean();
      const double u = std::sqrt((first.array() - centre).square().sum() / static_cast<double>(n - 1));
      GridHistogram& grid = grids_.emplace_back(centre, u);
      for (const double value : values) grid.add(value);
      std::vector<double>().swap(values);
    }
  }

  void look(const Block& block) {
    look_values_.insert(look_values_.end(), block.values.begin(), block.values.end());
    if (trials_ % look_trials_ != 0) return;
    // look_values_ holds blocks of options_.block trials, each output by output.
    const std::size_t blocks = look_trials_ / options_.block;
    const auto k_count = static_cast<std::size_t>(outputs_);
    std::vector<double> one(look_trials_);
    ++look_count_;
    reached_ = Eigen::VectorXd::Zero(outputs_);
    for (std::size_t k = 0; k < k_count; ++k) {
      for (std::size_t b = 0; b < blocks; ++b) {
        const auto from =
            look_values_.begin() + static_cast<std::ptrdiff_t>((b * k_count + k) * options_.block);
        std::copy_n(from, options_.block, one.begin() + static_cast<std::ptrdiff_t>(b * options_.block));
      }
      const Eigen::Map<const Eigen::VectorXd> values(one.data(), static_cast<Eigen::Index>(one.size()));
      const double mean = values.mean();
      const double u =
          std::sqrt((values.array() - mean).square().sum() / static_cast<double>(one.size() - 1));
      const CoverageInterval interval = coverage_of(one, options_.coverage_probability).symmetric;
      std::array<RunningAverage, 4>& averages = looks_[k];
      averages[0].add(mean);
      averages[1].add(u);
      averages[2].add(interval.low);
      averages[3].add(interval.high);
      if (look_count_ < 2) continue;
      const auto i = static_cast<Eigen::Index>(k);
      const double u_all = std::sqrt(scatter_(i, i) / static_cast<double>(trials_ - 1));
      const double tolerance = numerical_tolerance(u_all, options_.digits) / options_.tolerance_divisor;
      for (const RunningAverage& average : averages) {
        const double twice = 2.0 * average.standard_deviation_of_mean();
        reached_(i) = std::max(reached_(i), twice == 0.0 ? 0.0 : twice / tolerance);
      }
    }
    look_values_.clear();
    if (look_count_ >= 2 && (reached_.array() <= 1.0).all()) converged_ = finished_ = true;
  }

  MonteCarloResult result() {
    MonteCarloResult result;
    result.trials = trials_;
    result.adaptive = !options_.trials;
    result.converged = options_.trials ? trials_ == last_ : converged_;
    result.interrupted = !result.converged && options_.stop.stop_requested();
    result.coverage_probability = options_.coverage_probability;
    result.mean = mean_;
    result.reached = reached_;
    const auto add_note = [&](const std::string& note) {
      result.note += (result.note.empty() ? "" : " ") + note;
    };
    if (result.interrupted) {
      add_note("Interrupted after " + std::to_string(trials_) + " trials: these are all that was made.");
    } else if (!result.converged) {
      add_note("The stated digits were not reached in " + std::to_string(trials_) + " trials.");
    }
    if (trials_ < 2) {
      const double nan = std::numeric_limits<double>::quiet_NaN();
      if (trials_ == 0) result.mean.setConstant(nan);
      result.standard_deviation = Eigen::VectorXd::Constant(outputs_, nan);
      result.covariance = Eigen::MatrixXd::Constant(outputs_, outputs_, nan);
      return result;
    }
    result.covariance = scatter_ / static_cast<double>(trials_ - 1);
    result.standard_deviation = result.covariance.diagonal().cwiseSqrt();
    if (trials_ < kFewestForInterval) {
      add_note("Too few trials for a coverage interval.");
      return result;
    }
    if (grids_.empty()) {
      result.interval_method = IntervalMethod::kExact;
      for (std::vector<double>& values : kept_) {
        result.coverage.push_back(coverage_of(values, options_.coverage_probability));
        std::vector<double>().swap(values);
      }
    } else {
      result.interval_method = IntervalMethod::kHistogram;
      for (const GridHistogram& grid : grids_)
        result.coverage.push_back(grid.coverage(options_.coverage_probability));
      add_note("Coverage intervals from a histogram with bins of 0.001 u set by the first 10000 trials.");
    }
    return result;
  }

  const int outputs_;
  const TrialBlock& trial_block_;
  const MonteCarloOptions& options_;
  const std::uint64_t planned_;
  const std::uint64_t last_;  // one past the last trial
  const std::uint64_t keep_;  // trials after which values go to the grids
  std::uint64_t look_trials_ = kSmallestLook;
  std::uint64_t look_ahead_ = 4;

  std::mutex mutex_;
  std::condition_variable room_;
  // Guarded by mutex_:
  bool finished_ = false, converged_ = false;
  std::exception_ptr failure_;
  std::uint64_t next_block_ = 0, next_merge_ = 0, trials_ = 0;
  std::map<std::uint64_t, Block> done_;     // made, but an earlier block is not
  std::vector<std::vector<double>> spare_;  // memory of blocks that were merged
  Eigen::VectorXd mean_;
  Eigen::MatrixXd scatter_;
  std::vector<std::vector<double>> kept_;
  std::vector<GridHistogram> grids_;
  std::vector<double> look_values_;
  std::vector<std::array<RunningAverage, 4>> looks_;
  std::uint64_t look_count_ = 0;
  Eigen::VectorXd reached_;
};

}  // namespace

double numerical_tolerance(double u, int digits) {
  if (!(u > 0.0)) return 0.0;
  // u = c 10^l with c a whole number of `digits` digits; rounding may carry (9.96 -> 10).
  int l = static_cast<int>(std::floor(std::log10(u))) - digits + 1;
  if (std::round(u / std::pow(10.0, l)) >= std::pow(10.0, digits)) ++l;
  return 0.5 * std::pow(10.0, l);
}

MonteCarloResult run_monte_carlo(int outputs, const TrialBlock& block, const MonteCarloOptions& options) {
  if (outputs < 1) throw std::invalid_argument("Monte Carlo: no outputs");
  if (options.trials && *options.trials < 2) {
    throw std::invalid_argument("number of trials = " + std::to_string(*options.trials) +
                                ", at least 2 are needed");
  }
  if (options.digits != 1 && options.digits != 2) {
    throw std::invalid_argument("significant digits = " + std::to_string(options.digits) +
                                ", must be 1 or 2");
  }
  if (!(options.coverage_probability > 0.0 && options.coverage_probability < 1.0)) {
    throw std::invalid_argument("coverage probability must lie between 0 and 1");
  }
  if (!(options.tolerance_divisor > 0.0)) throw std::invalid_argument("tolerance divisor must be above 0");
  if (!options.trials && options.most_trials < 2 * kSmallestLook) {
    throw std::invalid_argument("an adaptive run needs room for at least 20000 trials");
  }
  MonteCarloTeam* const team = options.team;
  if (team == nullptr) return Engine(outputs, block, options).run();
  if (!team->leads()) return team->serve(outputs, block, options.threads);
  try {
    MonteCarloResult result = Engine(outputs, block, options).run();
    team->dismiss(result);
    return result;
  } catch (const std::exception& failure) {
    team->dismiss(failure.what());
    throw;
  }
}

}  // namespace abcal
