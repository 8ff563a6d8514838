#pragma once

#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"
#include "drivers/text/message.h"

namespace abcal {

/// Shape of the distribution that a standard uncertainty was stated with.
enum class Shape {
  kNormal,
  kRectangular,  ///< Between limits; nothing else is known.
  kTriangular,   ///< Between limits; values near the middle are more likely.
  kUShaped,      ///< A sine of known amplitude at an unknown phase.
};

/// "normal", "rectangular", "triangular", "u-shaped": as bench files and budgets write them.
std::string_view to_string(Shape shape);
/// The shape of a name; absent for any other text.
std::optional<Shape> shape_named(std::string_view name);

/// Standard uncertainties of everything that a stage and an item may do other than a perfect stage and a
/// linear item would (`[stage_uncertainty]` and `[item_uncertainty]` of a bench file; docs/theory). Every
/// estimator, the type B of ABC, Monte Carlo and the budget read the sizes of their effects here. A size of
/// zero leaves the effect out.
///
/// Defaults of the first four: the paper's stage, 0.008 degrees each (Geist & Gaitan 2021, section 1).
struct EffectSizes {
  // The stage.
  Angle alignment = Angle::degrees(0.008);     ///< Zx, Zy, Xz: N(0, sin alignment).
  Angle step = Angle::degrees(0.008);          ///< Each rotation-step error f_i(n), without memory.
  Angle initial_turn = Angle::degrees(0.008);  ///< The initial -90 degree turns: d2, d3.
  Angle zero = Angle::degrees(0.008);          ///< The mean step errors F_X, F_Z (axis zeros).
  // The item.
  double drift = 1e-4;  ///< Each order of the offset's drift over the run, relative to S_j.
  // The stage.
  Angle step_smooth = Angle::degrees(0.004);  ///< Each coefficient of the smooth step errors, to 6/rev.
  double wobble_urad = 50.0;                  ///< Each coefficient of the wobble, to 3/rev (urad).
  // The item.
  double sensitivity_drift = 1e-4;  ///< Change of the sensitivity over the run, relative.
  double nonlinearity = 1e-4;       ///< k4, k5, |a| and cross terms, relative to S_j.
  double hysteresis = 1e-5;         ///< Relative to S_j.
  double k2 = 1e-2;                 ///< Size of k2 S_j.
  double k3 = 1e-2;                 ///< Size of k3 S_j^2.
  /// Deviations of the angles between the item's axes from 90 degrees; 0: not stated. Used only by the norm
  /// estimator, if fewer than nine poses were measured.
  Angle orthogonality = Angle::degrees(0.0);
  /// The instrument that reads the item's voltages (protocol/estimators/shared/voltmeter.h); 0: not stated,
  /// or the item's outputs are numbers.
  double voltmeter_gain = 0.0;    ///< Relative; one for all three outputs.
  double voltmeter_offset = 0.0;  ///< Relative to S_j, for each output.
  /// Each coefficient of a cyclic drift of the offset, 2 to 6 cycles over the run, relative to S_j; 0: not
  /// stated, and then not covered.
  double cyclic_drift = 0.0;
  /// Change of the offset (relative to S_j) and of each element of s (likewise) from one run of a measurement
  /// to another; 0: not stated, and then taken for none.
  double drift_between_runs = 0.0;
  /// Sine and cosine of a step error with one period a turn, as of an eccentric encoder ring, in addition to
  /// the smooth step errors; 0: not stated.
  Angle step_eccentric = Angle::degrees(0.0);

  // For a run at a constant rate (docs/constant_rate.md); 0 in all others. Relative sizes are those at a rate
  // of 60 degrees/s.
  double delay_s = 0.0;             ///< Delay of the item less that of the encoder of an axis.
  double axes_distance_mm = 0.0;    ///< Distance between the axes of the stage.
  Angle sweep = Angle{};            ///< Error of the angles common to one sweep.
  double delay_difference_s = 0.0;  ///< Delay of an output less that of the item.
  double low_pass = 0.0;            ///< Loss of amplitude; it grows with the square of the rate.
  double low_pass_fourth = 0.0;     ///< Loss of amplitude that grows with the fourth power of the rate.
  double phase_rad = 0.0;           ///< Phase beyond a delay; it grows with the cube of the rate.
  double rate_offset = 0.0;         ///< Offset that grows with the rate, relative to S_j.
  double position_mm = 0.0;         ///< Each coordinate of the apparent position of an output's element.

  /// Where each value comes from ("certificate 1234", "data sheet"), by its key (`wobble_urad`). A key that
  /// is absent was not stated: its size is the default, which results report.
  std::map<std::string, std::string, std::less<>> sources = {};

  /// Shapes other than the normal distribution, by the same keys.
  std::map<std::string, Shape, std::less<>> shapes = {};
  /// The shape that a size was stated with; one without an entry is normal.
  Shape shape_of(std::string_view key) const;

  bool operator==(const EffectSizes&) const = default;
};

/// `sizes` with the defaults of the effects that only a run at a constant rate has, unless they are stated.
EffectSizes with_effects_of_motion(EffectSizes sizes);

/// `sizes` with every effect that EffectSizeKey::is_further marks left out (zero). For studies.
EffectSizes without_further_effects(EffectSizes sizes);

/// Names and properties of one size in a bench file, a CSV file and a run file. The table of them is the only
/// list of sizes; the default of a size is that of its member of EffectSizes.
struct EffectSizeKey {
  std::string_view section;  ///< "stage_uncertainty", "item_uncertainty"
  std::string_view key;      ///< "wobble_urad"
  std::string_view unit;     ///< "degree", "urad", "1"
  double most = 0.0;         ///< Largest value that is accepted; the least is 0.
  /// The effect in words, for results and for the reference of keys: "wobble of the axes, each coefficient to
  /// 3/rev".
  Term words;
  bool was_tolerance = false;  ///< `[tolerances]` of bench/1 and `tolerances.KEY` of old files mean this.
  bool is_further = false;  ///< Neither the published protocol nor section 5 of the theory knows the effect.
  /// The effect in words where its default is zero although benches usually have it: results state that it is
  /// not covered unless its size is stated. Empty: a size of zero is not mentioned.
  Term uncovered{""};
  /// Default in a run at a constant rate, of an effect that no other run has; 0: every run has it. Such an
  /// effect is not a further one: without it, a run at a constant rate has no meaning.
  double in_motion = 0.0;
  bool between_runs = false;  ///< Only a measurement of several runs has this effect.
  double (*get)(const EffectSizes&) = nullptr;
  void (*set)(EffectSizes&, double) = nullptr;
};

/// Whether a file has no entry for a size, as for an effect of motion in a run with a stage at rest, or for
/// one between runs that is not stated.
bool is_without_entry(const EffectSizeKey& key, const EffectSizes& sizes);

/// Every size, in the order in which files list them.
std::span<const EffectSizeKey> effect_size_keys();

/// Reads the sizes from the entries "SECTION.KEY", "SECTION.KEY.source" and "SECTION.KEY.distribution"
/// (absent: normal), and "tolerances.KEY" in a file of an older version. A size without an entry keeps its
/// default and has no source. A value without a source has the source "stated"; one whose source is "default"
/// has none.
/// @param number  the value under a name, 0 to the largest value that is accepted (second argument)
void read_effect_sizes(const std::function<std::optional<double>(const std::string&, double)>& number,
                       const std::function<std::optional<std::string>(const std::string&)>& text,
                       EffectSizes& sizes);

/// Entries for read_effect_sizes(): "SECTION.KEY" with its value (17 digits), "SECTION.KEY.source", and
/// "SECTION.KEY.distribution" where it is not normal. A default is written too, with the source "default": a
/// file keeps the sizes that were in force.
std::map<std::string, std::string> effect_size_entries(const EffectSizes& sizes);

/// Words of the effects whose size is a default because none was stated, in the order of the table.
std::vector<Term> unstated_effects(const EffectSizes& sizes);

}  // namespace abcal
