#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/certificate/decision.h"
#include "app/certificate/derived.h"
#include "app/certificate/laboratory_file.h"
#include "app/results/report_data.h"
#include "protocol/record/run_operator.h"

namespace abcal {

/// The certificate that this one takes the place of (ISO/IEC 17025 7.8.8).
struct Replacement {
  std::string number;
  std::string reason;
  std::string sha256;  ///< Of the replaced certificate's XML; empty: not at hand.
};

/// What issuing adds. Until then a certificate is a draft.
struct IssueFacts {
  std::string number;
  std::string measured_by;  ///< Empty: the operators of the run; else it must be one of them.
  std::string approved_by;
  Date date{};
  std::optional<Date> today;  ///< No date is after it. Absent: a certificate that was issued before.
  std::string
      register_identity;  ///< Of the register that gave the number; empty: none, names are stated only.
  bool training = false;  ///< By a training register: marked TRAINING, and lets simulated runs pass.
  std::optional<Replacement> replaces;
};

/// One calibration in a certificate, with what was derived and decided.
struct CertifiedRun {
  ReportData data;
  std::vector<DerivedGroup> derived;  ///< Empty where there is no result.
  std::vector<Decision> decisions;
  bool has_numbers() const { return data.result().verdict != Verdict::kNotUsable; }
};

/// Difference as left minus as found of a quantity that does not depend on the mounting.
struct Shift {
  std::string name;
  Quantity difference;  ///< Its uncertainty takes both runs as independent: an upper bound on one stage.
  double normalised_error = 0.0;  ///< E_n: difference / U of the difference.
};

/// All that a certificate says, before it has a form.
struct Certificate {
  std::string number;                     ///< "DRAFT-..." until issued.
  std::vector<std::string> reservations;  ///< What spoke against a certificate, and was let pass for a draft.
  LaboratoryFile laboratory;
  std::optional<IssueFacts> issue;
  std::optional<CertifiedRun> as_found;  ///< The item before it was adjusted.
  CertifiedRun run;                      ///< The calibration; as left where there is an as_found.
  std::vector<Shift> shifts;
  std::vector<RunOperator> operators;  ///< Who measured, as the events of the runs say.
  std::vector<std::string>
      not_traceable;  ///< Every reason why the results are not called traceable; empty: they are.
  std::string program_version;

  bool draft() const { return !issue; }
  bool training() const { return issue && issue->training; }
  /// Names of those who measured.
  std::string measured_by() const;
};

/// What a certificate is to be made of.
struct CertificateRequest {
  ReadLaboratoryFile laboratory;  ///< With its problems, to be told beside those of the run.
  ReportData run;
  std::optional<ReportData> as_found;
  std::optional<IssueFacts> issue;
  bool draft = false;  ///< Make a draft whatever speaks against the run or the equipment.
};

/// No certificate for this run: every reason.
class CertificateRefused : public std::runtime_error {
 public:
  CertificateRefused(const std::string& run, std::vector<Problem> problems);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// Gathers a certificate, or says everything that is missing or wrong, in the laboratory file and in the run
/// together, before anything is written. For a draft what is wrong with the run or the equipment's dates is
/// kept as a reservation; what is wrong with the laboratory file never is.
/// @throws LaboratoryFileError  with any problem of the laboratory file (problems of the run follow it)
/// @throws CertificateRefused   if only the run stands in the way, or its estimator gives no matrix
Certificate make_certificate(CertificateRequest request);

/// Name of the certificate until it is issued.
std::string draft_number(const ReportData& run);

}  // namespace abcal
