#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/laboratory/certificate/amendment.h"
#include "app/laboratory/certificate/decision.h"
#include "app/laboratory/certificate/derived.h"
#include "app/laboratory/certificate/laboratory_file.h"
#include "app/laboratory/certificate/reason.h"
#include "app/laboratory/certificate/registered_entry.h"
#include "app/laboratory/certificate/stated_result.h"
#include "app/laboratory/certificate/words.h"
#include "app/results/analysis/report_data.h"
#include "protocol/record/run_operator.h"
#include "protocol/temperature/temperature_fit.h"

namespace abcal {

/// The certificate that this one replaces (ISO/IEC 17025 7.8.8).
struct Replacement {
  std::string number;
  std::string reason;
  std::string sha256;  ///< SHA-256 of the XML of the replaced certificate; empty: not available.
  AmendmentKind kind = AmendmentKind::kTechnical;
  std::vector<ChangedStatement> changed = {};  ///< Against the replaced certificate.
};

/// Facts that issuing adds. Until then a certificate is a draft.
/// How a run was witnessed (docs/witness.md). Without `by` and `statement` the certificate says nothing of
/// it.
struct RunWitnessing {
  std::string by;          ///< Owner of the key that has signed each angle; empty: not all were signed.
  std::size_t angles = 0;  ///< Their number.
  std::string statement;   ///< Why the approver certifies a run that was not witnessed.
};

struct IssueFacts {
  std::string number;
  std::string measured_by;  ///< Empty: the operators of the run; else it must be one of them.
  std::string approved_by;
  Date date{};
  std::optional<Date> today;      ///< No date is after it. Absent: a certificate that was issued before.
  std::string register_identity;  ///< Register that gave the number; empty: none, names are stated only.
  RunWitnessing witnessing;
  bool training = false;                 ///< Training register: marked TRAINING, and accepts simulated runs.
  std::optional<RegisteredEntry> entry;  ///< Entry of the register that gave the number.
  std::optional<Replacement> replaces;
};

/// One calibration in a certificate, with derived quantities and decisions.
struct CertifiedRun {
  ReportData data;
  std::vector<ReportData> together;  ///< Its runs, if it is a measurement of several.
  /// Absent: no Monte Carlo of this kind of result, or no numbers.
  std::optional<CertifiedUncertainty> monte_carlo;
  StatedResult stated;  ///< As the certificate states it. Empty without numbers.
  std::vector<Decision> decisions;
  bool has_numbers() const { return data.result().verdict != Verdict::kNotUsable; }
};

/// Difference as left minus as found of a quantity that does not depend on the mounting; sensitivities per
/// m/s2.
struct Shift {
  std::string name;
  Quantity difference;  ///< Its uncertainty treats the runs as independent: an upper bound on one stage.
  double normalised_error = 0.0;  ///< E_n: difference / U of the difference.
};

/// A series over temperature of the item in a certificate.
struct CertifiedSeries {
  std::vector<ReportData> points;           ///< One run each, in the order of the series.
  std::optional<TemperatureResult> result;  ///< Absent in a draft whose runs make no series.
};

/// The content of a certificate, independent of its form.
struct Certificate {
  std::string number;                 ///< "DRAFT-..." until issued.
  std::vector<Message> reservations;  ///< Problems that a draft is allowed to have.
  LaboratoryFile laboratory;
  std::optional<IssueFacts> issue;
  std::optional<CertifiedRun> as_found;  ///< The item before it was adjusted.
  CertifiedRun run;                      ///< The calibration; as left if `as_found` is present.
  std::vector<Shift> shifts;
  std::optional<CertifiedSeries> series;  ///< Over temperature.
  std::vector<RunOperator> operators;     ///< Operators according to the events of the runs.
  /// Every reason why the results are not called traceable; empty: they are.
  std::vector<Message> not_traceable;
  std::string program_version;
  Words words;  ///< In the language of the laboratory file.

  bool draft() const { return !issue; }
  bool training() const { return issue && issue->training; }
  /// Names of the persons who measured.
  std::string measured_by() const;
};

/// The input of a certificate.
struct CertificateRequest {
  ReadLaboratoryFile laboratory;  ///< With its problems, reported together with those of the run.
  ReportData run;
  std::optional<ReportData> as_found;
  std::vector<ReportData> series;             ///< Points over temperature; empty: none.
  std::vector<ReportData> together;           ///< The runs of `run`, if it is a measurement of several.
  std::vector<ReportData> together_as_found;  ///< Those of `as_found`.
  std::optional<IssueFacts> issue;
  std::optional<CertifiedUncertainty> monte_carlo;  ///< That of `run`, as add_monte_carlo() makes it.
  std::optional<CertifiedUncertainty> monte_carlo_as_found;  ///< That of `as_found`.
  bool draft = false;  ///< Make a draft in spite of problems of the run or the equipment.
};

/// A certificate is refused, with every reason.
class CertificateRefused : public std::runtime_error {
 public:
  CertificateRefused(const std::string& run, std::vector<Problem> problems);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// Makes the Monte Carlo of the results that are to be certified, where there is one of their kind. The
/// certificate states its U where that is larger.
void add_monte_carlo(CertificateRequest& request);

/// Gathers a certificate, or reports every problem of the laboratory file and of the run together, before
/// anything is written. For a draft, problems of the run and of the equipment's dates become reservations;
/// problems of the laboratory file never do.
/// @throws LaboratoryFileError  with any problem of the laboratory file (problems of the run follow it)
/// @throws CertificateRefused   if only the run has problems, or its estimator gives no matrix
Certificate make_certificate(CertificateRequest request);

/// Every run of a certificate: as found, points over temperature, the runs of measurements, and at the end
/// the calibration.
std::vector<const ReportData*> runs_of(const Certificate& certificate);

/// The runs that one of its results is of: those of a measurement, or the one run.
/// @param together  the runs of the measurement
std::vector<const ReportData*> runs_of_result(const std::vector<ReportData>& together,
                                              const ReportData& data);

/// From the first start to the last end of runs, UTC; empty if not known.
std::pair<std::string, std::string> period_of(const std::vector<const ReportData*>& runs);

/// Name of the certificate until it is issued.
std::string draft_number(const ReportData& run);

}  // namespace abcal
