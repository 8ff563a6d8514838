#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/certificate/report_certificate.h"
#include "app/laboratory/register/register.h"
#include "drivers/instrument/clock.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// Request to issue a certificate. The meaning of an empty entry is given for each.
struct IssueAsked {
  std::string run;               ///< Path of the run file.
  int item = 0;                  ///< With several items: the item, from 1; 0: the run has one.
  std::string number;            ///< Required without a register; unused with one, which gives it.
  std::string measured_by;       ///< Empty: the operators according to the events of the run.
  std::string approved_by;       ///< Required without a register; unused with one.
  std::string date;              ///< "2026-03-01"; empty: today, UTC.
  std::string replaces, reason;  ///< The certificate that this one amends, and why; empty: none.
  std::string amendment;         ///< "administrative" or "technical"; empty: `replaces` is empty.
  /// XML file of the replaced certificate if it is of another run; empty: it is kept with this run.
  std::string replaced_xml;
  /// Called before the number is taken with every statement that an amendment changes; empty: not called.
  std::function<void(const std::vector<ChangedStatement>&)> tell_changes;
  /// Statement of the approver for a run that was not witnessed although the register requires it: why it is
  /// certified nevertheless. Printed on the certificate. Empty: such a run is refused.
  std::string not_witnessed;
  std::string key, key_certificate;  ///< PEM files of the approver; empty: not signed.
  CertificateFiles certificate;
};

/// The register that gives the number, and the approver.
struct Registered {
  lab::Register opened;
  lab::LoggedIn approver;
  lab::HeadWitness witness = {};  ///< Signs the heads of the register's audit; empty: head_witness().
};

struct IssueOutcome {
  /// Number of a certificate that was stored with the run before and is now registered; nothing was issued.
  std::string known_now;  ///< Empty: a certificate was issued.
  IssuedCertificate issued;
  bool training = false, is_signed = false, verified = false;
  std::string operators;  ///< Operators in words.
  std::vector<std::string> warnings;
};

/// Issues the certificate of a complete run: checks it, takes its number from the register, keeps it with the
/// run, and registers it. Every issue, from the command line or the console, uses this function.
/// @param registered  null: no register
/// @param clock  gives the date of issue; an entry of the register has the time at which it is written
/// @throws as make_certificate(), issue_certificate(); lab::RegisterError; std::invalid_argument;
/// std::runtime_error with all that judge_run() finds against the run
IssueOutcome issue_run(const IssueAsked& asked, Registered* registered, const Clock& clock);

/// A certificate that has its number, and waits for the signature of its approver, which is made elsewhere.
struct AwaitedSignature {
  PreparedCertificate prepared;
  CertificateFiles files;
  bool training = false;
  std::vector<std::string> warnings;
};

/// The first half of issue_run(): everything before the signature, so that the approver's private key need
/// not be on this computer. If nothing follows, the next certificate of the run has the same number.
/// @throws as issue_run()
AwaitedSignature prepare_to_sign(const IssueAsked& asked, Registered& registered, const Clock& clock);

/// The second half. @param signed_xml  the XML that was prepared, with its signature by a valid key of the
/// approver that the register knows
/// @throws as issue_run(); std::invalid_argument for another signature: nothing is issued then
IssueOutcome issue_signed(const AwaitedSignature& awaited, const std::string& signed_xml,
                          Registered& registered, const Clock& clock);

/// Whether the approver may approve: has the right, and is not an operator of the run.
/// @return the reason why not, in words; absent: may approve
std::optional<Message> why_not_approve(const lab::Person& approver, const StoredRun& run);

}  // namespace abcal
