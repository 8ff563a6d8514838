#include "protocol/estimators/measurement/measurement_fit.h"

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
#include "protocol/estimators/measurement/size_posterior.h"
#include "protocol/estimators/measurement/stage_curves.h"
#include "protocol/estimators/shared/normal_matrix.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/side_by_side.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/cholesky.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/plan/mountings.h"

namespace abcal {
namespace {

/// Largest number of iterations; the model is linear but for the turns of the item.
constexpr int kMostIterations = 30;
/// An iteration that would lower chi2 by less is the last one.
constexpr double kNegligibleFall = 1e-8;
/// Noises of an item that are less probable than this are left out of its average.
constexpr double kLeastWeight = 0.04;
/// Largest number of passes, each with a choice of noises.
constexpr int kNoisePasses = 3;
/// Effect of an item's small turn between two mountings.
constexpr const char* kMounting = "mounting";

using Sizes = std::array<double, kRepeatParts>;

Sizes rms_of(const Repeatabilities& repeatabilities) {
  Sizes out{};
  for (std::size_t part = 0; part < kRepeatParts; ++part) out[part] = repeatabilities[part].rms;
  return out;
}

/// Whether an own unknown belongs to one run alone: drifts, and what only the turning shows, which depends on
/// where the item stands on the platter and on the first estimates of its delay and its low-pass in this run.
bool is_of_run(const EffectLayout::OwnUnknown& own) {
  return own.effect->kind == ItemEffectKind::kDrift || own.effect->in_motion;
}
/// Likewise of the stage's: the delays of the item behind the encoders, which count from the first estimate,
/// and the distance of the axes, which the places of the elements contain.
bool is_of_run(const EffectLayout::StageUnknown& of_stage) {
  return of_stage.effect->in_motion;
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

/// An unknown x of the measurement.
struct Unknown {
  std::string effect, key;  ///< Line of the budget to which its prior contributes; empty: it has no prior.
  double sd = std::numeric_limits<double>::infinity();  ///< Standard deviation of its prior.
  double mean = 0.0;
  int item = -1;   ///< Its item; -1: it is of the stage or of a run.
  int group = -1;  ///< The group with which it is eliminated; -1: it is solved last.
  int part = -1;   ///< The RepeatPart whose size it has.
};

/// A derivative of an unknown q of an item in a run by an unknown x of the measurement.
struct Term {
  Eigen::Index q, x;
  double value;
};

/// The information of a group of unknowns and of those that are solved last, without priors: first the group.
struct Gathered {
  Eigen::MatrixXd normal;
  Eigen::VectorXd right;
  double squares = 0.0, log_determinant = 0.0;
};

/// A group with its unknowns eliminated.
struct Eliminated {
  Eigen::MatrixXd normal;  ///< Normal matrix of the unknowns that are solved last.
  Eigen::VectorXd right;
  double squares = 0.0, log_determinant = 0.0;
  Cholesky own;            ///< The group's normal matrix, the other unknowns given.
  Eigen::MatrixXd follow;  ///< Minus the derivatives of the group's best values by the other unknowns.
  Eigen::VectorXd change;  ///< Change to their best values where the others do not change.
  double fall = 0.0;       ///< Fall of chi2 by that change.
};
using Groups = std::vector<const Eliminated*>;

/// The unknowns that are solved last.
struct Solved {
  NormalMatrix normal;
  Eigen::VectorXd right, change;
  double squares = 0.0, log_determinant = 0.0;
  double chi2() const { return squares - right.dot(change); }
  double log_likelihood() const { return -0.5 * (chi2() + log_determinant + normal.log_determinant()); }
};

class Measurement {
 public:
  Measurement(std::span<const MeasuredItem> measured, const MeasurementOptions& options);
  MeasurementFit result();
  /// As MeasurementTruths::draw(); after result().
  /// @param root_of_record  of the covariance of the state that the options give; empty: they give none
  MeasurementTruth truth(const std::function<double(const std::string& key)>& standard,
                         const Eigen::MatrixXd& root_of_record) const;

 private:
  struct Item {
    std::size_t first = 0;  ///< Place of its first run among the members.
    Eigen::Index at = 0;    ///< Place of its unknowns.
    EffectLayout layout;
    std::vector<std::size_t> members;
  };
  /// An item in a run.
  struct Member {
    const MeasuredItem* of = nullptr;
    const RunInformation* information = nullptr;
    Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
    Eigen::Index mounting = -1;  ///< Place of its small turn; -1: zero.
    std::vector<Term> terms;     ///< Without those of s by the item's s and by its small turn.
    std::size_t noise = 0;       ///< Among those of its own fit.
    ReadingsForm other;          ///< At another noise than that of the information.
    const ReadingsForm* form = nullptr;
  };
  /// One noise of an item: its place among those of its own fit, its probability given all readings, and the
  /// line response with it.
  struct Alternative {
    std::size_t noise = 0;
    double log_weight = 0.0;
    LineAtNoise line;
  };

  Eigen::Index add(Unknown unknown);
  const RunInformation& first_of(const Item& item) const { return *members_[item.first].information; }
  int group_of(const Member& member) const { return one_run_ ? member.of->item : member.of->run; }
  int group_of_run(const Member& member) const { return one_run_ ? -1 : member.of->run; }
  void list_stage();
  void set_prior_of_stage();
  void list_items();
  void list_mountings();
  void list_runs();
  void list_own(Member& member);
  /// Unknowns of the runs that their items share, by run and name; step errors of poses by run and pose.
  using OfRuns = std::map<std::pair<int, std::string>, Eigen::Index>;
  using Poses = std::map<std::pair<int, int>, std::vector<Eigen::Index>>;
  void list_of_stage(Member& member, OfRuns& of_runs);
  void list_visits(Member& member, OfRuns& of_runs, Poses& poses);
  /// Place of an unknown that the items of a run share.
  Eigen::Index shared(OfRuns& of_runs, const Member& member, const std::string& name, const Unknown& unknown);
  void list_groups();
  void set_sizes(const Sizes& sizes);

  Eigen::Matrix3d turn_of(const Member& member) const;
  Eigen::VectorXd q_of(const Member& member, const Eigen::VectorXd& x) const;
  std::vector<Term> terms_at_point(const Member& member) const;
  double weight_of(Eigen::Index x) const;
  /// @param other  the form of the group's only member at another noise; null: as they are
  Gathered gather(std::size_t group, const ReadingsForm* other = nullptr) const;
  void add_to(const Member& member, std::size_t group, const ReadingsForm& form, Gathered& out) const;
  Eliminated eliminate(std::size_t group, Gathered gathered) const;
  Groups eliminated() const;
  Solved solve_last(const Groups& groups) const;
  Eigen::VectorXd point_of(const Groups& groups, const Solved& solved) const;
  /// Covariance of all unknowns (rows) with the outputs whose derivatives by them are `rows` (12 x unknowns).
  Eigen::MatrixXd response(const Groups& groups, const Solved& solved, const Rows12& rows) const;

  void gather_all();
  bool solve();
  bool minimise();
  double log_likelihood(const Sizes& sizes);
  bool estimates_sizes() const {
    return options_.estimate_repeatabilities && options_.separates_what_repeats;
  }
  Sizes estimate_sizes(MeasurementFit& out);

  bool has_own_fit(const Member& member) const { return one_run_ && member.of->own != nullptr; }
  bool choose_noises(bool again);
  void weigh_noises(std::size_t item);
  struct LineRows {
    Rows12 by_x;
    Vector12 value = Vector12::Zero();
    Covariance12 beyond = Covariance12::Zero();
    ReadingRows mean_weights;
  };
  LineRows line_rows_at(std::size_t item, const Eigen::VectorXd& x, const AssumedNoise* noise) const;
  void add_mean_of_process(const Member& member, const Eigen::VectorXd& x, const AssumedNoise& noise,
                           double share, LineRows& out) const;
  LineAtNoise line_at(std::size_t item, const AssumedNoise* noise, const Groups& groups,
                      const Solved& solved) const;
  /// The lines of an item's budget, and the line to which each unknown belongs (-1: none).
  struct Budget {
    ShareGroups groups;
    std::vector<int> of_unknown;
    int record = -1;  ///< The line of a record of the stage.
  };
  Budget budget_of(std::size_t item) const;

  FittedItem item_result(std::size_t i) const;
  InRunFit in_run(const Member& member) const;
  void fill_poses(MeasurementFit& out) const;
  void fill_covariance_of_lines(MeasurementFit& out) const;

  MeasurementOptions options_;
  const EffectSizes& sizes_;
  Repeatabilities before_;
  bool one_run_ = true;
  std::vector<Member> members_;
  std::vector<Item> items_;
  StageState stage_;  ///< Names and angles; mean and covariance as known before.
  std::vector<Unknown> unknowns_;
  Eigen::MatrixXd prior_of_stage_;        ///< Weights of the priors of the stage.
  std::vector<Eigen::Index> new_angles_;  ///< Places of the fine map of which nothing is known before.
  std::vector<Eigen::Index> known_;       ///< Places of the stage's unknowns in the given state; -1: none.
  double visit_ = 0.0;                    ///< Size of the part of a step error that differs between visits.
  double stage_log_determinant_ = 0.0;    ///< log det of the covariance of the others' priors.
  /// In one run: places of the unknowns whose sum is an unknown of the stage in this run, or the step error
  /// of a pose.
  std::vector<std::vector<Eigen::Index>> of_run_;
  std::vector<std::vector<Eigen::Index>> groups_;  ///< Places of the unknowns of each group.
  std::vector<Eigen::Index> last_;                 ///< Places of those that are solved last.
  std::vector<Eigen::Index> place_;                ///< Place of each unknown in its group or among the last.
  std::vector<std::vector<const Member*>> members_of_group_;

  Eigen::VectorXd point_;   ///< The solution.
  Eigen::VectorXd linear_;  ///< Point of the present linear model.
  std::vector<Gathered> gathered_;
  std::vector<Eliminated> eliminated_;
  Solved solved_;
  int iterations_ = 0;
  std::vector<Budget> budgets_;                         ///< For each item.
  std::vector<std::vector<Alternative>> alternatives_;  ///< For each item: its probable noises.
  Eigen::MatrixXd covariance_;                          ///< Covariance of those that are solved last.
};

Measurement::Measurement(std::span<const MeasuredItem> measured, const MeasurementOptions& options)
    : options_(options),
      sizes_(measured.empty() ? throw std::invalid_argument("fit of a measurement: no runs")
                              : measured.front().information->sizes),
      before_(options.repeatabilities.value_or(stated_repeatabilities(sizes_))) {
  members_.reserve(measured.size());
  for (const MeasuredItem& one : measured) {
    Member& member = members_.emplace_back();
    member.of = &one;
    member.information = one.information;
    member.form = &one.information->form;
    if (one.own != nullptr) member.noise = best_noise(*one.own);
    one_run_ = one_run_ && one.run == measured.front().run;
  }
  if (!options_.separates_what_repeats && (!one_run_ || options_.stage))
    throw std::invalid_argument(
        "fit of a measurement: several runs, or a record, show what the stage repeats");
  list_stage();
  list_items();
  list_mountings();
  list_runs();
  list_groups();
  set_sizes(rms_of(before_));
  // The item as in its first run's own fit, the stage as known before.
  point_.resize(static_cast<Eigen::Index>(unknowns_.size()));
  for (Eigen::Index x = 0; x < point_.size(); ++x) point_(x) = unknowns_[static_cast<std::size_t>(x)].mean;
  for (const Item& item : items_)
    for (int j = 0; j < 3; ++j)
      point_.segment<3>(item.at + item.layout.own_count() * j) = first_of(item).rows().row(j);
}

Eigen::Index Measurement::add(Unknown unknown) {
  unknowns_.push_back(std::move(unknown));
  return static_cast<Eigen::Index>(unknowns_.size()) - 1;
}

/// The unknowns of the stage in the order of the table of effects, then its fine map.
void Measurement::list_stage() {
  if (options_.stage) stage_ = *options_.stage;
  std::vector<std::string> names = stage_.names;
  std::vector<AxisAngle> angles = stage_.angles;
  std::map<std::string, EffectUnknown> of_table;
  for (const Member& member : members_) {
    const RunInformation& run = *member.information;
    for (const EffectSizeKey& key : effect_size_keys())
      if (key.section == "stage_uncertainty" && key.in_motion == 0.0 && key.get(run.sizes) != key.get(sizes_))
        throw UnusableData(fmt::format(
            "{}: {} is {:g}, but {:g} in {}: runs of one stage state the same sizes of it; analyse "
            "them with one bench file",
            run.source, key.key, key.get(run.sizes), key.get(sizes_), members_.front().information->source));
    for (std::size_t i = 0; i < run.layout.stage.size(); ++i) {
      if (is_of_run(run.layout.stage[i])) continue;
      const EffectUnknown& unknown = run.unknowns[static_cast<std::size_t>(run.layout.first_stage()) + i];
      of_table[unknown.name] = unknown;
      if (std::find(names.begin(), names.end(), unknown.name) == names.end()) names.push_back(unknown.name);
    }
    if (!run.in_motion) angles.insert(angles.end(), run.visits.begin(), run.visits.end());
  }
  std::sort(angles.begin(), angles.end());
  angles.erase(std::unique(angles.begin(), angles.end()), angles.end());
  if (!(sizes_.step.rad() > 0.0) || !options_.separates_what_repeats) angles.clear();
  stage_.names = std::move(names);
  stage_.angles = std::move(angles);
  for (const std::string& name : stage_.names) {
    const auto found = of_table.find(name);
    // A record may know more of the stage than these runs show.
    if (found == of_table.end()) {
      add({.effect = "stage record", .key = "", .sd = 1.0});
      continue;
    }
    const EffectUnknown& unknown = found->second;
    add({.effect = unknown.effect, .key = unknown.key, .sd = unknown.prior_sd, .mean = unknown.prior_mean});
  }
  for (const AxisAngle& angle : stage_.angles)
    add({.effect = "fine map",
         .key = "step_deg",
         .sd = std::sqrt(variance_of_new_map(angle, step_prior(sizes_), 0.0))});
  set_prior_of_stage();
}

/// The stage before these runs: what the options state, and the sizes for the rest.
void Measurement::set_prior_of_stage() {
  const Eigen::Index size = stage_.size();
  Eigen::MatrixXd before = Eigen::MatrixXd::Zero(size, size);
  std::vector<Eigen::Index>& known = known_;
  known.assign(static_cast<std::size_t>(size), -1);
  for (Eigen::Index i = 0; i < size; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const bool named = at < stage_.names.size();
    const auto angle = [&]() -> const AxisAngle& { return stage_.angles[at - stage_.names.size()]; };
    if (options_.stage)
      known[at] = named ? options_.stage->place_of(stage_.names[at]) : options_.stage->place_of(angle());
    if (known[at] >= 0) {
      unknowns_[at].mean = options_.stage->mean(known[at]);
      continue;
    }
    before(i, i) = unknowns_[at].sd * unknowns_[at].sd;
    if (!named) new_angles_.push_back(i);
  }
  for (Eigen::Index i = 0; i < size; ++i)
    for (Eigen::Index k = 0; k < size; ++k)
      if (const Eigen::Index a = known[static_cast<std::size_t>(i)], b = known[static_cast<std::size_t>(k)];
          a >= 0 && b >= 0)
        before(i, k) = options_.stage->covariance(a, b);
  if (size == 0) return;
  const NormalMatrix covariance(before);
  if (!covariance.solvable())
    throw std::invalid_argument("fit of a measurement: the covariance of the stage is not positive definite");
  stage_log_determinant_ = covariance.log_determinant();
  for (const Eigen::Index angle : new_angles_) stage_log_determinant_ -= std::log(before(angle, angle));
  prior_of_stage_ = covariance.solve_columns(Eigen::MatrixXd::Identity(size, size));
}

void Measurement::list_items() {
  for (std::size_t m = 0; m < members_.size(); ++m) {
    const Member& member = members_[m];
    const RunInformation& information = *member.information;
    const int number = member.of->item;
    if (number == static_cast<int>(items_.size())) {
      Item& item = items_.emplace_back(
          Item{.first = m, .at = static_cast<Eigen::Index>(unknowns_.size()), .layout = {}, .members = {}});
      for (const EffectLayout::OwnUnknown& own : information.layout.own)
        if (!is_of_run(own)) item.layout.own.push_back(own);
      for (int j = 0; j < 3; ++j) {
        for (int i = 0; i < information.layout.own_count(); ++i) {
          const bool fixed = i < EffectLayout::kOwnFixed;
          if (!fixed &&
              is_of_run(information.layout.own[static_cast<std::size_t>(i - EffectLayout::kOwnFixed)]))
            continue;
          const EffectUnknown& unknown =
              information.unknowns[static_cast<std::size_t>(information.layout.own_count() * j + i)];
          add({.effect = fixed ? "" : unknown.effect,
               .key = fixed ? "" : unknown.key,
               .sd = unknown.prior_sd,
               .mean = unknown.prior_mean,
               .item = number,
               .group = one_run_ ? number : -1});
        }
      }
    }
    if (number < 0 || number >= static_cast<int>(items_.size()))
      throw std::invalid_argument(
          "fit of a measurement: items are numbered from 0 in the order of their first runs");
    Item& item = items_[static_cast<std::size_t>(number)];
    item.members.push_back(m);
    if (information.unit != first_of(item).unit)
      throw std::invalid_argument("fit of a measurement: an item has one unit in all its runs");
  }
}

void Measurement::list_mountings() {
  for (const Item& item : items_) {
    for (const std::size_t m : item.members) {
      if (m == item.first) continue;
      Member& member = members_[m];
      member.turn = turn_between(first_of(item), *member.information);
      member.mounting = static_cast<Eigen::Index>(unknowns_.size());
      for (int i = 0; i < 3; ++i)
        add({.effect = kMounting, .key = "", .sd = options_.mounting_sd, .item = member.of->item});
    }
  }
}

/// Unknowns of the item in this run, and those of its own that the item has in all its runs.
void Measurement::list_own(Member& member) {
  const RunInformation& run = *member.information;
  const EffectLayout& layout = run.layout;
  const Item& item = items_[static_cast<std::size_t>(member.of->item)];
  const int group = group_of(member);
  for (int j = 0; j < 3; ++j) {
    const Eigen::Index first = layout.own_count() * j;
    Eigen::Index to = item.at + item.layout.own_count() * j + 3;
    member.terms.push_back({first + 3, to++, 1.0});
    std::size_t shared = 0;
    for (std::size_t i = 0; i < layout.own.size(); ++i) {
      const Eigen::Index q = first + EffectLayout::kOwnFixed + static_cast<Eigen::Index>(i);
      const EffectUnknown& unknown = run.unknowns[static_cast<std::size_t>(q)];
      if (is_of_run(layout.own[i])) {
        member.terms.push_back({q,
                                add({.effect = unknown.effect,
                                     .key = unknown.key,
                                     .sd = unknown.prior_sd,
                                     .mean = unknown.prior_mean,
                                     .item = member.of->item,
                                     .group = group}),
                                1.0});
        continue;
      }
      if (shared >= item.layout.own.size() || item.layout.own[shared].effect != layout.own[i].effect)
        throw UnusableData(fmt::format("{}: other effects of the item are stated than in {}", run.source,
                                       first_of(item).source));
      ++shared;
      member.terms.push_back({q, to++, 1.0});
    }
    // The item in this run differs from the item as it is in the mean.
    if (one_run_ || !(run.sizes.drift_between_runs > 0.0)) continue;
    for (int i = 0; i < EffectLayout::kOwnFixed; ++i)
      member.terms.push_back({first + i,
                              add({.effect = "change from run to run",
                                   .key = "drift_between_runs",
                                   .sd = run.sizes.drift_between_runs,
                                   .item = member.of->item,
                                   .group = group}),
                              1.0});
  }
}

Eigen::Index Measurement::shared(OfRuns& of_runs, const Member& member, const std::string& name,
                                 const Unknown& unknown) {
  const auto [found, is_new] = of_runs.try_emplace({member.of->run, name}, -1);
  if (is_new) found->second = add(unknown);
  return found->second;
}

/// Unknowns of the stage and of its sweeps, with what the stage does not repeat in this run.
void Measurement::list_of_stage(Member& member, OfRuns& of_runs) {
  const RunInformation& run = *member.information;
  const EffectLayout& layout = run.layout;
  for (std::size_t i = 0; i < layout.stage.size(); ++i) {
    const Eigen::Index q = layout.first_stage() + static_cast<Eigen::Index>(i);
    const EffectUnknown& unknown = run.unknowns[static_cast<std::size_t>(q)];
    if (is_of_run(layout.stage[i])) {
      // The items of a run turn about the same axes; each has delays of its own.
      const bool is_shared = unknown.key == "axes_distance_mm";
      const Unknown in_run{.effect = unknown.effect,
                           .key = unknown.key,
                           .sd = unknown.prior_sd,
                           .mean = unknown.prior_mean,
                           .item = is_shared ? -1 : member.of->item,
                           .group = is_shared ? group_of_run(member) : group_of(member)};
      member.terms.push_back(
          {q, is_shared ? shared(of_runs, member, unknown.effect, in_run) : add(in_run), 1.0});
      continue;
    }
    member.terms.push_back({q, stage_.place_of(unknown.name), 1.0});
    const int part = repeat_part_of(unknown.name);
    if (part < 0 || !options_.separates_what_repeats) continue;
    member.terms.push_back({q,
                            shared(of_runs, member, unknown.name,
                                   {.effect = std::string(in_words(static_cast<RepeatPart>(part))),
                                    .key = options_.stage ? "" : unknown.key,
                                    .group = group_of_run(member),
                                    .part = part}),
                            1.0});
  }
  for (Eigen::Index q = layout.first_sweep(); q < layout.count(); ++q) {
    const EffectUnknown& unknown = run.unknowns[static_cast<std::size_t>(q)];
    member.terms.push_back({q,
                            shared(of_runs, member, fmt::format("sweep {}", q - layout.first_sweep()),
                                   {.effect = unknown.effect,
                                    .key = unknown.key,
                                    .sd = unknown.prior_sd,
                                    .mean = unknown.prior_mean,
                                    .group = group_of_run(member)}),
                            1.0});
  }
}

void Measurement::list_visits(Member& member, OfRuns& of_runs, Poses& poses) {
  const RunInformation& run = *member.information;
  const double step = step_prior(run.sizes);
  if (!(step > 0.0)) return;
  const bool has_map = !stage_.angles.empty();
  for (std::size_t n = 0; n < run.visits.size(); ++n) {
    const Eigen::Index q = run.layout.count() + static_cast<Eigen::Index>(n);
    const int pose = member.of->pose.empty() ? static_cast<int>(n) : member.of->pose.at(n);
    // In motion the mean over a step is another quantity than the fine map at the angle.
    if (run.in_motion) {
      const Unknown step_error{
          .effect = "step errors", .key = "step_deg", .sd = step, .group = group_of_run(member)};
      member.terms.push_back({q, shared(of_runs, member, fmt::format("step {}", pose), step_error), 1.0});
      continue;
    }
    const auto [found, is_new] = poses.try_emplace({member.of->run, pose});
    if (is_new) {
      if (has_map) found->second.push_back(stage_.place_of(run.visits[n]));
      found->second.push_back(has_map ? add({.effect = "step errors, from visit to visit",
                                             .key = options_.stage ? "" : "step_deg",
                                             .group = group_of_run(member),
                                             .part = static_cast<int>(RepeatPart::kStep)})
                                      : add({.effect = fmt::format("f_{}", run.experiments[n]),
                                             .key = "step_deg",
                                             .sd = step * run.step_factors[n],
                                             .group = group_of_run(member)}));
    }
    for (const Eigen::Index x : found->second) member.terms.push_back({q, x, 1.0});
  }
}

void Measurement::list_runs() {
  OfRuns of_runs;
  Poses poses;
  for (Member& member : members_) {
    list_own(member);
    list_of_stage(member, of_runs);
    list_visits(member, of_runs, poses);
  }
  if (!one_run_) return;
  for (std::size_t i = 0; i < stage_.names.size(); ++i) {
    std::vector<Eigen::Index>& sum = of_run_.emplace_back(std::vector{static_cast<Eigen::Index>(i)});
    const auto found = of_runs.find({members_.front().of->run, stage_.names[i]});
    if (found != of_runs.end()) sum.push_back(found->second);
  }
  for (const auto& [pose, places] : poses) of_run_.push_back(places);
}

void Measurement::list_groups() {
  std::size_t count = 0;
  for (const Member& member : members_)
    count = std::max(count, static_cast<std::size_t>(group_of(member) + 1));
  groups_.resize(count);
  for (std::size_t x = 0; x < unknowns_.size(); ++x) {
    std::vector<Eigen::Index>& list =
        unknowns_[x].group < 0 ? last_ : groups_[static_cast<std::size_t>(unknowns_[x].group)];
    place_.push_back(static_cast<Eigen::Index>(list.size()));
    list.push_back(static_cast<Eigen::Index>(x));
  }
  members_of_group_.resize(count);
  for (const Member& member : members_)
    members_of_group_[static_cast<std::size_t>(group_of(member))].push_back(&member);
}

/// The sizes of what the stage does not repeat.
void Measurement::set_sizes(const Sizes& sizes) {
  visit_ = sizes[static_cast<std::size_t>(RepeatPart::kStep)];
  for (Unknown& unknown : unknowns_)
    if (unknown.part >= 0) unknown.sd = sizes[static_cast<std::size_t>(unknown.part)];
  for (const Eigen::Index place : new_angles_) {
    const AxisAngle& angle = stage_.angles[static_cast<std::size_t>(place) - stage_.names.size()];
    prior_of_stage_(place, place) = 1.0 / variance_of_new_map(angle, step_prior(sizes_), visit_);
  }
}

/// The turn of the item in a run at the point of the linear model.
Eigen::Matrix3d Measurement::turn_of(const Member& member) const {
  if (member.mounting < 0) return member.turn;
  return rotation(linear_.segment<3>(member.mounting)) * member.turn;
}

/// The unknowns of an item in a run, where all are x; its turn is that of the linear model.
Eigen::VectorXd Measurement::q_of(const Member& member, const Eigen::VectorXd& x) const {
  Eigen::VectorXd q = Eigen::VectorXd::Zero(member.information->at.size());
  for (const Term& term : member.terms) q(term.q) += term.value * x(term.x);
  const Item& item = items_[static_cast<std::size_t>(member.of->item)];
  const Eigen::Matrix3d turn = member.mounting < 0
                                   ? member.turn
                                   : Eigen::Matrix3d(rotation(x.segment<3>(member.mounting)) * member.turn);
  for (int j = 0; j < 3; ++j)
    q.segment<3>(member.information->layout.own_count() * j) +=
        turn.transpose() * x.segment<3>(item.at + item.layout.own_count() * j);
  return q;
}

/// Derivatives of the unknowns of an item in a run by all unknowns.
std::vector<Term> Measurement::terms_at_point(const Member& member) const {
  std::vector<Term> out = member.terms;
  const Item& item = items_[static_cast<std::size_t>(member.of->item)];
  const Eigen::Matrix3d turn = turn_of(member);
  for (int j = 0; j < 3; ++j) {
    const Eigen::Index s_at = item.at + item.layout.own_count() * j;
    const Eigen::Vector3d s = linear_.segment<3>(s_at);
    for (Eigen::Index c = 0; c < 3; ++c) {
      const Eigen::Index q = member.information->layout.own_count() * j + c;
      const Eigen::Vector3d column = turn.col(c);
      const Eigen::Vector3d by_small = column.cross(s);
      for (Eigen::Index k = 0; k < 3; ++k) {
        if (column(k) != 0.0) out.push_back({q, s_at + k, column(k)});
        if (member.mounting >= 0) out.push_back({q, member.mounting + k, by_small(k)});
      }
    }
  }
  return out;
}

double Measurement::weight_of(Eigen::Index x) const {
  const double sd = unknowns_[static_cast<std::size_t>(x)].sd;
  return 1.0 / (sd * sd);
}

void Measurement::add_to(const Member& member, std::size_t group, const ReadingsForm& form,
                         Gathered& out) const {
  const Eigen::VectorXd away = q_of(member, linear_) - member.information->at;
  const Eigen::VectorXd weighted = product_with_vector(form.weight, away);
  out.squares += form.squares + away.dot(weighted) - 2.0 * form.pull.dot(away);
  out.log_determinant += form.log_determinant;
  const auto own = static_cast<Eigen::Index>(groups_[group].size());
  const std::vector<Term> terms = terms_at_point(member);
  const auto local = [&](const Term& term) {
    const auto x = static_cast<std::size_t>(term.x);
    return place_[x] + (unknowns_[x].group < 0 ? own : 0);
  };
  Eigen::MatrixXd half = Eigen::MatrixXd::Zero(form.weight.rows(), out.normal.cols());
  for (const Term& term : terms) half.col(local(term)) += term.value * form.weight.col(term.q);
  const Eigen::MatrixXd by_q = half.transpose();
  for (const Term& term : terms) {
    out.normal.col(local(term)) += term.value * by_q.col(term.q);
    out.right(local(term)) += term.value * (form.pull(term.q) - weighted(term.q));
  }
}

Gathered Measurement::gather(std::size_t group, const ReadingsForm* other) const {
  const auto size = static_cast<Eigen::Index>(groups_[group].size() + last_.size());
  Gathered out{Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size), 0.0, 0.0};
  for (const Member* member : members_of_group_[group])
    add_to(*member, group, other != nullptr ? *other : *member->form, out);
  return out;
}

Eliminated Measurement::eliminate(std::size_t group, Gathered gathered) const {
  const auto own = static_cast<Eigen::Index>(groups_[group].size());
  const auto last = static_cast<Eigen::Index>(last_.size());
  Eliminated out;
  out.squares = gathered.squares;
  out.log_determinant = gathered.log_determinant;
  for (Eigen::Index i = 0; i < own; ++i) {
    const Eigen::Index x = groups_[group][static_cast<std::size_t>(i)];
    const double weight = weight_of(x);
    if (!(weight > 0.0)) continue;
    const double away = linear_(x) - unknowns_[static_cast<std::size_t>(x)].mean;
    gathered.normal(i, i) += weight;
    gathered.right(i) -= weight * away;
    out.squares += weight * away * away;
    out.log_determinant -= std::log(weight);
  }
  out.own = Cholesky(gathered.normal.topLeftCorner(own, own));
  if (!out.own.positive_definite())
    throw UnusableData(members_of_group_[group].front()->information->source +
                       ": the unknowns of the run alone are not determined");
  const Eigen::MatrixXd half = out.own.solve_lower(gathered.normal.topRightCorner(own, last));
  const Eigen::VectorXd half_right = out.own.solve_lower_vector(gathered.right.head(own));
  out.normal = gathered.normal.bottomRightCorner(last, last) - transposed_product(half, half);
  out.right = gathered.right.tail(last) - transposed_product_with_vector(half, half_right);
  out.fall = half_right.squaredNorm();
  out.squares -= out.fall;
  out.log_determinant += out.own.log_determinant();
  out.follow = out.own.solve_upper(half);
  out.change = out.own.solve_upper(half_right);
  return out;
}

Groups Measurement::eliminated() const {
  Groups out;
  for (const Eliminated& one : eliminated_) out.push_back(&one);
  return out;
}

/// @param groups  those of which the readings count
Solved Measurement::solve_last(const Groups& groups) const {
  const auto size = static_cast<Eigen::Index>(last_.size());
  Solved out;
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(size, size);
  out.right = Eigen::VectorXd::Zero(size);
  // The stage comes first.
  const Eigen::Index stage = stage_.size();
  Eigen::VectorXd away(size);
  for (Eigen::Index i = 0; i < size; ++i) {
    const Eigen::Index x = last_[static_cast<std::size_t>(i)];
    away(i) = linear_(x) - unknowns_[static_cast<std::size_t>(x)].mean;
  }
  out.log_determinant = stage_log_determinant_;
  for (const Eigen::Index angle : new_angles_) out.log_determinant -= std::log(prior_of_stage_(angle, angle));
  if (stage > 0) {
    normal.topLeftCorner(stage, stage) = prior_of_stage_;
    out.right.head(stage) = -product_with_vector(prior_of_stage_, away.head(stage));
  }
  for (Eigen::Index i = stage; i < size; ++i) {
    const double weight = weight_of(last_[static_cast<std::size_t>(i)]);
    if (!(weight > 0.0)) continue;
    normal(i, i) += weight;
    out.right(i) -= weight * away(i);
    out.log_determinant -= std::log(weight);
  }
  out.squares = 0.0;
  for (Eigen::Index i = 0; i < size; ++i)
    if (out.right(i) != 0.0) out.squares -= away(i) * out.right(i);
  for (const Eliminated* one : groups) {
    normal += one->normal;
    out.right += one->right;
    out.squares += one->squares;
    out.log_determinant += one->log_determinant;
  }
  out.normal.compute(std::move(normal));
  if (out.normal.solvable()) out.change = out.normal.solve(out.right);
  return out;
}

Eigen::VectorXd Measurement::point_of(const Groups& groups, const Solved& solved) const {
  Eigen::VectorXd out = linear_;
  for (std::size_t i = 0; i < last_.size(); ++i) out(last_[i]) += solved.change(static_cast<Eigen::Index>(i));
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const Eigen::VectorXd change = groups[g]->change - product_with_vector(groups[g]->follow, solved.change);
    for (std::size_t i = 0; i < groups_[g].size(); ++i)
      out(groups_[g][i]) += change(static_cast<Eigen::Index>(i));
  }
  // A small turn is one about the axes of the platter after those before.
  for (const Member& member : members_) {
    if (member.mounting < 0) continue;
    const Eigen::Vector3d before = linear_.segment<3>(member.mounting);
    const Eigen::AngleAxisd both(rotation(out.segment<3>(member.mounting) - before) * rotation(before));
    out.segment<3>(member.mounting) = both.angle() * both.axis();
  }
  return out;
}

Eigen::MatrixXd Measurement::response(const Groups& groups, const Solved& solved, const Rows12& rows) const {
  const auto places = [&](const std::vector<Eigen::Index>& list) {
    Eigen::MatrixXd out(static_cast<Eigen::Index>(list.size()), 12);
    for (std::size_t i = 0; i < list.size(); ++i)
      out.row(static_cast<Eigen::Index>(i)) = rows.col(list[i]).transpose();
    return out;
  };
  Eigen::MatrixXd right = places(last_);
  std::vector<Eigen::MatrixXd> own;
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const Eigen::MatrixXd of_group = places(groups_[g]);
    if (of_group.isZero(0.0)) {
      own.emplace_back();
      continue;
    }
    right -= transposed_product(groups[g]->follow, of_group);
    own.push_back(groups[g]->own.solve(of_group));
  }
  const Eigen::MatrixXd of_last = solved.normal.solve_columns(right);
  Eigen::MatrixXd out(static_cast<Eigen::Index>(unknowns_.size()), 12);
  for (std::size_t i = 0; i < last_.size(); ++i)
    out.row(last_[i]) = of_last.row(static_cast<Eigen::Index>(i));
  for (std::size_t g = 0; g < groups.size(); ++g) {
    Eigen::MatrixXd of_group = -product(groups[g]->follow, of_last);
    if (own[g].size() > 0) of_group += own[g];
    for (std::size_t i = 0; i < groups_[g].size(); ++i)
      out.row(groups_[g][i]) = of_group.row(static_cast<Eigen::Index>(i));
  }
  return out;
}

void Measurement::gather_all() {
  linear_ = point_;
  gathered_.resize(groups_.size());
  side_by_side(groups_.size(), [&](std::size_t g) { gathered_[g] = gather(g); });
}

/// @return false: the linear model has no solution
bool Measurement::solve() {
  eliminated_.resize(groups_.size());
  side_by_side(groups_.size(), [&](std::size_t g) { eliminated_[g] = eliminate(g, gathered_[g]); });
  solved_ = solve_last(eliminated());
  return solved_.normal.solvable() && solved_.change.allFinite();
}

/// @return false: no convergence
bool Measurement::minimise() {
  const bool is_linear =
      std::ranges::all_of(members_, [](const Member& member) { return member.mounting < 0; });
  for (int i = 0; i < kMostIterations; ++i) {
    ++iterations_;
    gather_all();
    if (!solve()) return false;
    const Groups groups = eliminated();
    double fall = solved_.right.dot(solved_.change);
    for (const Eliminated& one : eliminated_) fall += one.fall;
    point_ = point_of(groups, solved_);
    if (!std::isfinite(fall)) return false;
    if (is_linear || fall < kNegligibleFall) return true;
  }
  return false;
}

/// Logarithm of the readings' density given the sizes, all else integrated, with the model linear here.
double Measurement::log_likelihood(const Sizes& sizes) {
  set_sizes(sizes);
  return solve() ? solved_.log_likelihood() : -std::numeric_limits<double>::infinity();
}

/// The posterior of each size, the others at their most probable values.
Sizes Measurement::estimate_sizes(MeasurementFit& out) {
  constexpr int kRounds = 2;
  Sizes rms = rms_of(before_), probable = rms;
  for (int round = 0; round < kRounds; ++round) {
    for (const RepeatPart part : kAllRepeatParts) {
      const auto at = static_cast<std::size_t>(part);
      const double stated = stated_size(sizes_, part);
      // One run shows no difference between runs.
      if (!(stated > 0.0) || (part != RepeatPart::kStep && one_run_)) continue;
      out.repeatabilities[at] = size_posterior(stated, before_[at], [&](double size) {
        Sizes tried = probable;
        tried[at] = size;
        return log_likelihood(tried);
      });
      probable[at] = out.repeatabilities[at].most_probable;
      rms[at] = out.repeatabilities[at].rms;
    }
    set_sizes(probable);
    if (!minimise()) break;
  }
  return rms;
}

/// The line response of an item where all unknowns are x, and its derivatives.
Measurement::LineRows Measurement::line_rows_at(std::size_t i, const Eigen::VectorXd& x,
                                                const AssumedNoise* noise) const {
  const Item& item = items_[i];
  const Member& member = members_[item.first];
  LineRows out;
  const Eigen::VectorXd own = x.segment(item.at, 3 * item.layout.own_count());
  out.value = line_values(item.layout, own);
  out.by_x = Rows12::Zero(12, static_cast<Eigen::Index>(unknowns_.size()));
  out.by_x.middleCols(item.at, own.size()) = line_rows(item.layout, own);
  // The mean of the process over the runs belongs to the offset.
  if (one_run_) {
    if (has_own_fit(member) && noise != nullptr) add_mean_of_process(member, x, *noise, 1.0, out);
    return out;
  }
  const double share = 1.0 / static_cast<double>(item.members.size());
  for (const std::size_t m : item.members)
    if (const Member& in_run = members_[m]; in_run.of->own != nullptr)
      add_mean_of_process(in_run, x, mean_noise(*in_run.of->own), share, out);
  return out;
}

/// Adds a share of the mean of the noise process over a run to the offset.
void Measurement::add_mean_of_process(const Member& member, const Eigen::VectorXd& x,
                                      const AssumedNoise& noise, double share, LineRows& out) const {
  if (!(noise.tau > 0.0)) return;
  const EffectModel& model = *member.of->own->model;
  const NoiseWhitener whitener(model.noise_at_angles(noise.white), 0.0,
                               model.process_of(noise.tau, noise.rho));
  ReadingRows& weights = out.mean_weights = whitener.covariance_with_mean();
  whitener.whiten(weights);
  Eigen::Matrix3d beyond = -products_of_columns(weights);
  beyond.diagonal() += whitener.mean_variance();
  out.beyond.bottomRightCorner<3, 3>() += share * share * beyond;
  whitener.whiten_transposed(weights);
  Eigen::MatrixXd by_q(3, member.information->at.size());
  by_q.leftCols(model.layout().count()) = transposed_product_by_rows(weights, model.jacobian());
  for (std::size_t n = 0; n < model.angles(); ++n)
    by_q.col(model.layout().count() + static_cast<Eigen::Index>(n)) =
        weights.middleRows<3>(3 * static_cast<Eigen::Index>(n)).transpose() * model.by_own_step(n);
  out.value.tail<3>() += share * (transposed_product_by_rows_with_vector(weights, model.misfit()) -
                                  product_with_vector(by_q, q_of(member, x) - member.information->at));
  for (const Term& term : terms_at_point(member))
    out.by_x.bottomRows<3>().col(term.x) -= share * term.value * by_q.col(term.q);
}

Measurement::Budget Measurement::budget_of(std::size_t i) const {
  Budget out;
  std::vector<EffectShare>& lines = out.groups.groups;
  const auto line_of = [&](const std::string& effect, const std::string& key, double sd) {
    const auto found = std::ranges::find(lines, effect, &EffectShare::effect);
    if (found != lines.end()) return static_cast<int>(found - lines.begin());
    lines.push_back({effect, key, 0, sd, Covariance12::Zero()});
    return static_cast<int>(lines.size()) - 1;
  };
  const auto stage = static_cast<std::size_t>(stage_.size());
  if (options_.stage) out.record = line_of("stage record", "", 1.0);  // In units of each.
  for (std::size_t x = 0; x < unknowns_.size(); ++x) {
    const Unknown& unknown = unknowns_[x];
    int line = -1;
    if (options_.stage && x < stage)
      line = out.record;
    else if (!std::isfinite(unknown.sd))
      line = -1;
    else if (unknown.item >= 0 && unknown.item != static_cast<int>(i))
      line = line_of("effects of the other items", "", 1.0);  // It combines many sizes.
    else
      line = line_of(unknown.effect, unknown.key, unknown.sd);
    out.of_unknown.push_back(line);
    if (line >= 0) ++lines[static_cast<std::size_t>(line)].unknowns;
  }
  const Member& member = members_[items_[i].first];
  out.groups.of_unknown.assign(static_cast<std::size_t>(member.information->at.size()), -1);
  for (const Term& term : member.terms)
    if (int& line = out.groups.of_unknown[static_cast<std::size_t>(term.q)]; line < 0)
      line = out.of_unknown[static_cast<std::size_t>(term.x)];
  return out;
}

LineAtNoise Measurement::line_at(std::size_t i, const AssumedNoise* noise, const Groups& groups,
                                 const Solved& solved) const {
  const Member& member = members_[items_[i].first];
  const Eigen::VectorXd x = point_of(groups, solved);
  const LineRows rows = line_rows_at(i, x, noise);
  const Eigen::MatrixXd by_all = response(groups, solved, rows.by_x);
  LineAtNoise out;
  out.change = rows.value;
  const Covariance12 covariance = product(rows.by_x, by_all) + rows.beyond;
  out.covariance = 0.5 * (covariance + covariance.transpose());
  const Budget& budget = budgets_[i];
  out.shares.assign(budget.groups.groups.size(), Covariance12::Zero());
  for (std::size_t a = 0; a < unknowns_.size(); ++a) {
    const int line = budget.of_unknown[a];
    if (line < 0 || line == budget.record) continue;
    const auto place = static_cast<Eigen::Index>(a);
    // The fine map that is not known before has the size that the rest of a step error leaves.
    const double weight = place < stage_.size() ? prior_of_stage_(place, place) : weight_of(place);
    out.shares[static_cast<std::size_t>(line)].noalias() +=
        weight * by_all.row(place).transpose() * by_all.row(place);
  }
  if (budget.record >= 0)
    out.shares[static_cast<std::size_t>(budget.record)] =
        carried_covariance(by_all.topRows(stage_.size()).transpose(), prior_of_stage_);
  if (!has_own_fit(member)) return out;
  // Derivatives by the item's own readings.
  const EffectModel& model = *member.of->own->model;
  Eigen::MatrixXd by_q = Eigen::MatrixXd::Zero(member.information->at.size(), 12);
  for (const Term& term : terms_at_point(member)) by_q.row(term.q) += term.value * by_all.row(term.x);
  const Eigen::Index unknowns = model.layout().count();
  out.gain = times(model.jacobian(), by_q.topRows(unknowns));
  for (std::size_t n = 0; n < model.angles(); ++n)
    out.gain.middleRows<3>(3 * static_cast<Eigen::Index>(n)) +=
        model.by_own_step(n) * by_q.row(unknowns + static_cast<Eigen::Index>(n));
  const NoiseWhitener whitener(model.noise_at_angles(noise->white), 0.0,
                               model.process_of(noise->tau, noise->rho));
  whitener.whiten(out.gain);
  whitener.whiten_transposed(out.gain);
  if (noise->tau > 0.0) out.gain.rightCols<3>() += rows.mean_weights;
  add_share_of_signs(model, budget.groups, out);
  return out;
}

/// The line response at the item's noise, and at every other noise that is probable by its own fit.
void Measurement::weigh_noises(std::size_t i) {
  const Member& member = members_[items_[i].first];
  std::vector<Alternative>& out = alternatives_[i];
  out.clear();
  const Groups now = eliminated();
  if (!has_own_fit(member)) {
    out.push_back({0, 0.0, line_at(i, nullptr, now, solved_)});
    return;
  }
  const EffectSolution& own = *member.of->own;
  const auto group = static_cast<std::size_t>(group_of(member));
  for (std::size_t n = 0; n < own.noises.size(); ++n) {
    const bool is_now = n == member.noise;
    if (!is_now && !(own.weights[n] >= kLeastWeight)) continue;
    Eliminated other;
    Groups groups = now;
    Solved solved;
    if (!is_now) {
      const ReadingsForm form = form_at(*own.model, own.noises[n]);
      other = eliminate(group, gather(group, &form));
      groups[group] = &other;
      solved = solve_last(groups);
      if (!solved.normal.solvable()) continue;
    }
    const Solved& of_all = is_now ? solved_ : solved;
    // Its prior probability is the posterior of the item's own fit without the likelihood of its readings.
    out.push_back({n, std::log(own.weights[n]) - own.log_likelihoods[n] + of_all.log_likelihood(),
                   line_at(i, &own.noises[n], groups, of_all)});
  }
  std::vector<double> logs;
  for (const Alternative& one : out) logs.push_back(one.log_weight);
  const double total = log_of_sum(logs);
  for (Alternative& one : out) one.log_weight -= total;
}

/// Gives each item the noise that all readings favour.
/// @param again  whether the noises may change
/// @return whether one did
bool Measurement::choose_noises(bool again) {
  budgets_.clear();
  for (std::size_t i = 0; i < items_.size(); ++i) budgets_.push_back(budget_of(i));
  alternatives_.resize(items_.size());
  side_by_side(items_.size(), [&](std::size_t i) { weigh_noises(i); });
  bool changed = false;
  for (std::size_t i = 0; i < items_.size() && again; ++i) {
    Member& member = members_[items_[i].first];
    const auto most = std::ranges::max_element(alternatives_[i], {}, &Alternative::log_weight);
    if (!has_own_fit(member) || most->noise == member.noise) continue;
    changed = true;
    member.noise = most->noise;
    member.other = form_at(*member.of->own->model, member.of->own->noises[member.noise]);
    member.form = &member.other;
  }
  return changed;
}

/// The item from all readings, averaged over its probable noises. Its covariance is that at the chosen noise
/// plus the increase by the average (positive in every direction), so that the covariance of all items
/// together stays positive semidefinite.
FittedItem Measurement::item_result(std::size_t i) const {
  const Item& item = items_[i];
  const Member& member = members_[item.first];
  std::vector<LineAtNoise> lines;
  std::vector<double> weights;
  std::size_t now = 0;
  for (const Alternative& one : alternatives_[i]) {
    if (has_own_fit(member) && one.noise == member.noise) now = lines.size();
    lines.push_back(one.line);
    weights.push_back(std::exp(one.log_weight));
  }
  const LineAtNoise& at_best = lines[now];
  EffectFit fit;
  fit.unit = first_of(item).unit;
  average_line(Vector12::Zero(), budgets_[i].groups, lines, weights, fit);
  const SymmetricEigen added = symmetric_eigen(fit.covariance_line - at_best.covariance);
  fit.covariance_line =
      at_best.covariance +
      product_transposed(scaled_columns(added.vectors, added.values.cwiseMax(0.0)), added.vectors);
  FittedItem out;
  out.first = item.first;
  if (has_own_fit(member)) {
    const EffectSolution& own = *member.of->own;
    fit.gain = at_best.gain;
    if (own.fit.noise.white_estimated) add_degrees_of_estimated_noise(*own.model, own.white, fit.gain, fit);
    out.degrees_of_freedom = fit.degrees_of_freedom;
  }
  restore_units(fit);
  out.line = fit.line;
  out.covariance_line = fit.covariance_line;
  out.shares = std::move(fit.shares);
  out.gain = std::move(fit.gain);
  if (one_run_) {
    Groups others = eliminated();
    others.erase(others.begin() + static_cast<std::ptrdiff_t>(group_of(member)));
    out.chi2_given_others = solved_.chi2() - (others.empty() ? 0.0 : solve_last(others).chi2());
  }
  return out;
}

InRunFit Measurement::in_run(const Member& member) const {
  const auto group = static_cast<std::size_t>(group_of(member));
  const Eliminated& information = eliminated_[group];
  const std::vector<Term> terms = terms_at_point(member);
  InRunFit out;
  // s in this run is s R(p) M with the small turn p and a turn M of a cube: the item itself has turned by
  // (R(p) M)' = R(-M' p) M'.
  out.turn = member.turn.transpose();
  if (member.mounting >= 0) {
    const Eigen::Index place = place_[static_cast<std::size_t>(member.mounting)];
    out.small_turn = -(out.turn * point_.segment<3>(member.mounting));
    out.small_turn_covariance = out.turn * covariance_.block<3, 3>(place, place) * out.turn.transpose();
  }
  out.value = q_of(member, point_);
  // With x = (own, last): own = change - follow last, so that q varies by A last + J_own own noise.
  const Eigen::MatrixXd follow = information.follow.transpose();
  Eigen::MatrixXd by_last = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(last_.size()), out.value.size());
  std::vector<Term> of_own;
  for (const Term& term : terms) {
    const Eigen::Index place = place_[static_cast<std::size_t>(term.x)];
    if (unknowns_[static_cast<std::size_t>(term.x)].group < 0) {
      by_last(place, term.q) += term.value;
    } else {
      by_last.col(term.q) -= term.value * follow.col(place);
      of_own.push_back({term.q, place, term.value});
    }
  }
  out.covariance = carried_covariance(by_last.transpose(), covariance_);
  const Eigen::MatrixXd own = information.own.inverse();
  Eigen::MatrixXd half = Eigen::MatrixXd::Zero(own.rows(), out.value.size());
  for (const Term& term : of_own) half.col(term.q) += term.value * own.col(term.x);
  const Eigen::MatrixXd by_q = half.transpose();
  for (const Term& term : of_own) out.covariance.col(term.q) += term.value * by_q.col(term.x);
  return out;
}

void Measurement::fill_poses(MeasurementFit& out) const {
  const auto count = static_cast<Eigen::Index>(of_run_.size());
  out.poses = Eigen::VectorXd::Zero(count);
  out.covariance_poses = Eigen::MatrixXd::Zero(count, count);
  Eigen::MatrixXd half = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(last_.size()), count);
  for (Eigen::Index i = 0; i < count; ++i) {
    for (const Eigen::Index x : of_run_[static_cast<std::size_t>(i)]) {
      out.poses(i) += point_(x);
      half.col(i) += covariance_.col(place_[static_cast<std::size_t>(x)]);
    }
  }
  for (Eigen::Index i = 0; i < count; ++i)
    for (const Eigen::Index x : of_run_[static_cast<std::size_t>(i)])
      out.covariance_poses.row(i) += half.row(place_[static_cast<std::size_t>(x)]);
}

/// Between two items at their chosen noises; each one's own is that of its average.
void Measurement::fill_covariance_of_lines(MeasurementFit& out) const {
  if (items_.size() == 1) {
    out.covariance_lines = out.items.front().covariance_line;
    return;
  }
  const auto count = static_cast<Eigen::Index>(items_.size());
  out.covariance_lines.resize(12 * count, 12 * count);
  std::vector<Rows12> rows;
  for (std::size_t i = 0; i < items_.size(); ++i) {
    const Member& member = members_[items_[i].first];
    const AssumedNoise* noise = has_own_fit(member) ? &member.of->own->noises[member.noise] : nullptr;
    rows.push_back(scaled_rows(units_of_line(first_of(items_[i]).unit), line_rows_at(i, point_, noise).by_x));
  }
  const Groups groups = eliminated();
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const Eigen::MatrixXd by_all = response(groups, solved_, rows[at]);
    for (Eigen::Index k = 0; k < count; ++k)
      out.covariance_lines.block<12, 12>(12 * k, 12 * i) =
          i == k ? out.items[at].covariance_line
                 : Covariance12(product(rows[static_cast<std::size_t>(k)], by_all));
  }
}

MeasurementFit Measurement::result() {
  MeasurementFit out;
  out.repeatabilities = before_;
  for (int pass = 0; pass < kNoisePasses; ++pass) {
    out.converged = minimise();
    if (out.converged && pass == 0 && estimates_sizes()) {
      set_sizes(estimate_sizes(out));
      out.converged = minimise();
    }
    if (!out.converged) {
      out.iterations = iterations_;
      return out;
    }
    if (!choose_noises(pass + 1 < kNoisePasses)) break;
  }
  out.iterations = iterations_;
  covariance_ = covariance_of_root(solved_.normal.covariance_root());
  out.items.resize(items_.size());
  side_by_side(items_.size(), [&](std::size_t i) { out.items[i] = item_result(i); });
  out.in_runs.resize(members_.size());
  side_by_side(members_.size(), [&](std::size_t m) { out.in_runs[m] = in_run(members_[m]); });
  fill_covariance_of_lines(out);
  fill_poses(out);
  out.stage = stage_;
  out.stage.mean = point_.head(stage_.size());
  out.stage.covariance = covariance_.topLeftCorner(stage_.size(), stage_.size());
  out.chi2 = solved_.chi2();
  for (const Member& member : members_) out.degrees_of_freedom += member.information->readings;
  out.degrees_of_freedom -= 12 * static_cast<int>(items_.size());
  out.log_likelihood = solved_.log_likelihood();
  out.reciprocal_condition = solved_.normal.reciprocal_condition();
  return out;
}

/// Unknowns of the stage that a record knows vary together; all others vary by themselves.
MeasurementTruth Measurement::truth(const std::function<double(const std::string& key)>& standard,
                                    const Eigen::MatrixXd& root_of_record) const {
  Eigen::VectorXd x = point_;
  for (std::size_t i = 0; i < unknowns_.size(); ++i) {
    const Unknown& unknown = unknowns_[i];
    const bool is_fitted = !std::isfinite(unknown.sd) || unknown.effect == kMounting;
    if (!is_fitted) x(static_cast<Eigen::Index>(i)) = unknown.mean + unknown.sd * standard(unknown.key);
  }
  for (const Eigen::Index place : new_angles_) {
    // The fit takes the map at the axis' zero as free; its size there is that of every other angle.
    const double step = step_prior(sizes_);
    x(place) = std::sqrt(std::max(0.0, step * step - visit_ * visit_)) * standard("step_deg");
  }
  if (options_.stage) {
    Eigen::VectorXd independent(options_.stage->size());
    for (double& one : independent) one = standard("");
    const Eigen::VectorXd drawn = options_.stage->mean + product_with_vector(root_of_record, independent);
    for (Eigen::Index i = 0; i < stage_.size(); ++i)
      if (const Eigen::Index known = known_[static_cast<std::size_t>(i)]; known >= 0) x(i) = drawn(known);
  }
  MeasurementTruth out;
  for (const Member& member : members_) out.in_runs.push_back(q_of(member, x));
  for (const Item& item : items_) {
    const Eigen::VectorXd own = x.segment(item.at, 3 * item.layout.own_count());
    out.lines.push_back(line_values(item.layout, own).cwiseProduct(units_of_line(first_of(item).unit)));
  }
  return out;
}

}  // namespace

struct MeasurementTruths::Solved {
  Measurement measurement;
  MeasurementFit fit;
  Eigen::MatrixXd root_of_record;
};

MeasurementTruths::MeasurementTruths(std::span<const MeasuredItem> measured,
                                     const MeasurementOptions& options)
    : solved_(new Solved{Measurement(measured, options), {}, {}}) {
  solved_->fit = solved_->measurement.result();
  if (options.stage) solved_->root_of_record = root_of_covariance(*options.stage);
}
MeasurementTruths::~MeasurementTruths() = default;

const MeasurementFit& MeasurementTruths::fit() const {
  return solved_->fit;
}

MeasurementTruth MeasurementTruths::draw(
    const std::function<double(const std::string& key)>& standard) const {
  return solved_->measurement.truth(standard, solved_->root_of_record);
}

double variance_of_new_map(const AxisAngle& angle, double step, double visit) {
  constexpr double kFreeAtZero = 100.0;
  constexpr double kLeastShare = 0.05;  // The map stays solvable.
  if (angle.microdegrees == 0) return std::pow(kFreeAtZero * step, 2);
  return std::max(step * step - visit * visit, std::pow(kLeastShare * step, 2));
}

Message InRunFit::mounting() const {
  return turn_in_words(turn);
}

MeasurementFit fit_measurement(std::span<const MeasuredItem> measured, const MeasurementOptions& options) {
  return Measurement(measured, options).result();
}

}  // namespace abcal
