#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "protocol/estimators/joint/effect_model.h"
#include "protocol/model/effects.h"
#include "protocol/record/imported_dwells.h"
#include "protocol/record/run_record.h"

namespace abcal::test {

/// Several items on one stage, with every effect of the table drawn from its stated size.
struct TrayPlan {
  std::size_t items = 4;
  int steps = 16;
  double noise = 1e-5;           ///< White, relative to the sensitivity.
  double process = 0.0;          ///< Standard deviation of a wandering noise, over the white one.
  double process_angles = 10.0;  ///< Its correlation length.
  bool mixed_mounting = true;    ///< Each item turned at random; false: all alike.
  EffectSizes sizes = {};
};

struct MadeTray {
  std::vector<RunRecord> records;
  std::vector<Vector12> line;  ///< True line responses, R.
  Eigen::VectorXd stage;       ///< True unknowns of the stage, in the order of the table.
  std::vector<double> steps;   ///< True step errors (radian).
  std::vector<double> smooth;  ///< Smooth part of the stage's angle error at each angle (radian).
  double angle_error(std::size_t n) const { return steps[n] + smooth[n]; }
};

class TrayMaker {
 public:
  TrayMaker(const TrayPlan& plan, std::uint64_t seed) : plan_(plan), engine_(seed) {
    draw_stage();
    for (std::size_t k = 0; k < plan.items; ++k) add_item(k);
  }
  MadeTray made;

 private:
  double normal() { return normal_(engine_); }

  void draw_stage() {
    std::vector<double> values;
    for (const StageEffect& effect : stage_effects()) {
      if (effect.face == 2 || !(effect.prior(plan_.sizes) > 0.0)) continue;
      for (int i = 0; i < effect.count; ++i) values.push_back(effect.prior(plan_.sizes) * normal());
    }
    made.stage = Eigen::Map<Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
    for (int i = 0; i < 3 * plan_.steps; ++i) {
      const int experiment = i / plan_.steps + 1;
      made.steps.push_back(step_prior(plan_.sizes) * normal());
      const SinCos alpha = sincos(angle_of(i));
      const StagePose pose = StagePose::of(experiment, 1, alpha.sin, alpha.cos);
      StageInputs inputs = StageInputs::Zero();
      inputs(moving_angle_input(experiment)) += made.steps.back();
      std::size_t at = 0;
      double& smooth = made.smooth.emplace_back(0.0);
      for (const StageEffect& effect : stage_effects()) {
        if (effect.face == 2 || !(effect.prior(plan_.sizes) > 0.0)) continue;
        for (int u = 0; u < effect.count; ++u, ++at) {
          const StageShare share = effect.share(pose, u);
          if (effect.key == "step_smooth_deg") smooth += share.value * values[at];
          inputs(share.input) += share.value * values[at];
          inputs(share.second_input) += share.second_value * values[at];
        }
      }
      gravity_.push_back(gravity_alone(pose, inputs));
    }
  }

  Angle angle_of(int i) const { return Angle::degrees(360.0 / plan_.steps * (i % plan_.steps)); }

  void add_item(std::size_t k) {
    const double scale = 1.0 + static_cast<double>(k);
    Eigen::Matrix3d s;
    for (double& element : s.reshaped()) element = 0.05 * normal();
    s.diagonal().array() += 1.0;
    const Eigen::Quaterniond turn = Eigen::Quaterniond(normal(), normal(), normal(), normal()).normalized();
    if (plan_.mixed_mounting) s *= turn.toRotationMatrix();
    const Eigen::Vector3d unit = scale * s.rowwise().norm();
    const Eigen::Matrix3d rows = s.rowwise().normalized();
    const Eigen::Vector3d offset(0.1 * normal(), 0.1 * normal(), 0.1 * normal());
    std::vector<std::vector<double>> own(3);
    Vector12 line;
    for (int j = 0; j < 3; ++j) {
      double slope = 1.0;
      line(9 + j) = offset(j);
      for (const ItemEffect& effect : item_effects()) {
        if (effect.in_motion) continue;  // The records are of a stage at rest.
        const bool curvature = effect.key == "k2" || effect.key == "k3";
        for (int i = 0; i < effect.count; ++i) {
          const double value = (curvature ? 0.1 : 1.0) * effect.prior(plan_.sizes) * normal();
          own[static_cast<std::size_t>(j)].push_back(value);
          slope += effect.line(rows, j, i).scale * value;
          line(9 + j) += effect.line(rows, j, i).offset * value;
        }
      }
      line.segment<3>(3 * j) = unit(j) * slope * rows.row(j).transpose();
      line(9 + j) *= unit(j);
    }
    made.line.push_back(line);
    made.records.push_back(record_of(unit, rows, offset, own));
  }

  RunRecord record_of(const Eigen::Vector3d& unit, const Eigen::Matrix3d& rows, const Eigen::Vector3d& offset,
                      const std::vector<std::vector<double>>& own) {
    RunRecord record;
    record.source = "made tray";
    record.steps = plan_.steps;
    record.step = angle_of(1);
    record.tolerances = plan_.sizes;
    const auto count = static_cast<double>(gravity_.size());
    Eigen::Vector3d wander(normal(), normal(), normal());
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    const double kept = std::exp(-1.0 / plan_.process_angles);
    Eigen::Vector3d before = Eigen::Vector3d::Zero();
    for (std::size_t n = 0; n < gravity_.size(); ++n) {
      ItemPoint point{static_cast<double>(n) / (count - 1.0) - 0.5, rows * gravity_[n],
                      Eigen::Vector3d::Zero()};
      if (n > 0) point.came_from = signs_of_change(before, point.y);
      before = point.y;
      DwellRecord dwell;
      dwell.experiment = static_cast<int>(n) / plan_.steps + 1;
      dwell.n = static_cast<int>(n) % plan_.steps + 1;
      dwell.alpha = angle_of(static_cast<int>(n));
      set_commanded_angles(dwell);
      dwell.time_s = 10.0 * static_cast<double>(n);
      for (int j = 0; j < 3; ++j) {
        double reading =
            point.y(j) + offset(j) + plan_.noise * normal() + plan_.noise * plan_.process * wander(j);
        std::size_t at = 0;
        for (const ItemEffect& effect : item_effects()) {
          if (effect.in_motion) continue;
          for (int i = 0; i < effect.count; ++i)
            reading += effect.share(point, j, i).value * own[static_cast<std::size_t>(j)][at++];
        }
        dwell.mean(j) = unit(j) * reading;
        mean(j) += plan_.noise * plan_.process * wander(j) / count;
        wander(j) = kept * wander(j) + std::sqrt(1.0 - kept * kept) * normal();
      }
      dwell.u_mean = plan_.noise * unit;
      record.dwells.push_back(dwell);
    }
    // The mean of the noise over the run belongs to the offset.
    made.line.back().tail<3>() += mean.cwiseProduct(unit);
    return record;
  }

  TrayPlan plan_;
  std::mt19937_64 engine_;
  std::normal_distribution<double> normal_;
  std::vector<Eigen::Vector3d> gravity_;
};

inline MadeTray made_tray(const TrayPlan& plan, std::uint64_t seed) {
  return std::move(TrayMaker(plan, seed).made);
}

}  // namespace abcal::test
