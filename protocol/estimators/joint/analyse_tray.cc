#include "protocol/estimators/joint/analyse_tray.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <stdexcept>
#include <string_view>
#include <tuple>
#include <utility>

#include "protocol/estimators/checks/result_checks.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/joint/joint_result.h"
#include "protocol/estimators/joint/joint_verdict.h"
#include "protocol/estimators/joint/tray_fit.h"
#include "protocol/estimators/series/series_result.h"
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

/// The angles of the stage in the order of measurement, and the angle of each dwell of each record.
class StageAngles {
 public:
  explicit StageAngles(std::span<const RunRecord> records) {
    for (const RunRecord& record : records) add(record);
  }
  std::span<const DwellRecord* const> angles() const { return angles_; }
  int of(const DwellRecord* dwell) const { return place_.at(dwell); }
  std::vector<int> of(const CollectedReadings& data) const {
    std::vector<int> out;
    for (const DwellRecord* dwell : data.dwells) out.push_back(of(dwell));
    return out;
  }

 private:
  using Key = std::tuple<int, int, DwellRole, bool>;

  /// Largest time (s) between two items' dwells at one angle. Items read at different rates may have the
  /// middle of a dwell at different times, but closer to each other than to that of any other dwell.
  static double same_time(const RunRecord& record) {
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 1; i < record.dwells.size(); ++i) {
      const auto& [before, now] = std::pair(record.dwells[i - 1].time_s, record.dwells[i].time_s);
      if (before && now && *now > *before) least = std::min(least, *now - *before);
    }
    return 0.5 * least;
  }

  void add(const RunRecord& record) {
    const double within = same_time(record);
    std::map<Key, std::size_t> visits;  // of this record
    for (const DwellRecord& dwell : record.dwells) {
      const Key key(dwell.experiment, dwell.n, dwell.role, dwell.closing);
      std::vector<int>& known = by_key_[key];
      const std::size_t visit = visits[key]++;
      int found = -1;
      for (std::size_t i = 0; i < known.size() && found < 0; ++i) {
        const std::optional<double>& time = angles_[static_cast<std::size_t>(known[i])]->time_s;
        const bool same = time && dwell.time_s ? std::abs(*time - *dwell.time_s) <= within : i == visit;
        if (same) found = known[i];
      }
      if (found < 0) {
        found = static_cast<int>(angles_.size());
        known.push_back(found);
        angles_.push_back(&dwell);
      }
      place_[&dwell] = found;
    }
  }

  std::vector<const DwellRecord*> angles_;
  std::map<Key, std::vector<int>> by_key_;
  std::map<const DwellRecord*, int> place_;
};

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
  double test_agreement(const TrayFit& fit);
  void fill_common();
  void add_shared_voltmeters();
  void fill_stage(double level);
  double level() const;

  std::span<const RunRecord> records_;
  std::vector<ItemFit> own_;
  StageAngles angles_;
  std::vector<std::size_t> members_;
  TrayFit fit_;
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
        throw std::invalid_argument(fmt::format(
            "tray: item 1 states [{}] {} = {:.6g}, item {} states {:.6g}; all items of a run stand "
            "on one stage: state one size",
            key.section, key.key, first, k + 1, other));
    }
  }
}

/// The result of an item by its own fit, with the record of the stage if there is one and no other item.
CalibrationResult result_of_one(const RunRecord& record, const ItemFit& own, std::size_t items) {
  if (!record.stage_record.record) return joint_result(record, own);
  if (items == 1) return result_with_record(record, own);
  CalibrationResult result = joint_result(record, own);
  result.diagnostics.notes.push_back(Message(
      "the record of the stage is not used: several items are fitted with the stated sizes of the stage"));
  return result;
}

TrayAnalysis::TrayAnalysis(std::span<const RunRecord> records, const JointOptions& options)
    : records_(records), angles_(records) {
  own_.resize(records.size());
  out_.items.resize(records.size());
  side_by_side(records.size(), [&](std::size_t k) {
    try {
      own_[k] = fit_item(records[k], options);
    } catch (const UnusableData& error) {
      own_[k].why = error.message();
    }
    out_.items[k].result = result_of_one(records[k], own_[k], records.size());
    out_.items[k].checks = check_record(records[k]);
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
    for (const DwellRecord& dwell : records_[i].dwells) of_first[angles_.of(&dwell)] = &dwell;
    for (std::size_t k = i + 1; k < records_.size(); ++k) {
      std::size_t same = 0;
      for (const DwellRecord& dwell : records_[k].dwells) {
        const auto other = of_first.find(angles_.of(&dwell));
        if (other != of_first.end() && other->second->mean == dwell.mean) ++same;
      }
      if (!(static_cast<double>(same) > kSameReadings * static_cast<double>(records_[k].dwells.size())))
        continue;
      const Message words(
          "items {first} and {second} have the same readings at {same} of {all} angles: one item is read "
          "twice; "
          "see which port each is on",
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
  if (records_.size() > 1 && is_at_constant_rate(records_.front())) {
    // Delays of the items are among the unknowns of the stage that they would share.
    members_.clear();
    for (const std::size_t k : solved)
      out_.items[k].why_not = Message("at a constant rate each item is evaluated by itself");
    return;
  }
  if (members_.empty()) members_ = solved;
  for (const std::size_t k : solved) {
    if (std::find(members_.begin(), members_.end(), k) == members_.end())
      out_.items[k].why_not =
          Message("doubtful on its own, so that its readings tell nothing of the stage to the others");
  }
}

bool TrayAnalysis::fit_members() {
  std::vector<TrayMember> members;
  std::vector<TrayAngle> angles;
  for (const DwellRecord* angle : angles_.angles()) {
    const SinCos alpha = sincos(angle->alpha);
    angles.push_back({angle->experiment, alpha.sin, alpha.cos, angle->face});
  }
  for (const std::size_t k : members_) members.push_back({&*own_[k].solution, angles_.of(own_[k].data)});
  fit_ = fit_tray(members, angles);
  return fit_.converged;
}

/// @return the least probability of all members
double TrayAnalysis::test_agreement(const TrayFit& fit) {
  double least = 1.0;
  for (std::size_t i = 0; i < members_.size(); ++i) {
    TrayItemResult& item = out_.items[members_[i]];
    const EffectSolution& own = *own_[members_[i]].solution;
    item.chi2_given_others = fit.chi2_given_others[i];
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
    if (test_agreement(fit_) >= level()) return;
    if (members_.size() == 2) {
      const std::vector<std::size_t> both = members_;
      for (const std::size_t k : both)
        set_aside(k, Message("items {first} and {second} contradict each other about the stage (probability "
                             "{probability:.1g}), "
                             "and two cannot tell which of them is wrong: see how they are mounted",
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

void TrayAnalysis::fill_stage(double level) {
  const EffectFit& stage = fit_.stage;
  TrayStage& out = out_.stage.emplace();
  out.items = static_cast<int>(members_.size());
  for (std::size_t i = 0; i < stage.unknowns.size(); ++i) {
    const EffectUnknown& unknown = stage.unknowns[i];
    const auto at = static_cast<Eigen::Index>(i);
    if (unknown.key == "sweep_deg") continue;  // Only of this run's sweeps.
    const auto [factor, unit] = shown_unit(unknown.key);
    out.unknowns.push_back({unknown.effect, unknown.name,
                            scaled_quantity(stage.value(at), stage.covariance(at, at), factor, unit)});
  }
  for (std::size_t a = 0; a < stage.step_error.size(); ++a) {
    const DwellRecord& angle = *angles_.angles()[a];
    const double u = stage.u_step_error[a];
    const double u_error = fit_.u_angle_error[a];
    out.steps.push_back(
        {angle.experiment, angle.n, angle.closing ? DwellRole::kClosing : angle.role,
         scaled_quantity(stage.step_error[a], u * u, kDegreesPerRadian, "degree"),
         scaled_quantity(fit_.angle_error[a], u_error * u_error, kDegreesPerRadian, "degree")});
  }
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
    if (fit_members()) fill_stage(level());
    return;
  }
  out_.iterations = fit_.iterations;
  out_.common_covariance = fit_.covariance;
  fill_stage(level());
  for (std::size_t i = 0; i < members_.size(); ++i) {
    const std::size_t k = members_[i];
    TrayItemResult& item = out_.items[k];
    item.in_common_fit = true;
    item.result = joint_result(records_[k], own_[k], &fit_.items[i]);
    item.result.joint->iterations = fit_.iterations;
    if (out_.stage->contradicted_sizes.empty()) continue;
    object_to(item.result, Message("all items together contradict what is stated of the stage: {sizes}",
                                   out_.stage->contradicted_sizes));
    std::vector<Message>& sizes = item.result.joint->contradicted_sizes;
    sizes.insert(sizes.end(), out_.stage->contradicted_sizes.begin(), out_.stage->contradicted_sizes.end());
  }
}

/// Adds the gain of a voltmeter that reads several items: not an unknown of the fit, but common to them.
void TrayAnalysis::add_shared_voltmeters() {
  if (members_.size() < 2) return;  // It is in the covariance of the only result.
  const auto effect = [&](std::size_t k) {
    const CalibrationResult& result = out_.items[k].result;
    const Eigen::Vector3d offset(result.offset[0].value, result.offset[1].value, result.offset[2].value);
    return effect_of_gain(result.sensitivity_values(), offset, records_[k].tolerances);
  };
  for (std::size_t i = 0; i < members_.size(); ++i) {
    for (std::size_t k = 0; k < members_.size(); ++k) {
      if (!share_voltmeter(records_[members_[i]].tolerances, records_[members_[k]].tolerances)) continue;
      out_.common_covariance.block<12, 12>(12 * static_cast<Eigen::Index>(i),
                                           12 * static_cast<Eigen::Index>(k)) +=
          effect(members_[i]) * effect(members_[k]).transpose();
    }
  }
}

TrayResult TrayAnalysis::result() && {
  choose_members();
  set_aside_copies();
  agree();
  fill_common();
  add_shared_voltmeters();
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
  return result_of_one(record, fit_item(record, options), 1);
}

IntrinsicComparison compare_items(const TrayResult& tray, std::size_t i, std::size_t k) {
  for (const std::size_t item : {i, k}) {
    if (!tray.items.at(item).in_common_fit)
      throw std::invalid_argument(
          fmt::format("comparison of items {} and {}: item {} is not in the common fit ({}), so that nothing "
                      "is known of what "
                      "the two share; compare the usable ones",
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
