#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"

namespace abcal {

using Vector12 = Eigen::Matrix<double, 12, 1>;
using Rows12 = Eigen::Matrix<double, 12, Eigen::Dynamic>;

/// Columns of the unknowns of an effect_fit(): output u (s, O, its effects), v, w, then the stage, then step
/// errors that several readings share, then errors of the angles of each sweep.
struct EffectLayout {
  struct StageUnknown {
    const StageEffect* effect;
    int index;
  };
  struct OwnUnknown {
    const ItemEffect* effect;
    int index;
  };
  static constexpr int kOwnFixed = 4;  ///< s_jx, s_jy, s_jz, O_j are the first of an output's own unknowns.

  std::vector<OwnUnknown> own;
  std::vector<StageUnknown> stage;
  int maps = 0;
  int sweeps = 0;
  int own_count() const { return kOwnFixed + static_cast<int>(own.size()); }
  int first_stage() const { return 3 * own_count(); }
  int first_map() const { return first_stage() + static_cast<int>(stage.size()); }
  int first_sweep() const { return first_map() + maps; }
  int count() const { return first_sweep() + kSweepUnknowns * sweeps; }
};

/// The line response of an item, s row by row and O: relative units.
/// @param value  of the outputs' own unknowns, in the order of the layout; further ones are not read
Vector12 line_values(const EffectLayout& layout, const Eigen::VectorXd& value);
/// Its derivatives by the unknowns (12 x layout.count()).
Rows12 line_rows(const EffectLayout& layout, const Eigen::VectorXd& value);

/// The model of an effect_fit(): the readings and their derivatives at one point. Relative units: quantities
/// of an output are divided by its S_j.
class EffectModel {
 public:
  /// The model at the linear solution on a perfect stage.
  /// @throws as effect_fit()
  EffectModel(std::span<const EffectReading> readings, const EffectFitOptions& options);

  std::size_t angles() const { return readings_.size(); }
  const EffectFitOptions& options() const { return options_; }
  const EffectLayout& layout() const { return layout_; }
  const std::vector<EffectUnknown>& unknowns() const { return unknowns_; }
  const Eigen::Vector3d& unit() const { return unit_; }  ///< S_j (R).
  const Eigen::VectorXd& value() const { return value_; }
  const Eigen::VectorXd& prior_weight() const { return prior_weight_; }
  Eigen::VectorXd from_prior() const { return value_ - prior_mean_; }
  double step_sd() const { return step_sd_; }  ///< Standard deviation of the eliminated step errors; 0: none.
  const std::vector<double>& steps() const {
    return step_;
  }  ///< Eliminated step error of each reading (radian).
  /// Moves to another point.
  /// @param steps  eliminated step error of each reading (radian)
  void move_to(const Eigen::VectorXd& value, std::vector<double> steps);
  /// Moves to the point of another model of the same item, with other readings or fewer effects. Effects that
  /// `other` lacks are zero.
  void move_to(const EffectModel& other, std::vector<double> steps);
  /// False: a stage axis is inclined more than is possible, so that the point is not a solution.
  bool is_plausible() const;
  const ReadingRows& jacobian() const { return jacobian_; }
  /// 3 N: reading - model, with the eliminated step errors not in the model.
  const Eigen::VectorXd& residual() const { return residual_; }
  /// 3 N: reading - model, with the eliminated step errors in the model.
  Eigen::VectorXd misfit() const;
  /// Gravity at an angle on the stage as it is at this point.
  GravityAt gravity(std::size_t n) const { return gravity_at(poses_[n], inputs_at(n)); }
  /// Relative rows of s, for u, v, w.
  Eigen::Matrix3d rows() const { return rows_of(value_); }
  /// Derivatives of the three readings of an angle by the eliminated step error of its own, which is
  /// step_factor() times the unknown.
  const Eigen::Vector3d& by_step(std::size_t n) const { return by_step_[n]; }
  /// The same by the step error itself.
  Eigen::Vector3d by_own_step(std::size_t n) const { return by_step_[n] / step_factor(n); }
  /// Number of the shared step error of a reading; -1: none.
  int map_of(std::size_t n) const { return layout_.maps > 0 ? readings_[n].map : -1; }
  int experiment_of(std::size_t n) const { return readings_[n].experiment; }
  double step_factor(std::size_t n) const { return readings_[n].step_factor; }

  /// Noise of the readings, with what the signs of the hysteresis leave unknown.
  /// @param white  standard deviations of the outputs' white noise, over the u given
  std::vector<NoiseAtAngle> noise_at_angles(const Eigen::Vector3d& white) const;
  /// The same without the signs.
  std::vector<NoiseAtAngle> stated_noise_at_angles(const Eigen::Vector3d& white) const;
  /// @param tau  in units of each output's median u
  NoiseProcess process_of(double tau, double rho) const;
  /// Least white noise over the u given that is not round-off.
  Eigen::Vector3d least_white() const;

  /// Derivatives of the line response by the unknowns (12 x unknowns), and its value.
  Rows12 line_rows() const { return abcal::line_rows(layout_, value_); }
  Vector12 line_values() const { return abcal::line_values(layout_, value_); }
  /// Line response at another value of the unknowns.
  Vector12 line_values_at(const Eigen::VectorXd& value) const { return abcal::line_values(layout_, value); }

  const HysteresisSigns& signs() const { return signs_; }
  /// Takes the signs of the responses at this point.
  /// @param covariance_root  R of the covariance R R' of the unknowns
  /// @return false: nothing changed, because they are nearly the same, no hysteresis is fitted, or the
  /// options
  ///         state the signs
  bool take_signs(const Eigen::MatrixXd& covariance_root);
  /// The mean signs (HysteresisSigns) at another point whose responses are known as well as where the signs
  /// were taken. Before, and without hysteresis: those of the stated sizes.
  std::vector<Eigen::Vector3d> mean_signs_at(const Eigen::VectorXd& value,
                                             const std::vector<double>& steps) const;
  /// Numbers of the unknowns of the hysteresis of u, v, w; empty: it is not fitted.
  std::vector<Eigen::Index> hysteresis_unknowns() const;
  /// The signs of the responses themselves at another point.
  /// @param steps  eliminated step error of each reading (radian)
  std::vector<Eigen::Vector3d> came_from_at(const Eigen::VectorXd& value, const std::vector<double>& steps,
                                            SignRule rule) const;
  /// Readings of the model at another point, without derivatives (3 N).
  /// @param came_from  signs for the hysteresis, or their means
  Eigen::VectorXd readings_at(const Eigen::VectorXd& value, const std::vector<double>& steps,
                              const std::vector<Eigen::Vector3d>& came_from) const;

  /// Derivatives of the readings by the unknowns of the effects that are stated as zero: one column for each
  /// of these unknowns, which are appended to `unknowns`.
  ReadingRows left_out_columns(std::vector<EffectUnknown>& unknowns) const;

 private:
  /// The model at one angle.
  struct At {
    Eigen::Vector3d reading;
    Eigen::Vector3d by_step;
  };
  void check_readings() const;
  void choose_unknowns();
  void list_unknowns();
  EffectUnknown stage_unknown(const StageEffect& effect, int index) const;
  bool is_in_run(const StageEffect& effect) const;
  /// Whether the stage turns at any of the readings.
  bool in_motion() const { return !options_.sweeps.empty(); }
  void list_sweeps();
  void list_input_terms();
  void list_bending();
  /// By how much one half of the drift of an output's sensitivity has changed it at a time of the run. Which
  /// half is before what bends the response (the element's) and which after it (the electronics') is not
  /// known.
  double half_gain(double t, int output, const Eigen::VectorXd& value) const;
  double bend_at(const ItemPoint& point, int output, const Eigen::VectorXd& value) const;
  ItemPoint placed_point(const ItemPoint& point, const Eigen::VectorXd& value) const;
  ItemPoint bent_point(const ItemPoint& point, const Eigen::VectorXd& value) const;
  ItemPoint point_at(std::size_t n, const StagePose& pose, const Eigen::Matrix3d& rows,
                     const GravityAt& gravity, const StageInputs& inputs) const;
  const std::optional<MeasuredValue>* measured(std::string_view effect) const;
  void start_from_linear_fit();
  void find_signs();
  /// Linear responses of the item at a value of the unknowns, at the stage's positions on its way.
  ArrivalSigns::Responses responses_at(const Eigen::VectorXd& value) const;
  StageInputs inputs_on_the_way(const StagePose& pose, const Eigen::VectorXd& value) const;
  /// Derivatives of the responses of u, v, w at a pose: of first order, at this point.
  struct ResponsesAt {
    Eigen::Vector3d g = Eigen::Vector3d::Zero();  ///< By the s of the output.
    Eigen::Matrix3Xd by_stage;                    ///< By the unknowns of the stage (columns).
    Eigen::Vector3d by_step = Eigen::Vector3d::Zero();
  };
  ResponsesAt responses_by_unknowns(const StagePose& pose) const;
  void take_uncertainties_of_arrival(const Eigen::MatrixXd& covariance_root);
  void use_signs(std::vector<Eigen::Vector3d> mean, const Eigen::MatrixXd& covariance_root);
  /// In a sweep, the two neighbours of reading `n`; the change of the response between them gives the slope
  /// at its own angle. Both are equal if there is no change, as with a stage at rest.
  std::pair<std::size_t, std::size_t> change_of(std::size_t n) const;
  /// Relative linear responses of u, v, w (columns: the readings).
  Eigen::Matrix3Xd linear_responses_at(const Eigen::VectorXd& value, const std::vector<double>& steps) const;
  /// How far the slope varies within the step of each reading of a sweep (3 N): the sign of the slope is the
  /// mean over the step. The slope at either end of the step is the change of change_of() plus or minus this.
  Eigen::VectorXd bends_at(const Eigen::VectorXd& value, const std::vector<double>& steps) const;
  /// Changes of the relative responses of u, v, w between the readings of change_of() (3 N).
  Eigen::VectorXd changes_at(const Eigen::VectorXd& value, const std::vector<double>& steps) const;
  /// Their derivatives by the unknowns at this point, of first order, without the small slopes of the item's
  /// effects.
  ReadingRows changes_by_unknowns() const;
  Eigen::Matrix3d rows_of(const Eigen::VectorXd& value) const;
  /// The pose of a reading with the rate and the acceleration that the errors of its sweep's angles give it.
  StagePose pose_at(std::size_t n, const Eigen::VectorXd& value) const;
  /// Derivatives of the readings by that rate and that acceleration: those of the elements' places.
  struct ByMotion {
    Eigen::Vector3d rate = Eigen::Vector3d::Zero();
    Eigen::Vector3d acceleration = Eigen::Vector3d::Zero();
  };
  ByMotion by_motion(const StagePose& pose, const Eigen::Matrix3d& rows) const;
  StageInputs inputs_at(std::size_t n) const { return inputs_at(n, value_, step_); }
  StageInputs inputs_at(std::size_t n, const Eigen::VectorXd& value, const std::vector<double>& steps) const;
  /// The model at all angles, and the Jacobian (3 N x unknowns).
  void evaluate();
  At evaluate_at(std::size_t n, const Eigen::Matrix3d& rows);

  std::span<const EffectReading> readings_;
  EffectFitOptions options_;
  EffectLayout layout_;
  std::vector<EffectUnknown> unknowns_;
  std::vector<StagePose> poses_;
  int axes_distance_ = -1;          ///< Number of this unknown among those of the stage; -1: none.
  std::vector<StageShare> shares_;  ///< Shares of the stage unknowns in reading 0, in reading 1, ...
  /// A share that is not zero, of an unknown that no motion changes.
  struct InputTerm {
    int input, unknown;
    double value;
  };
  std::vector<InputTerm>
      input_terms_;  ///< Those of reading 0, of reading 1, ..., each in the order of inputs.
  std::vector<std::size_t> first_term_{0};  ///< One for each reading, and one for the end.
  std::vector<std::size_t> bending_;        ///< Numbers in layout_.own.
  std::vector<char> bends_;                 ///< For each of layout_.own: whether it is one of bending_.
  int sensitivity_drift_ = -1;              ///< Number in layout_.own; -1: it is not fitted.
  std::vector<SweepShares> sweep_shares_;   ///< For each reading, in motion.
  Eigen::Vector3d unit_;
  Eigen::Vector3d usual_u_;  ///< Median of the readings' u, relative.
  HysteresisSigns signs_;
  ArrivalSigns arrival_signs_;  ///< Those of the readings at rest.
  Eigen::VectorXd u_change_;  ///< Standard uncertainties of the changes in sweeps where the signs were taken
                              ///< (3 N); or empty.
  Eigen::VectorXd prior_weight_, prior_mean_;
  double step_sd_ = 0.0;

  Eigen::VectorXd value_;
  std::vector<double> step_;  ///< f of each reading.
  ReadingRows jacobian_;
  Eigen::VectorXd residual_;
  std::vector<Eigen::Vector3d> by_step_;
};

}  // namespace abcal
