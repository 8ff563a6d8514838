#include "protocol/estimators/series/series_fit.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/series/size_posterior.h"
#include "protocol/estimators/shared/normal_matrix.h"
#include "protocol/estimators/shared/side_by_side.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/cholesky.h"
#include "protocol/linear/products.h"
#include "protocol/plan/mountings.h"

namespace abcal {
namespace {

/// Largest number of iterations; the model is linear but for the turns of the item.
constexpr int kMostIterations = 30;
/// An iteration that would lower chi2 by less is the last one.
constexpr double kNegligibleFall = 1e-8;
/// In units of `step_deg`: where the axis has its zero its error is minus its mean, F, and its smooth part.
constexpr double kFreeAtZero = 100.0;

/// Whether an own unknown belongs to one run alone.
bool is_of_run(const EffectLayout::OwnUnknown& own) {
  return own.effect->kind == ItemEffectKind::kDrift;
}

Eigen::Matrix3d rotation(const Eigen::Vector3d& turn) {
  const double angle = turn.norm();
  if (angle == 0.0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
}

/// The turn of the item in a run against its first run.
Eigen::Matrix3d turn_between(const RunInformation& first, const RunInformation& run) {
  constexpr double kNear = 0.15;  // radian: 8 degrees
  const Eigen::Matrix3d rows = run.rows();
  const Eigen::Matrix3d* best = nullptr;
  double least = std::numeric_limits<double>::infinity();
  for (const Eigen::Matrix3d& turn : turns_of_cube()) {
    const double distance = (rows - first.rows() * turn).norm();
    if (distance < least) {
      least = distance;
      best = &turn;
    }
  }
  if (least > kNear * first.rows().norm())
    throw UnusableData(fmt::format(
        "{}: the item is not mounted as in {} or turned against it by multiples of 90 degrees about the "
        "axes of the platter (nearest: {:.1f} degrees off); mount it so, or leave this run out",
        run.source, first.source, least / first.rows().norm() * 180.0 / std::numbers::pi));
  return *best;
}

/// The information of one run with its own unknowns eliminated. The quadratic form is again that of all
/// unknowns q of the run; those of the run alone count as zero in it.
struct Eliminated {
  Eigen::MatrixXd weight;
  Eigen::VectorXd pull;
  double squares = 0.0;
  double log_determinant = 0.0;
  std::vector<Eigen::Index> own;  ///< Eliminated unknowns of the run, as places in q.
  Eigen::VectorXd own_weight;     ///< Weights of their priors.
  Cholesky own_normal;            ///< Their normal matrix, the other unknowns given.
  Eigen::MatrixXd follow;         ///< Minus the derivatives of their best values by q.
  Eigen::VectorXd own_change;     ///< Their best values where q is at the point of the linear model.
};

class Series {
 public:
  Series(std::span<const SeriesRun> runs, const SeriesOptions& options);
  SeriesFit result();

 private:
  struct Item {
    int first_run = 0;
    Eigen::Index at = 0;  ///< Place of its unknowns.
    EffectLayout layout;
  };
  struct Run {
    const RunInformation* of = nullptr;
    int item = 0;
    Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
    Eigen::Index mounting = -1;         ///< Place of its small turn; -1: zero.
    std::vector<Eigen::Index> to_all;   ///< Place of each unknown q among all; -1: s, or of the run alone.
    std::vector<Eigen::Index> of_rows;  ///< The nine places of s in q, row by row.
  };
  using Sizes = std::array<double, kRepeatParts>;
  /// One element of s in a run: its derivatives by some of all unknowns.
  struct ByTurn {
    Eigen::Index q = 0;
    std::array<Eigen::Index, 6> to{};
    std::array<double, 6> value{};
    std::size_t count = 0;
  };

  void list_stage();
  void list_items();
  void list_runs();
  void set_priors();
  void share_steps(const Sizes& sizes);
  Eigen::MatrixXd known_before();
  Eigen::VectorXd start() const;
  Eliminated eliminate(const Run& run, const Sizes& sizes) const;
  Eigen::Matrix3d turn_of(const Run& run) const;
  Eigen::VectorXd q_of(const Run& run) const;
  std::vector<ByTurn> turned_rows(const Run& run) const;
  Eigen::MatrixXd jacobian_of(const Run& run) const;
  void add(const Run& run, const Eliminated& information);
  void add_up(const std::vector<Eliminated>& runs);
  std::vector<Eliminated> eliminate_all(const Sizes& sizes) const;
  bool solve(const Sizes& sizes);
  double log_likelihood(const Sizes& sizes);
  Sizes estimate_sizes(SeriesFit& out);
  SeriesItem item_result(std::size_t i) const;
  void add_shares(std::size_t i, SeriesItem& item) const;
  SeriesRunResult run_result(std::size_t k) const;

  SeriesOptions options_;
  const EffectSizes& sizes_;
  std::vector<Run> runs_;
  std::vector<Item> items_;
  StageState stage_;  ///< Names and angles; mean and covariance as known before.
  Eigen::Index count_ = 0;
  Eigen::MatrixXd prior_;  ///< Weights of the priors of all unknowns.
  Eigen::VectorXd prior_mean_;
  std::vector<Eigen::Index> new_angles_;  ///< Places of the fine map of which nothing is known before.
  double map_log_determinant_ = 0.0;      ///< log det of the covariance of their priors.
  double stage_log_determinant_ = 0.0;    ///< Likewise of the rest of the stage.
  std::vector<std::pair<std::string, std::string>>
      effect_of_;  ///< Effect and key of each unknown, for budgets.

  Eigen::VectorXd point_;  ///< Small turns: of the present linear model.
  std::vector<Eliminated> eliminated_;
  Eigen::MatrixXd normal_;
  Eigen::VectorXd right_;
  double squares_ = 0.0, log_determinant_ = 0.0;
  NormalMatrix solved_;
  Eigen::VectorXd change_;
  double chi2_ = 0.0;
  int iterations_ = 0;
  Eigen::MatrixXd covariance_;
};

Series::Series(std::span<const SeriesRun> runs, const SeriesOptions& options)
    : options_(options),
      sizes_(runs.empty() ? throw std::invalid_argument("series: no runs")
                          : runs.front().information->sizes) {
  for (const SeriesRun& run : runs) {
    Run& own = runs_.emplace_back();
    own.of = run.information;
    own.item = run.item;
  }
  list_stage();
  list_items();
  list_runs();
  set_priors();
  point_ = start();
}

/// The unknowns of the stage in the order of the table of effects, then its fine map.
void Series::list_stage() {
  if (options_.stage) stage_ = *options_.stage;
  std::vector<std::string> names = stage_.names;
  std::vector<AxisAngle> angles = stage_.angles;
  for (const Run& run : runs_) {
    for (const EffectSizeKey& key : effect_size_keys())
      if (key.section == "stage_uncertainty" && key.get(run.of->sizes) != key.get(sizes_))
        throw UnusableData(fmt::format(
            "{}: {} is {:g}, but {:g} in {}: runs of one stage state the same sizes of it; analyse "
            "them with one bench file",
            run.of->source, key.key, key.get(run.of->sizes), key.get(sizes_), runs_.front().of->source));
    for (std::size_t i = 0; i < run.of->layout.stage.size(); ++i) {
      const std::string& name =
          run.of->unknowns[static_cast<std::size_t>(run.of->layout.first_stage()) + i].name;
      if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
    }
    angles.insert(angles.end(), run.of->visits.begin(), run.of->visits.end());
  }
  std::sort(angles.begin(), angles.end());
  angles.erase(std::unique(angles.begin(), angles.end()), angles.end());
  if (!(sizes_.step.rad() > 0.0)) angles.clear();
  stage_.names = std::move(names);
  stage_.angles = std::move(angles);
}

void Series::list_items() {
  count_ = stage_.size();
  for (std::size_t k = 0; k < runs_.size(); ++k) {
    const Run& run = runs_[k];
    if (run.item == static_cast<int>(items_.size())) {
      Item item{.first_run = static_cast<int>(k), .at = count_, .layout = {}};
      for (const EffectLayout::OwnUnknown& own : run.of->layout.own)
        if (!is_of_run(own)) item.layout.own.push_back(own);
      count_ += 3 * item.layout.own_count();
      items_.push_back(std::move(item));
    }
    if (run.item < 0 || run.item >= static_cast<int>(items_.size()))
      throw std::invalid_argument("series: items are numbered from 0 in the order of their first runs");
    const RunInformation& first =
        *runs_[static_cast<std::size_t>(items_[static_cast<std::size_t>(run.item)].first_run)].of;
    if (run.of->unit != first.unit)
      throw std::invalid_argument("series: an item has one unit in all its runs");
  }
}

void Series::list_runs() {
  for (std::size_t k = 0; k < runs_.size(); ++k) {
    Run& run = runs_[k];
    const Item& item = items_[static_cast<std::size_t>(run.item)];
    run.turn = turn_between(*runs_[static_cast<std::size_t>(item.first_run)].of, *run.of);
    if (static_cast<int>(k) != item.first_run) {
      run.mounting = count_;
      count_ += 3;
    }
    const EffectLayout& layout = run.of->layout;
    run.to_all.assign(static_cast<std::size_t>(run.of->at.size()), -1);
    for (int j = 0; j < 3; ++j) {
      const auto first = static_cast<std::size_t>(layout.own_count() * j);
      Eigen::Index to = item.at + item.layout.own_count() * j + 3;
      for (std::size_t i = 0; i < 3; ++i) run.of_rows.push_back(static_cast<Eigen::Index>(first + i));
      run.to_all[first + 3] = to++;
      std::size_t shared = 0;
      for (std::size_t i = 0; i < layout.own.size(); ++i) {
        if (is_of_run(layout.own[i])) continue;
        if (shared >= item.layout.own.size() || item.layout.own[shared].effect != layout.own[i].effect)
          throw UnusableData(fmt::format("{}: other effects of the item are stated than in {}",
                                         run.of->source,
                                         runs_[static_cast<std::size_t>(item.first_run)].of->source));
        ++shared;
        run.to_all[first + EffectLayout::kOwnFixed + i] = to++;
      }
    }
    const auto first_stage = static_cast<std::size_t>(layout.first_stage());
    for (std::size_t i = 0; i < layout.stage.size(); ++i)
      run.to_all[first_stage + i] = stage_.place_of(run.of->unknowns[first_stage + i].name);
    for (std::size_t n = 0; n < run.of->visits.size(); ++n)
      run.to_all[static_cast<std::size_t>(layout.count()) + n] = stage_.place_of(run.of->visits[n]);
  }
}

/// Covariance of the stage before these runs, in the order of stage_: what options state, and the sizes for
/// the rest.
Eigen::MatrixXd Series::known_before() {
  const Eigen::Index size = stage_.size();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(size, size);
  std::map<std::string, double> sd;
  for (const Run& run : runs_)
    for (std::size_t i = static_cast<std::size_t>(run.of->layout.first_stage()); i < run.of->unknowns.size();
         ++i)
      sd[run.of->unknowns[i].name] = run.of->unknowns[i].prior_sd;
  std::vector<Eigen::Index> known(static_cast<std::size_t>(size), -1);
  for (Eigen::Index i = 0; i < size; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const bool named = at < stage_.names.size();
    if (options_.stage)
      known[at] = named ? options_.stage->place_of(stage_.names[at])
                        : options_.stage->place_of(stage_.angles[at - stage_.names.size()]);
    if (known[at] >= 0) continue;
    const bool is_zero = !named && stage_.angles[at - stage_.names.size()].microdegrees == 0;
    out(i, i) =
        std::pow(named ? sd.at(stage_.names[at]) : (is_zero ? kFreeAtZero : 1.0) * step_prior(sizes_), 2);
    if (!named && !is_zero) new_angles_.push_back(i);
  }
  for (Eigen::Index i = 0; i < size; ++i)
    for (Eigen::Index k = 0; k < size; ++k)
      if (const Eigen::Index a = known[static_cast<std::size_t>(i)], b = known[static_cast<std::size_t>(k)];
          a >= 0 && b >= 0)
        out(i, k) = options_.stage->covariance(a, b);
  return out;
}

void Series::set_priors() {
  prior_ = Eigen::MatrixXd::Zero(count_, count_);
  prior_mean_ = Eigen::VectorXd::Zero(count_);
  effect_of_.assign(static_cast<std::size_t>(count_), {"", ""});
  const Eigen::Index stage = stage_.size();
  const Eigen::MatrixXd before = known_before();
  const NormalMatrix covariance(before);
  if (!covariance.solvable())
    throw std::invalid_argument("series: the covariance of the stage is not positive definite");
  stage_log_determinant_ = covariance.log_determinant();
  for (const Eigen::Index angle : new_angles_) stage_log_determinant_ -= std::log(before(angle, angle));
  std::map<std::string, std::pair<std::string, std::string>> effects;
  if (options_.stage)
    for (const std::string& name : options_.stage->names) effects[name] = {"stage record", ""};
  for (const Run& run : runs_)
    for (const EffectUnknown& unknown : run.of->unknowns)
      if (unknown.output < 0) effects[unknown.name] = {unknown.effect, unknown.key};
  prior_.topLeftCorner(stage, stage) = covariance.solve_columns(Eigen::MatrixXd::Identity(stage, stage));
  for (Eigen::Index i = 0; i < stage; ++i) {
    const auto at = static_cast<std::size_t>(i);
    effect_of_[at] = at < stage_.names.size() ? effects.at(stage_.names[at])
                                              : std::pair<std::string, std::string>("fine map", "step_deg");
    if (!options_.stage) continue;
    const Eigen::Index known = at < stage_.names.size()
                                   ? options_.stage->place_of(stage_.names[at])
                                   : options_.stage->place_of(stage_.angles[at - stage_.names.size()]);
    if (known >= 0) prior_mean_(i) = options_.stage->mean(known);
  }
  for (const Item& item : items_) {
    const RunInformation& first = *runs_[static_cast<std::size_t>(item.first_run)].of;
    for (int j = 0; j < 3; ++j) {
      for (std::size_t i = 0; i < item.layout.own.size(); ++i) {
        const EffectLayout::OwnUnknown& own = item.layout.own[i];
        const Eigen::Index at =
            item.at + item.layout.own_count() * j + EffectLayout::kOwnFixed + static_cast<Eigen::Index>(i);
        const double sd = own.effect->prior(first.sizes);
        prior_(at, at) = 1.0 / (sd * sd);
        effect_of_[static_cast<std::size_t>(at)] = {std::string(own.effect->name),
                                                    std::string(own.effect->key)};
      }
    }
  }
  for (const Run& run : runs_) {
    if (run.mounting < 0) continue;
    for (Eigen::Index i = 0; i < 3; ++i) {
      prior_(run.mounting + i, run.mounting + i) = 1.0 / (options_.mounting_sd * options_.mounting_sd);
      effect_of_[static_cast<std::size_t>(run.mounting + i)] = {"mounting", ""};
    }
  }
}

/// `step_deg` is the size of a step error: the part that repeats is what is left of it by the part that does
/// not.
void Series::share_steps(const Sizes& sizes) {
  constexpr double kLeastShare = 0.05;  // The fine map stays solvable.
  const double step = step_prior(sizes_);
  const double visit = sizes[static_cast<std::size_t>(RepeatPart::kStep)];
  const double variance = std::max(step * step - visit * visit, std::pow(kLeastShare * step, 2));
  for (const Eigen::Index angle : new_angles_) prior_(angle, angle) = 1.0 / variance;
  map_log_determinant_ = static_cast<double>(new_angles_.size()) * std::log(variance);
}

/// The item as in its first run's own fit, the stage as known before.
Eigen::VectorXd Series::start() const {
  Eigen::VectorXd out = prior_mean_;
  for (const Item& item : items_) {
    const RunInformation& first = *runs_[static_cast<std::size_t>(item.first_run)].of;
    const Eigen::Matrix3d rows = first.rows();
    for (int j = 0; j < 3; ++j) out.segment<3>(item.at + item.layout.own_count() * j) = rows.row(j);
  }
  return out;
}

Eliminated Series::eliminate(const Run& run, const Sizes& sizes) const {
  const RunInformation& of = *run.of;
  const EffectLayout& layout = of.layout;
  std::vector<double> variance;
  Eliminated out;
  const auto add_own = [&](Eigen::Index q, double sd) {
    if (!(sd > 0.0)) return;
    out.own.push_back(q);
    variance.push_back(sd * sd);
  };
  for (int j = 0; j < 3; ++j)
    for (std::size_t i = 0; i < layout.own.size(); ++i)
      if (is_of_run(layout.own[i]))
        add_own(layout.own_count() * j + EffectLayout::kOwnFixed + static_cast<int>(i),
                layout.own[i].effect->prior(of.sizes));
  for (std::size_t i = 0; i < layout.stage.size(); ++i) {
    const Eigen::Index q = layout.first_stage() + static_cast<Eigen::Index>(i);
    const int part = repeat_part_of(of.unknowns[static_cast<std::size_t>(q)].name);
    if (part >= 0) add_own(q, sizes[static_cast<std::size_t>(part)]);
  }
  for (std::size_t n = 0; n < of.visits.size(); ++n)
    add_own(layout.count() + static_cast<Eigen::Index>(n),
            sizes[static_cast<std::size_t>(RepeatPart::kStep)]);

  const auto own = static_cast<Eigen::Index>(out.own.size());
  out.own_weight.resize(own);
  Eigen::MatrixXd block(own, own), link(own, of.at.size());
  Eigen::VectorXd own_pull(own);
  double log_variances = 0.0;
  for (Eigen::Index i = 0; i < own; ++i) {
    const Eigen::Index q = out.own[static_cast<std::size_t>(i)];
    link.row(i) = of.weight.col(q).transpose();
    own_pull(i) = of.pull(q);
    out.own_weight(i) = 1.0 / variance[static_cast<std::size_t>(i)];
    log_variances += std::log(variance[static_cast<std::size_t>(i)]);
  }
  for (Eigen::Index k = 0; k < own; ++k) block.col(k) = link.col(out.own[static_cast<std::size_t>(k)]);
  block.diagonal() += out.own_weight;
  const Cholesky cholesky(block);
  if (!cholesky.positive_definite())
    throw UnusableData(of.source + ": the unknowns of the run alone are not determined");
  const Eigen::MatrixXd half = cholesky.solve_lower(link);
  const Eigen::VectorXd half_pull = cholesky.solve_lower_vector(own_pull);
  out.weight = of.weight - transposed_product(half, half);
  out.pull = of.pull - transposed_product_with_vector(half, half_pull);
  out.squares = of.squares - half_pull.squaredNorm();
  out.log_determinant = cholesky.log_determinant() + log_variances;
  out.follow = cholesky.solve_upper(half);
  out.own_change = cholesky.solve_upper(half_pull);
  out.own_normal = cholesky;
  return out;
}

std::vector<Eliminated> Series::eliminate_all(const Sizes& sizes) const {
  std::vector<Eliminated> out(runs_.size());
  side_by_side(runs_.size(), [&](std::size_t k) { out[k] = eliminate(runs_[k], sizes); });
  return out;
}

/// The turn of the item in a run at the present point.
Eigen::Matrix3d Series::turn_of(const Run& run) const {
  if (run.mounting < 0) return run.turn;
  return rotation(point_.segment<3>(run.mounting)) * run.turn;
}

/// The unknowns of a run at the present point, those of the run alone as zero.
Eigen::VectorXd Series::q_of(const Run& run) const {
  Eigen::VectorXd q = Eigen::VectorXd::Zero(run.of->at.size());
  for (std::size_t i = 0; i < run.to_all.size(); ++i)
    if (run.to_all[i] >= 0) q(static_cast<Eigen::Index>(i)) = point_(run.to_all[i]);
  const Item& item = items_[static_cast<std::size_t>(run.item)];
  const Eigen::Matrix3d turn = turn_of(run);
  for (int j = 0; j < 3; ++j) {
    const Eigen::Vector3d s = point_.segment<3>(item.at + item.layout.own_count() * j);
    q.segment<3>(run.of_rows[static_cast<std::size_t>(3 * j)]) = turn.transpose() * s;
  }
  return q;
}

/// Derivatives of the nine elements of s in a run by s of the item, and by a further small turn.
std::vector<Series::ByTurn> Series::turned_rows(const Run& run) const {
  const Item& item = items_[static_cast<std::size_t>(run.item)];
  const Eigen::Matrix3d turn = turn_of(run);
  std::vector<ByTurn> out;
  for (int j = 0; j < 3; ++j) {
    const Eigen::Index s_at = item.at + item.layout.own_count() * j;
    const Eigen::Vector3d s = point_.segment<3>(s_at);
    for (Eigen::Index c = 0; c < 3; ++c) {
      ByTurn& one = out.emplace_back();
      one.q = run.of_rows[static_cast<std::size_t>(3 * j + c)];
      one.count = run.mounting >= 0 ? 6 : 3;
      const Eigen::Vector3d column = turn.col(c);
      const Eigen::Vector3d by_small = column.cross(s);
      for (std::size_t k = 0; k < 3; ++k) {
        const auto at = static_cast<Eigen::Index>(k);
        one.to[k] = s_at + at;
        one.value[k] = column(at);
        one.to[3 + k] = run.mounting + at;
        one.value[3 + k] = by_small(at);
      }
    }
  }
  return out;
}

/// Derivatives of the unknowns of a run, those of the run alone as zero, by all unknowns.
Eigen::MatrixXd Series::jacobian_of(const Run& run) const {
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(run.of->at.size(), count_);
  for (std::size_t i = 0; i < run.to_all.size(); ++i)
    if (run.to_all[i] >= 0) out(static_cast<Eigen::Index>(i), run.to_all[i]) = 1.0;
  for (const ByTurn& one : turned_rows(run))
    for (std::size_t k = 0; k < one.count; ++k) out(one.q, one.to[k]) = one.value[k];
  return out;
}

/// Adds the normal equations of a run at the present point: J' weight J without the zeros of J.
void Series::add(const Run& run, const Eliminated& information) {
  const std::vector<ByTurn> by_turn = turned_rows(run);
  const Eigen::VectorXd away = q_of(run) - run.of->at;
  const Eigen::VectorXd weighted = product_with_vector(information.weight, away);
  const Eigen::VectorXd slope = information.pull - weighted;
  squares_ += information.squares + away.dot(weighted) - 2.0 * information.pull.dot(away);
  log_determinant_ += information.log_determinant;
  const auto gather = [&](const Eigen::MatrixXd& from, Eigen::MatrixXd& into) {
    for (std::size_t i = 0; i < run.to_all.size(); ++i)
      if (run.to_all[i] >= 0) into.col(run.to_all[i]) += from.col(static_cast<Eigen::Index>(i));
    for (const ByTurn& one : by_turn)
      for (std::size_t k = 0; k < one.count; ++k) into.col(one.to[k]) += one.value[k] * from.col(one.q);
  };
  Eigen::MatrixXd half = Eigen::MatrixXd::Zero(run.of->at.size(), count_);
  gather(information.weight, half);
  gather(half.transpose(), normal_);
  for (std::size_t i = 0; i < run.to_all.size(); ++i)
    if (run.to_all[i] >= 0) right_(run.to_all[i]) += slope(static_cast<Eigen::Index>(i));
  for (const ByTurn& one : by_turn)
    for (std::size_t k = 0; k < one.count; ++k) right_(one.to[k]) += one.value[k] * slope(one.q);
}

void Series::add_up(const std::vector<Eliminated>& runs) {
  const Eigen::VectorXd away = point_ - prior_mean_;
  normal_ = prior_;
  right_ = -product_with_vector(prior_, away);
  squares_ = -away.dot(right_);
  log_determinant_ = stage_log_determinant_ + map_log_determinant_;
  for (std::size_t k = 0; k < runs_.size(); ++k) add(runs_[k], runs[k]);
}

/// @return false: no convergence
bool Series::solve(const Sizes& sizes) {
  share_steps(sizes);
  eliminated_ = eliminate_all(sizes);
  for (int i = 0; i < kMostIterations; ++i) {
    ++iterations_;
    add_up(eliminated_);
    solved_.compute(normal_);
    if (!solved_.solvable()) return false;
    change_ = solved_.solve(right_);
    const double fall = right_.dot(change_);
    chi2_ = squares_ - fall;
    point_ += change_;
    // A small turn is one about the axes of the platter after those before.
    for (const Run& run : runs_) {
      if (run.mounting < 0) continue;
      const Eigen::Vector3d before = (point_ - change_).segment<3>(run.mounting);
      const Eigen::AngleAxisd both(rotation(change_.segment<3>(run.mounting)) * rotation(before));
      point_.segment<3>(run.mounting) = both.angle() * both.axis();
    }
    if (!std::isfinite(fall)) return false;
    if (fall < kNegligibleFall) return true;
  }
  return false;
}

/// Logarithm of the readings' density given the sizes, all else integrated, with the model linear here.
double Series::log_likelihood(const Sizes& sizes) {
  share_steps(sizes);
  const std::vector<Eliminated> runs = eliminate_all(sizes);
  add_up(runs);
  const NormalMatrix normal(normal_);
  if (!normal.solvable()) return -std::numeric_limits<double>::infinity();
  const double chi2 = squares_ - right_.dot(normal.solve(right_));
  return -0.5 * (chi2 + log_determinant_ + normal.log_determinant());
}

/// The posterior of each size, the others at their most probable values.
Series::Sizes Series::estimate_sizes(SeriesFit& out) {
  constexpr int kRounds = 2;
  const Repeatabilities before = options_.repeatabilities.value_or(stated_repeatabilities(sizes_));
  out.repeatabilities = before;
  Sizes rms{}, probable{};
  for (std::size_t part = 0; part < kRepeatParts; ++part) probable[part] = rms[part] = before[part].rms;
  if (!options_.estimate_repeatabilities) return rms;
  for (int round = 0; round < kRounds; ++round) {
    for (const RepeatPart part : kAllRepeatParts) {
      const auto at = static_cast<std::size_t>(part);
      const double stated = stated_size(sizes_, part);
      // One run shows no difference between runs.
      if (!(stated > 0.0) || (part != RepeatPart::kStep && runs_.size() < 2)) continue;
      out.repeatabilities[at] = size_posterior(stated, before[at], [&](double size) {
        Sizes tried = probable;
        tried[at] = size;
        return log_likelihood(tried);
      });
      probable[at] = out.repeatabilities[at].most_probable;
      rms[at] = out.repeatabilities[at].rms;
    }
    if (!solve(probable)) break;
  }
  return rms;
}

void Series::add_shares(std::size_t i, SeriesItem& out) const {
  const Item& item = items_[i];
  const Rows12 own_rows = line_rows(item.layout, out.value);
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(12, count_);
  rows.middleCols(item.at, out.value.size()) = scaled_rows(units_of_line(out.unit), own_rows);
  const Eigen::MatrixXd response = product(covariance_, rows.transpose());  // all unknowns x 12
  const auto share_of = [&](const std::string& effect, const std::string& key) -> EffectShare& {
    const auto found = std::find_if(out.shares.begin(), out.shares.end(),
                                    [&](const EffectShare& share) { return share.effect == effect; });
    if (found != out.shares.end()) return *found;
    out.shares.push_back({effect, key, 0, 0.0, Covariance12::Zero()});
    return out.shares.back();
  };
  const Eigen::Index stage = stage_.size();
  if (options_.stage) {
    EffectShare& share = share_of("stage record", "");
    share.unknowns = static_cast<int>(stage);
    share.prior_sd = 1.0;  // In units of each.
    share.covariance +=
        carried_covariance(response.topRows(stage).transpose(), prior_.topLeftCorner(stage, stage));
  }
  for (Eigen::Index a = options_.stage ? stage : 0; a < count_; ++a) {
    const auto& [effect, key] = effect_of_[static_cast<std::size_t>(a)];
    if (effect.empty()) continue;
    EffectShare& share = share_of(effect, key);
    ++share.unknowns;
    share.covariance += prior_(a, a) * response.row(a).transpose() * response.row(a);
  }
  // Eliminated unknowns follow those that are left of their run.
  for (std::size_t k = 0; k < runs_.size(); ++k) {
    const Run& run = runs_[k];
    const Eliminated& information = eliminated_[k];
    const Eigen::MatrixXd followed = product(information.follow, product(jacobian_of(run), response));
    for (std::size_t e = 0; e < information.own.size(); ++e) {
      const Eigen::Index q = information.own[e];
      std::string effect = "step errors, from visit to visit", key = "step_deg";
      if (q < run.of->layout.count()) {
        const EffectUnknown& unknown = run.of->unknowns[static_cast<std::size_t>(q)];
        const int part = repeat_part_of(unknown.name);
        effect = part >= 0 ? std::string(in_words(static_cast<RepeatPart>(part))) : unknown.effect;
        key = unknown.key;
      }
      // With a record these sizes are measured: no key of the bench file states them.
      if (options_.stage && q >= run.of->layout.first_stage()) key.clear();
      EffectShare& share = share_of(effect, key);
      ++share.unknowns;
      const auto row = followed.row(static_cast<Eigen::Index>(e));
      share.covariance += information.own_weight(static_cast<Eigen::Index>(e)) * row.transpose() * row;
    }
  }
}

SeriesItem Series::item_result(std::size_t i) const {
  const Item& item = items_[i];
  SeriesItem out;
  out.layout = item.layout;
  out.unit = runs_[static_cast<std::size_t>(item.first_run)].of->unit;
  const Eigen::Index size = 3 * item.layout.own_count();
  out.value = point_.segment(item.at, size);
  out.covariance = covariance_.block(item.at, item.at, size, size);
  const Vector12 units = units_of_line(out.unit);
  out.line = units.cwiseProduct(line_values(item.layout, out.value));
  out.covariance_line =
      carried_covariance(scaled_rows(units, line_rows(item.layout, out.value)), out.covariance);
  add_shares(i, out);
  return out;
}

SeriesRunResult Series::run_result(std::size_t k) const {
  const Run& run = runs_[k];
  const Eliminated& information = eliminated_[k];
  SeriesRunResult out;
  // s in this run is s R(p) M with the small turn p and a turn M of a cube: the item itself has turned by
  // (R(p) M)' = R(-M' p) M'.
  out.turn = run.turn.transpose();
  if (run.mounting >= 0) {
    out.small_turn = -(out.turn * point_.segment<3>(run.mounting));
    out.small_turn_covariance =
        out.turn * covariance_.block<3, 3>(run.mounting, run.mounting) * out.turn.transpose();
  }
  // q = J x + e with e = change - follow (J x - at) for the unknowns of the run alone.
  out.value = q_of(run);
  const Eigen::VectorXd own =
      information.own_change - product_with_vector(information.follow, out.value - run.of->at);
  Eigen::MatrixXd by_all = jacobian_of(run);
  const Eigen::MatrixXd followed = product(information.follow, by_all);
  for (std::size_t e = 0; e < information.own.size(); ++e) {
    out.value(information.own[e]) += own(static_cast<Eigen::Index>(e));
    by_all.row(information.own[e]) -= followed.row(static_cast<Eigen::Index>(e));
  }
  out.covariance = carried_covariance(by_all, covariance_);
  const Eigen::MatrixXd own_covariance = information.own_normal.inverse();
  for (std::size_t e = 0; e < information.own.size(); ++e)
    for (std::size_t f = 0; f < information.own.size(); ++f)
      out.covariance(information.own[e], information.own[f]) +=
          own_covariance(static_cast<Eigen::Index>(e), static_cast<Eigen::Index>(f));
  return out;
}

SeriesFit Series::result() {
  SeriesFit out;
  const Repeatabilities before = options_.repeatabilities.value_or(stated_repeatabilities(sizes_));
  Sizes first{};
  for (std::size_t part = 0; part < kRepeatParts; ++part) first[part] = before[part].rms;
  if (solve(first)) out.converged = solve(estimate_sizes(out));
  out.iterations = iterations_;
  if (!out.converged) return out;
  covariance_ = solved_.covariance_root();
  covariance_ = covariance_of_root(covariance_);
  for (std::size_t i = 0; i < items_.size(); ++i) out.items.push_back(item_result(i));
  for (std::size_t k = 0; k < runs_.size(); ++k) out.runs.push_back(run_result(k));
  out.stage = stage_;
  out.stage.mean = point_.head(stage_.size());
  out.stage.covariance = covariance_.topLeftCorner(stage_.size(), stage_.size());
  out.chi2 = chi2_;
  for (const Run& run : runs_) out.degrees_of_freedom += run.of->readings;
  out.degrees_of_freedom -= 12 * static_cast<int>(items_.size());
  out.log_likelihood = -0.5 * (chi2_ + log_determinant_ + solved_.log_determinant());
  out.reciprocal_condition = solved_.reciprocal_condition();
  return out;
}

}  // namespace

std::string SeriesRunResult::mounting() const {
  return turn_in_words(turn);
}

SeriesFit fit_series(std::span<const SeriesRun> runs, const SeriesOptions& options) {
  return Series(runs, options).result();
}

}  // namespace abcal
