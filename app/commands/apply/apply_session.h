#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "app/analysed_run/run_session.h"
#include "app/commands/apply/adjustment.h"
#include "app/commands/apply/adjustment_log.h"
#include "app/results/export/constants.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// The run whose result is written, and the instrument that receives it.
struct ApplyRequest {
  std::filesystem::path run;  ///< Complete run; its result is written.
  int item = 0;               ///< Number of the item, from 1; 0: the only one of the run.
  BenchConfig bench;          ///< Its [protocol] holds the plan of the verification.
  std::string bench_file;     ///< Its name, for messages.
  std::string estimator;      ///< Empty: the one that the run declares.
  ExportFrame frame = ExportFrame::kItem;
  /// Serial number on the label, as a person reads it; needed where the instrument reports none.
  std::string label;
  bool accept_doubtful = false;   ///< A person has read why the result is doubtful.
  bool dry_run = false;           ///< Only compute: write neither registers nor files.
  bool save = false;              ///< Let the instrument keep it when it is switched off.
  std::filesystem::path as_left;  ///< Run file of the verification.
};

/// Errors as found, registers before and after, and errors as left.
struct ApplyReport {
  int item = 1;  ///< Number of the item in the run.
  std::string driver, model, serial_number;
  CorrectionAbility ability;
  RegisterTexts in_force;  ///< During the run.
  RegisterTexts before;    ///< Just before writing.
  RegisterTexts after;
  std::string unit;  ///< Unit of the offsets.
  double unit_mps2 = 1.0;
  ResponseErrors as_found;
  ResponseErrors predicted;  ///< Errors with `after`, which has the shape and steps of the registers.
  std::optional<ResponseErrors> as_left;
  CalibrationResult found;
  std::optional<CalibrationResult> left;
  std::filesystem::path as_left_run;
  std::filesystem::path log;  ///< File with the data for undoing; empty: a dry run.
  AdjustmentState state = AdjustmentState::kBegun;
  std::string failure;       ///< The failure and the action taken; empty: none.
  bool interrupted = false;  ///< A person ended the verification.
};

/// Writes the constants of a run into the registers of its accelerometer, verifies them by a further run, and
/// brings the old content back if anything fails. Prints nothing.
class ApplySession {
 public:
  struct Options {
    /// Asks whether to write; empty: writes.
    std::function<bool(const ApplyReport& report)> confirm;
    /// Called at each change of the state, when it is stored.
    std::function<void(const Adjustment& adjustment)> progress;
  };

  /// `session` must outlive this; it opens the bench and measures the verification.
  ApplySession(RunSession& session, Options options);

  /// @throws InstrumentError, std::invalid_argument, std::runtime_error before anything is written. A later
  /// failure is in the report, with the state: the old content is restored, or could not be.
  ApplyReport apply(const ApplyRequest& request);

  /// Restores the register content from before the last adjustment with the constants of this run.
  /// @throws as apply(), and InstrumentError if that fails
  ApplyReport undo(const ApplyRequest& request);

 private:
  CalibrationResult find_result(const ApplyRequest& request, StoredRun& run) const;
  void open(const ApplyRequest& request, int item, const std::string& serial_number);
  const AccelerometerConfig& config_of(const BenchConfig& config) const;
  void require_same_item(const StoredRun& run, const ApplyRequest& request) const;
  void require_serial_number(const std::string& wanted, const std::string& on_label,
                             const std::string& given) const;
  ApplyReport compute(const ApplyRequest& request);
  void carry_out(const ApplyRequest& request, AdjustmentLog& log, ApplyReport& report);
  void verify(const ApplyRequest& request, ApplyReport& report);
  void write(const RegisterTexts& registers);
  void require_read_back(const RegisterTexts& wanted);
  void restore(const Adjustment& adjustment);
  void take_back(AdjustmentLog& log, Adjustment adjustment, ApplyReport& report);
  void store(AdjustmentLog& log, const Adjustment& adjustment, ApplyReport& report) const;
  Accelerometer& accelerometer() const;
  CorrectionRegisters& registers() const;

  RunSession& session_;
  Options options_;
  StartRequest start_;
  ItemIdentity item_;  ///< The instrument, as it is on the bench.
  CorrectionAbility ability_;
};

}  // namespace abcal
