#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// Registers by name, in the instrument's own words: as Accelerometer::correction_registers() gives them and
/// a run file keeps them.
using RegisterTexts = std::map<std::string, std::string>;

/// The correction that an instrument applies to its raw readings before it outputs them: output = matrix (raw
/// - offset), all in its output unit and along its own axes.
struct OutputCorrection {
  Eigen::Matrix3d matrix = Eigen::Matrix3d::Identity();
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
};

/// Which part of an OutputCorrection registers can hold.
enum class CorrectionShape {
  kOffset,    ///< The offset; the matrix does not change.
  kDiagonal,  ///< Offset, and a factor for each axis.
  kFull,      ///< Offset and full matrix.
};

/// Which corrections can be written into an instrument, and how it stores them.
struct CorrectionAbility {
  CorrectionShape shape = CorrectionShape::kOffset;
  std::string rule;          ///< The maker's own formula, with units: "output = C (a - B), ...".
  double offset_step = 0.0;  ///< Smallest change of the offset that the registers hold; output unit.
  double matrix_step = 0.0;  ///< Smallest change of an element of the matrix; 0 where the shape has none.
  /// Written values survive switching off, so nothing can be tried first.
  bool keeps_at_once = false;
  bool can_save = true;  ///< Can store the written values so that they survive switching off.
};

/// The registers of an accelerometer that correct its output and can be written. They are read with
/// Accelerometer::correction_registers(). Everything here, but for decode() and encode() of texts from a run
/// file, is to be asked after identify() and before start().
class CorrectionRegisters {
 public:
  virtual ~CorrectionRegisters() = default;

  /// @throws InstrumentError kRefused: this one has no register that could be written.
  virtual CorrectionAbility ability() = 0;

  /// Decodes the correction that registers with this content apply.
  /// @throws std::invalid_argument if one is missing, is not a number, or has an effect that is not an
  /// OutputCorrection
  virtual OutputCorrection decode(const RegisterTexts& registers) = 0;

  /// Encodes the register content nearest to `wanted`; parts that the registers cannot hold stay as in `now`.
  /// @throws std::invalid_argument if it is outside what the registers can hold
  virtual RegisterTexts encode(const OutputCorrection& wanted, const RegisterTexts& now) = 0;

  /// Whether it may be written now. @throws InstrumentError kRefused: a vehicle is armed.
  virtual void require_writable() {}

  /// Writes the registers that can be written; volatile unless it keeps them at once.
  /// @throws InstrumentError
  virtual void write(const RegisterTexts& registers) = 0;

  /// Stores the written registers, and nothing else that this program has set. The instrument is then in its
  /// stored state, with these registers. @param registers  as written
  /// @throws InstrumentError
  virtual void save(const RegisterTexts& registers) = 0;
};

/// The numbers in the text of one register, between commas or blanks; words of letters (a unit) after them
/// are skipped.
/// @throws std::invalid_argument if there is no such register, or if it does not have `count` numbers
std::vector<double> register_numbers(const RegisterTexts& registers, const std::string& name,
                                     std::size_t count);

/// One number. @throws std::invalid_argument
double register_number(const RegisterTexts& registers, const std::string& name);

}  // namespace abcal
