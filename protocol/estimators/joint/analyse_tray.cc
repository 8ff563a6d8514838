#include "protocol/estimators/joint/analyse_tray.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <set>
#include <stdexcept>
#include <string_view>
#include <tuple>
#include <utility>

#include "protocol/estimators/checks/result_checks.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/joint/joint_result.h"
#include "protocol/estimators/joint/joint_verdict.h"
#include "protocol/estimators/measurement/measurement_result.h"
#include "protocol/estimators/measurement/stage_poses.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/objection.h"
#include "protocol/estimators/shared/side_by_side.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;
constexpr double kUradPerRadian = 1e6;
/// Two items whose means are identical at more than this share of the angles are one item, read twice: noise
/// makes different items differ.
constexpr double kSameReadings = 0.5;

/// The steps from the records to the result.
class TrayAnalysis {
 public:
  TrayAnalysis(std::span<const RunRecord> records, const JointOptions& options);
  TrayResult result() &&;

 private:
  void set_aside(std::size_t k, const Message& words);
  void set_aside_copies();
  void choose_members();
  bool fit_members();
  void agree();
  double test_agreement();
  void fill_common();
  void share_voltmeters();
  std::vector<const DwellRecord*> poses_in_use() const;
  Eigen::MatrixXd rows_of_angle_errors(std::span<const DwellRecord* const> poses) const;
  EffectFit stage_fit() const;
  void fill_stage(double level);
  double level() const;

  std::span<const RunRecord> records_;
  bool stage_of_one_;
  std::vector<ItemFit> own_;
  StagePoses poses_;
  std::vector<std::size_t> members_;
  std::vector<std::optional<RunInformation>> information_;  ///< Present for items that have a solution.
  std::vector<MeasuredItem> measured_;                      ///< The members.
  MeasurementOptions fit_options_;
  MeasurementFit fit_;
  std::vector<std::pair<std::size_t, Message>> objections_;  ///< Item and objection to its result.
  TrayResult out_;
};

void require_one_stage(std::span<const RunRecord> records, const JointOptions& options) {
  if (records.empty()) throw std::invalid_argument("tray: no items");
  if (records.size() > 1 && options.one_map_per_axis)
    throw std::invalid_argument("tray: one map of step errors per axis is for runs of one item");
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (key.section != "stage_uncertainty") continue;
    for (std::size_t k = 1; k < records.size(); ++k) {
      const double first = key.get(records.front().tolerances);
      const double other = key.get(records[k].tolerances);
      if (first != other)
        throw std::invalid_argument(
            fmt::format("tray: item 1 states [{}] {} = {:.6g}, item {} states {:.6g}; all items of a run "
                        "stand on one stage: state one size",
                        key.section, key.key, first, k + 1, other));
    }
  }
}

/// The result of an item by its own fit, with the record of the stage if there is one.
CalibrationResult result_of_one(const RunRecord& record, const ItemFit& own) {
  return record.stage_record.record ? result_with_record(record, own) : joint_result(record, own);
}

TrayAnalysis::TrayAnalysis(std::span<const RunRecord> records, const JointOptions& options)
    : records_(records), stage_of_one_(options.stage_of_one), poses_(records) {
  own_.resize(records.size());
  information_.resize(records.size());
  out_.items.resize(records.size());
  // The checks of a record need no fit.
  side_by_side(2 * records.size(), [&](std::size_t task) {
    const std::size_t k = task / 2;
    if (task % 2 == 1) {
      out_.items[k].checks = check_record(records[k]);
      return;
    }
    try {
      own_[k] = fit_item(records[k], options);
    } catch (const UnusableData& error) {
      own_[k].why = error.message();
    }
    out_.items[k].result = result_of_one(records[k], own_[k]);
  });
}

/// Level of each of the tests of all items together.
double TrayAnalysis::level() const {
  constexpr std::size_t kTestsOfTheStage = 12;
  return kFamilyWiseFalseAlarm / static_cast<double>(records_.size() + kTestsOfTheStage);
}

void TrayAnalysis::set_aside(std::size_t k, const Message& words) {
  std::erase(members_, k);
  out_.items[k].why_not = words;
  objections_.emplace_back(k, words);
}

void TrayAnalysis::set_aside_copies() {
  for (std::size_t i = 0; i < records_.size(); ++i) {
    std::map<int, const DwellRecord*> of_first;
    for (const DwellRecord& dwell : records_[i].dwells) of_first[poses_.of(&dwell)] = &dwell;
    for (std::size_t k = i + 1; k < records_.size(); ++k) {
      std::size_t same = 0;
      for (const DwellRecord& dwell : records_[k].dwells) {
        const auto other = of_first.find(poses_.of(&dwell));
        if (other != of_first.end() && other->second->mean == dwell.mean) ++same;
      }
      if (!(static_cast<double>(same) > kSameReadings * static_cast<double>(records_[k].dwells.size())))
        continue;
      const Message words(
          "items {first} and {second} have the same readings at {same} of {all} angles: one item is read "
          "twice; see which port each is on",
          i + 1, k + 1, same, records_[k].dwells.size());
      objections_.emplace_back(i, words);
      set_aside(k, words);
    }
  }
}

/// Chooses the items that are usable on their own; if none is, all that have a result.
void TrayAnalysis::choose_members() {
  std::vector<std::size_t> solved;
  const auto sound = [&](std::size_t k) {
    const std::vector<Check>& checks = out_.items[k].checks;
    return out_.items[k].result.verdict == Verdict::kUsable &&
           std::all_of(checks.begin(), checks.end(), [](const Check& check) { return check.passed; });
  };
  for (std::size_t k = 0; k < records_.size(); ++k) {
    if (!own_[k].solution) {
      out_.items[k].why_not = own_[k].why;
    } else {
      solved.push_back(k);
      if (sound(k)) members_.push_back(k);
    }
  }
  if (const auto why = why_each_by_itself(records_); why && records_.size() > 1) {
    members_.clear();
    for (const std::size_t k : solved) out_.items[k].why_not = *why;
    return;
  }
  if (members_.empty()) members_ = solved;
  for (const std::size_t k : solved) {
    if (std::find(members_.begin(), members_.end(), k) == members_.end())
      out_.items[k].why_not = doubtful_on_its_own();
  }
}

bool TrayAnalysis::fit_members() {
  measured_.clear();
  for (const std::size_t k : members_) {
    if (!information_[k]) {
      information_[k] = run_information(own_[k].data, *own_[k].solution);
      information_[k]->source = records_[k].source;
    }
    measured_.push_back({.information = &*information_[k],
                         .item = static_cast<int>(measured_.size()),
                         .pose = poses_.of(own_[k].data),
                         .own = &*own_[k].solution});
  }
  fit_options_ = options_of(records_.front().stage_record);
  fit_options_.separates_what_repeats = fit_options_.stage.has_value();
  fit_ = fit_measurement(measured_, fit_options_);
  return fit_.converged;
}

/// @return the least probability of all members
double TrayAnalysis::test_agreement() {
  double least = 1.0;
  for (std::size_t i = 0; i < members_.size(); ++i) {
    TrayItemResult& item = out_.items[members_[i]];
    const EffectSolution& own = *own_[members_[i]].solution;
    item.chi2_given_others = fit_.items[i].chi2_given_others;
    item.degrees_of_freedom = own.fit.chi2_degrees_of_freedom;
    item.probability = f_tail(item.chi2_given_others, item.degrees_of_freedom, own.white.redundancy.sum());
    least = std::min(least, item.probability);
  }
  return least;
}

/// Sets aside the items that contradict the others, the worst first.
void TrayAnalysis::agree() {
  while (members_.size() > 1) {
    if (!fit_members()) {
      const std::vector<std::size_t> all = members_;
      for (const std::size_t k : all)
        set_aside(
            k, Message(
                   "no stage explains the readings of all items together (the common fit did not converge)"));
      return;
    }
    if (test_agreement() >= level()) return;
    if (members_.size() == 2) {
      const std::vector<std::size_t> both = members_;
      for (const std::size_t k : both)
        set_aside(
            k, Message(
                   "items {first} and {second} contradict each other about the stage (probability "
                   "{probability:.1g}), and two cannot tell which of them is wrong: see how they are mounted",
                   both[0] + 1, both[1] + 1, out_.items[k].probability));
      return;
    }
    const std::size_t worst = *std::max_element(members_.begin(), members_.end(), [&](auto a, auto b) {
      return out_.items[a].chi2_given_others / out_.items[a].degrees_of_freedom <
             out_.items[b].chi2_given_others / out_.items[b].degrees_of_freedom;
    });
    set_aside(
        worst,
        Message("it contradicts the other items about the stage: {chi2}; see how it is mounted",
                Message("chi2 {chi2:.4g} for {degrees} degrees of freedom (probability {probability:.1g})",
                        out_.items[worst].chi2_given_others, out_.items[worst].degrees_of_freedom,
                        out_.items[worst].probability)));
  }
}

/// Unit in which an unknown of the stage is shown, and how many of it are one of the fit's.
std::pair<double, const char*> shown_unit(std::string_view key) {
  if (key == "alignment_deg") return {1.0, "1"};
  if (key == "wobble_urad") return {kUradPerRadian, "urad"};
  if (key == "delay_s") return {1.0, "s"};
  if (key == "axes_distance_mm") return {1e3, "mm"};
  return {kDegreesPerRadian, "degree"};
}

/// The stage's poses at which any member has a reading, in the order of measurement. None in motion.
std::vector<const DwellRecord*> TrayAnalysis::poses_in_use() const {
  std::set<int> in_use;
  for (const MeasuredItem& one : measured_)
    if (!one.information->in_motion) in_use.insert(one.pose.begin(), one.pose.end());
  std::vector<const DwellRecord*> out;
  if (fit_.poses.size() == static_cast<Eigen::Index>(fit_.stage.names.size()))
    return out;  // Their size is zero.
  for (const int pose : in_use) out.push_back(poses_.poses()[static_cast<std::size_t>(pose)]);
  return out;
}

/// The error of the angle turned at each pose, minus its mean over the experiment, as rows by the unknowns of
/// the stage and the step errors of the poses.
Eigen::MatrixXd TrayAnalysis::rows_of_angle_errors(std::span<const DwellRecord* const> poses) const {
  const std::vector<EffectLayout::StageUnknown>& unknowns = measured_.front().information->layout.stage;
  const auto names = static_cast<Eigen::Index>(fit_.stage.names.size());
  const auto count = static_cast<Eigen::Index>(poses.size());
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(count, fit_.poses.size());
  Eigen::MatrixXd mean = Eigen::MatrixXd::Zero(3, fit_.poses.size());
  Eigen::Vector3d in_experiment = Eigen::Vector3d::Zero();
  for (Eigen::Index a = 0; a < count; ++a) {
    const DwellRecord& angle = *poses[static_cast<std::size_t>(a)];
    const SinCos alpha = sincos(angle.alpha);
    const StagePose pose = StagePose::of(angle.experiment, angle.face, alpha.sin, alpha.cos);
    for (const EffectLayout::StageUnknown& unknown : unknowns) {
      const StageShare share = unknown.effect->share(pose, unknown.index);
      if (share.input == moving_angle_input(angle.experiment))
        rows(a, fit_.stage.place_of(unknown_name(*unknown.effect, unknown.index))) = share.value;
    }
    rows(a, names + a) = 1.0;
    mean.row(angle.experiment - 1) += rows.row(a);
    in_experiment(angle.experiment - 1) += 1.0;
  }
  for (Eigen::Index a = 0; a < count; ++a) {
    const int experiment = poses[static_cast<std::size_t>(a)]->experiment - 1;
    rows.row(a) -= mean.row(experiment) / in_experiment(experiment);
  }
  return rows;
}

/// The stage as the tests of sizes take it.
EffectFit TrayAnalysis::stage_fit() const {
  EffectFit out;
  const auto names = static_cast<Eigen::Index>(fit_.stage.names.size());
  out.unknowns.resize(fit_.stage.names.size());
  for (const EffectUnknown& unknown : measured_.front().information->unknowns)
    if (const Eigen::Index place = unknown.output < 0 ? fit_.stage.place_of(unknown.name) : -1; place >= 0)
      out.unknowns[static_cast<std::size_t>(place)] = unknown;
  out.value = fit_.poses.head(names);
  out.covariance = fit_.covariance_poses.topLeftCorner(names, names);
  for (Eigen::Index a = names; a < fit_.poses.size(); ++a) {
    out.step_error.push_back(fit_.poses(a));
    out.u_step_error.push_back(std::sqrt(fit_.covariance_poses(a, a)));
  }
  return out;
}

void TrayAnalysis::fill_stage(double level) {
  const EffectFit stage = stage_fit();
  TrayStage& out = out_.stage.emplace();
  out.items = static_cast<int>(members_.size());
  for (std::size_t i = 0; i < stage.unknowns.size(); ++i) {
    const EffectUnknown& unknown = stage.unknowns[i];
    const auto at = static_cast<Eigen::Index>(i);
    if (unknown.name.empty()) continue;  // The record alone knows it.
    const auto [factor, unit] = shown_unit(unknown.key);
    out.unknowns.push_back({unknown.effect, unknown.name,
                            scaled_quantity(stage.value(at), stage.covariance(at, at), factor, unit)});
  }
  const std::vector<const DwellRecord*> poses = poses_in_use();
  const Eigen::MatrixXd rows = rows_of_angle_errors(poses);
  const Eigen::VectorXd error = product_with_vector(rows, fit_.poses);
  const Eigen::MatrixXd row_by_covariance = product(rows, fit_.covariance_poses);
  for (std::size_t a = 0; a < stage.step_error.size(); ++a) {
    const DwellRecord& angle = *poses[a];
    const auto at = static_cast<Eigen::Index>(a);
    out.steps.push_back(
        {angle.experiment, angle.n, angle.closing ? DwellRole::kClosing : angle.role,
         scaled_quantity(stage.step_error[a], std::pow(stage.u_step_error[a], 2), kDegreesPerRadian,
                         "degree"),
         scaled_quantity(error(at), std::max(0.0, row_by_covariance.row(at).dot(rows.row(at))),
                         kDegreesPerRadian, "degree")});
  }
  if (fit_options_.stage) return;  // Each item's result has the test of the record.
  if (members_.size() == 1) {
    // The tests of one member alone are those of its own verdict.
    for (const EffectTest& test : own_[members_.front()].tests.effects) {
      const bool of_stage =
          std::any_of(stage.unknowns.begin(), stage.unknowns.end(),
                      [&](const EffectUnknown& unknown) { return unknown.effect == test.name; });
      if (of_stage || test.name == "step errors") out.effects.push_back(test);
    }
  } else {
    out.effects = test_sizes(stage, step_prior(records_.front().tolerances));
    for (EffectTest& test : out.effects) test.passed = test.probability >= level;
  }
  for (const EffectTest& test : out.effects) {
    if (!test.passed) out.contradicted_sizes.push_back(words_of(test));
  }
}

void TrayAnalysis::fill_common() {
  if (members_.empty()) return;
  if (members_.size() == 1) {
    out_.items[members_.front()].in_common_fit = true;
    out_.common_covariance = *out_.items[members_.front()].result.covariance;
    if ((records_.size() > 1 || stage_of_one_) && fit_members()) fill_stage(level());
    return;
  }
  out_.iterations = fit_.iterations;
  out_.common_covariance = fit_.covariance_lines;
  fill_stage(level());
  for (std::size_t i = 0; i < members_.size(); ++i) {
    const std::size_t k = members_[i];
    TrayItemResult& item = out_.items[k];
    item.in_common_fit = true;
    item.result = result_from(records_[k], own_[k], measured_[i], fit_, fit_options_);
    item.result.joint->iterations = fit_.iterations;
    if (out_.stage->contradicted_sizes.empty()) continue;
    object_to(item.result, Message("all items together contradict what is stated of the stage: {sizes}",
                                   out_.stage->contradicted_sizes));
    std::vector<Message>& sizes = item.result.joint->contradicted_sizes;
    sizes.insert(sizes.end(), out_.stage->contradicted_sizes.begin(), out_.stage->contradicted_sizes.end());
  }
}

void TrayAnalysis::share_voltmeters() {
  std::vector<ReadItem> read;
  for (const std::size_t k : members_) read.push_back({&out_.items[k].result, &records_[k].tolerances});
  add_shared_voltmeters(read, out_.common_covariance);
}

TrayResult TrayAnalysis::result() && {
  choose_members();
  set_aside_copies();
  agree();
  fill_common();
  share_voltmeters();
  for (const auto& [k, words] : objections_) object_to(out_.items[k].result, words);
  judge_tray(out_);
  return std::move(out_);
}

}  // namespace

Covariance12 TrayResult::covariance(std::size_t i, std::size_t k) const {
  if (i == k) return items.at(i).result.covariance.value_or(Covariance12::Zero());
  if (!items.at(i).in_common_fit || !items.at(k).in_common_fit) return Covariance12::Zero();
  const auto place = [&](std::size_t item) {
    return 12 * std::count_if(items.begin(), items.begin() + static_cast<std::ptrdiff_t>(item),
                              [](const TrayItemResult& each) { return each.in_common_fit; });
  };
  return common_covariance.block<12, 12>(place(i), place(k));
}

Covariance18 TrayResult::covariance_of_all_outputs(std::size_t i, std::size_t k) const {
  const auto rows = [&](std::size_t item) {
    Eigen::Matrix<double, 18, 12> out;
    out.topRows<12>().setIdentity();
    out.bottomRows<6>() = intrinsic_jacobian(items.at(item).result.sensitivity_values()).topRows<6>();
    return out;
  };
  return product_transposed(product(rows(i), covariance(i, k)), rows(k));
}

std::optional<Message> why_each_by_itself(std::span<const RunRecord> records) {
  if (std::ranges::none_of(records, is_at_constant_rate)) return std::nullopt;
  return Message("at a constant rate each item is evaluated by itself");
}

Message doubtful_on_its_own() {
  return Message("doubtful on its own, so that its readings tell nothing of the stage to the others");
}

void judge_tray(TrayResult& tray) {
  std::vector<Message> not_usable, doubtful;
  for (std::size_t k = 0; k < tray.items.size(); ++k) {
    const CalibrationResult& result = tray.items[k].result;
    const Message words("item {item}: {why}", k + 1, result.why);
    if (result.verdict == Verdict::kNotUsable) not_usable.push_back(words);
    if (result.verdict == Verdict::kDoubtful) doubtful.push_back(words);
  }
  const std::size_t usable = tray.items.size() - not_usable.size() - doubtful.size();
  if (usable == tray.items.size()) {
    tray.verdict = Verdict::kUsable;
    tray.why = usable == 1 ? Message("1 item is usable, and agree about the stage")
                           : Message("{items} items are usable, and agree about the stage", usable);
    return;
  }
  tray.verdict = not_usable.size() == tray.items.size() ? Verdict::kNotUsable : Verdict::kDoubtful;
  std::vector<Message> parts{Message("{usable} of {all} items usable", usable, tray.items.size())};
  if (!not_usable.empty()) parts.push_back(Message("not usable: {items}", not_usable));
  if (!doubtful.empty()) parts.push_back(Message("doubtful: {items}", doubtful));
  tray.why = in_sequence(parts);
}

TrayResult analyse_tray(std::span<const RunRecord> records, const JointOptions& options) {
  require_one_stage(records, options);
  return TrayAnalysis(records, options).result();
}

/// The checks of the record and the stage, which analyse_tray() adds, do not change the result of one item.
CalibrationResult analyse_joint(const RunRecord& record, const JointOptions& options) {
  return result_of_one(record, fit_item(record, options));
}

IntrinsicComparison compare_items(const TrayResult& tray, std::size_t i, std::size_t k) {
  for (const std::size_t item : {i, k}) {
    if (!tray.items.at(item).in_common_fit)
      throw std::invalid_argument(
          fmt::format("comparison of items {} and {}: item {} is not in the common fit ({}), so that nothing "
                      "is known of what the two share; compare the usable ones",
                      i + 1, k + 1, item + 1, tray.items[item].why_not));
  }
  const CalibrationResult& first = tray.items[i].result;
  const CalibrationResult& second = tray.items[k].result;
  const Covariance9 shared =
      product_transposed(product(intrinsic_jacobian(first.sensitivity_values()), tray.covariance(i, k)),
                         intrinsic_jacobian(second.sensitivity_values()));
  return compare_intrinsic(intrinsic_values(first), *first.covariance_intrinsic, intrinsic_values(second),
                           *second.covariance_intrinsic, shared);
}

}  // namespace abcal
