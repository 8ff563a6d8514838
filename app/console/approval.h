#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "app/console/download.h"
#include "app/console/persons.h"
#include "app/laboratory/issuing/issue_run.h"
#include "drivers/instrument/clock.h"

namespace abcal::console {

/// The register and the laboratory file that certificates are issued from.
struct ApprovalPlace {
  std::string register_location;          ///< Empty: no register.
  std::filesystem::path laboratory_file;  ///< Empty: none was given.
};

/// The form that a person fills in to approve a certificate.
struct ApprovalForm {
  ItemOfRun of;                    ///< Item 0: the run has one item.
  std::string run_sha256;          ///< SHA-256 of the run that the person saw.
  std::string approver, password;  ///< As used to log in.
  std::string replaces, reason;    ///< Number of the replaced certificate, and why; empty: none.
  std::string amendment;           ///< "administrative" or "technical"; empty: none.
};

/// The run has changed since the form was opened, or another certificate was issued; what() states which.
class StaleApproval : public Telling<std::runtime_error> {
 public:
  using Telling::Telling;
};

/// The data shown before an item of a run is approved: the hash of the run, its operators, the certificates
/// of the item, why none can be issued here ("why_not"), and the keys of the visitor. Reads the run and
/// opens the register.
/// @param of  item 0: the run has one item
nlohmann::ordered_json approval_json(const ItemOfRun& of, const ApprovalPlace& place, const Visitor& visitor,
                                     Clock::UtcTime now);

/// Refuses a form that nobody can approve here, or that is older than the run or its last certificate.
/// @return the run
/// @throws StaleApproval, std::invalid_argument, RunFileError
StoredRun require_approvable(const ApprovalForm& form, const ApprovalPlace& place);

/// The request to issue_run() that a form makes.
IssueAsked issue_asked(const ApprovalForm& form, const ApprovalPlace& place);

/// An issued certificate as JSON for pages.
nlohmann::ordered_json issued_json(const IssueOutcome& outcome, const std::string& approver, bool training);

/// Approves and issues, as `abcal issue` does. The approver proves with their password who they are.
/// @return the certificate, for pages
/// @throws LoginRefused (name or password), StaleApproval, and the exceptions of issue_run()
nlohmann::ordered_json approve(const ApprovalForm& form, const ApprovalPlace& place, const Clock& clock);

}  // namespace abcal::console
