#pragma once

#include <optional>
#include <vector>

namespace abcal {

/// A sum of weighted squares, priors included, that is lowered step by step.
class SumOfSquares {
 public:
  SumOfSquares() = default;
  SumOfSquares(const SumOfSquares&) = delete;
  SumOfSquares& operator=(const SumOfSquares&) = delete;
  virtual ~SumOfSquares() = default;

  /// The sum at the present point; infinite or not a number where the model has no meaning.
  virtual double cost() = 0;
  /// Makes the model linear at the present point and solves the normal equations N x = b for the next step.
  /// @param damping  relative addition to the diagonal of N; 0: the step of Gauss and Newton
  /// @param anew     true: compute N; false: the matrix of the step before may be used again
  /// @return by how much the sum falls if the model is linear: b'x + damping x'diag(N)x; nullopt if N cannot
  /// be solved
  virtual std::optional<double> solve_step(double damping, bool anew) = 0;
  /// Moves by the step that was solved for.
  virtual void move() = 0;
  /// Returns to the point before the last move().
  virtual void move_back() = 0;
};

/// Damping of the next step (Levenberg and Marquardt), which follows from the success of earlier steps. The
/// rules are those of Madsen, Nielsen and Tingleff, "Methods for non-linear least squares problems" (2004),
/// section 3.2, which Ceres' LevenbergMarquardtStrategy uses as well; but damping starts only where a step
/// without it does not lower the cost.
class StepStrategy {
 public:
  /// Relative addition to the diagonal of the normal matrix; 0: none.
  double damping() const { return damping_; }
  /// Whether a step is to be taken.
  /// @param fall       decrease of the cost; not a number where the step leaves the model's domain
  /// @param predicted  the fall of the linear model, above 0
  static bool accepts(double fall, double predicted);
  /// To be called after a step that was taken.
  void was_taken(double fall, double predicted);
  /// To be called after a step that was not taken.
  void was_refused();
  /// A damped step is negligible. The next is not damped; if it is refused, too, no step is left.
  void try_undamped();
  bool tries_undamped() const { return tries_undamped_; }

 private:
  double damping_ = 0.0;
  bool tries_undamped_ = false;
  double growth_ = 2.0;
};

/// Where minimise() ended.
struct Minimum {
  bool found = false;
  int iterations = 0;  ///< Steps solved for, whether taken or not.
  int damped = 0;      ///< Those of them with damping.
  std::vector<double>
      costs;  ///< At the start and after each step that was taken: none is above the one before.
};

/// Takes steps that lower the cost until the next undamped one would lower it by less than 1e-8 (1e-4
/// standard uncertainties of all unknowns together); that one is solved for, with a matrix without damping,
/// and not taken. The minimum is found, too, where damped steps have become as small and the undamped one
/// raises the cost: a kink, as |a| has, with readings that contradict the model by far more than their
/// uncertainty.
Minimum minimise(SumOfSquares& problem);

}  // namespace abcal
