#pragma once

#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"

namespace abcal {

/// Standard uncertainties of everything that a stage and an item may do other than a perfect stage and a
/// linear item would (`[stage_uncertainty]` and `[item_uncertainty]` of a bench file; docs/theory). Every
/// estimator, the type B of ABC, Monte Carlo and the budget read the sizes of their effects here. A size of
/// zero leaves the effect out.
///
/// Defaults of the first four: the paper's stage, 0.008 degrees each (Geist & Gaitan 2021, section 1).
struct EffectSizes {
  // The stage.
  Angle alignment = Angle::degrees(0.008);     ///< Of Zx, Zy, Xz: N(0, sin alignment).
  Angle step = Angle::degrees(0.008);          ///< Of each rotation-step error f_i(n), without memory.
  Angle initial_turn = Angle::degrees(0.008);  ///< Of the initial -90 degree turns: d2, d3.
  Angle zero = Angle::degrees(0.008);          ///< Of the mean step errors F_X, F_Z (axis zeros).
  // The item.
  double drift = 1e-4;  ///< Of each order of the offset's drift over the run, relative to S_j.
  // The stage.
  Angle step_smooth = Angle::degrees(0.004);  ///< Of each coefficient of the smooth step errors, to 6/rev.
  double wobble_urad = 50.0;                  ///< Of each coefficient of the wobble, to 3/rev (urad).
  // The item.
  double sensitivity_drift = 1e-4;  ///< Of the sensitivity's change over the run, relative.
  double nonlinearity = 1e-4;       ///< Of k4, k5, |a| and cross terms, relative to S_j.
  double hysteresis = 1e-5;         ///< Relative to S_j.
  double k2 = 1e-2;                 ///< Of k2 S_j.
  double k3 = 1e-2;                 ///< Of k3 S_j^2.
  /// Of the angles between the item's axes about 90 degrees; 0: not stated. Only the norm estimator reads it,
  /// where fewer than nine poses were measured.
  Angle orthogonality = Angle::degrees(0.0);
  /// Of the instrument that reads the item's voltages (protocol/analysis/voltmeter.h); 0: not stated, or the
  /// item's outputs are numbers.
  double voltmeter_gain = 0.0;    ///< Relative; one for all three outputs.
  double voltmeter_offset = 0.0;  ///< Relative to S_j, for each output.
  /// Of each coefficient of an offset that comes and goes, 2 to 6 cycles over the run, relative to S_j; 0:
  /// not stated, and then not covered.
  double cyclic_drift = 0.0;

  /// Where each value comes from ("certificate 1234", "data sheet"), by its key (`wobble_urad`). A key that
  /// is absent was not stated: its size is the default, and results say so.
  std::map<std::string, std::string, std::less<>> sources = {};
};

/// `sizes` with every effect that the published protocol and section 5 of the theory do not know left out
/// (zero): smooth steps, wobble, sensitivity drift, higher non-linearity, hysteresis. For studies.
EffectSizes without_further_effects(EffectSizes sizes);

/// One size as data: what a bench file, a CSV file and a run file call it.
struct EffectSizeKey {
  std::string_view section;    ///< "stage_uncertainty", "item_uncertainty"
  std::string_view key;        ///< "wobble_urad"
  std::string_view unit;       ///< "degree", "urad", "1"
  double most = 0.0;           ///< Largest value that is accepted; the least is 0.
  std::string_view words;      ///< "wobble of the axes, each coefficient to 3/rev"
  bool was_tolerance = false;  ///< `[tolerances]` of bench/1 and `tolerances.KEY` of old files mean this.
  double (*get)(const EffectSizes&) = nullptr;
  void (*set)(EffectSizes&, double) = nullptr;
};

/// Every size, in the order in which files list them.
std::span<const EffectSizeKey> effect_size_keys();

/// Reads what `number` and `text` know under "SECTION.KEY" and "SECTION.KEY.source", and of a file of an
/// older version "tolerances.KEY"; what neither has keeps its default and has no source. A value without a
/// source has the source "stated", one whose source is "default" has none.
/// @param number  the value under a name, 0 to the largest value that is accepted (second argument)
void read_effect_sizes(const std::function<std::optional<double>(const std::string&, double)>& number,
                       const std::function<std::optional<std::string>(const std::string&)>& text,
                       EffectSizes& sizes);

/// What read_effect_sizes() reads: "SECTION.KEY" with its value (17 digits), and "SECTION.KEY.source". A
/// default is written too, with the source "default": a file keeps the sizes that were in force.
std::map<std::string, std::string> effect_size_entries(const EffectSizes& sizes);

/// Words of the effects whose size is a default that nobody stated, in the order of the table.
std::vector<std::string> unstated_effects(const EffectSizes& sizes);

}  // namespace abcal
