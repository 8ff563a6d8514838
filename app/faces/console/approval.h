#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "app/faces/console/download.h"
#include "app/faces/console/persons.h"
#include "app/laboratory/issuing/issue_run.h"
#include "drivers/instrument/clock.h"

namespace abcal::console {

/// Where certificates come from.
struct ApprovalPlace {
  std::string register_location;          ///< Empty: there is none.
  std::filesystem::path laboratory_file;  ///< Empty: none was given.
};

/// What a person fills in to approve a certificate.
struct ApprovalForm {
  ItemOfRun of;                    ///< Item 0: the run has one.
  std::string run_sha256;          ///< Of the run that the person looked at.
  std::string approver, password;  ///< As they log in.
  std::string replaces, reason;    ///< Empty: it replaces none.
};

/// The run has changed since, or another certificate was issued meanwhile. what() says so.
class StaleApproval : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// What stands before the approval of an item of a run: the hash of the run, who measured it, the
/// certificates of the item, and why none can be issued here ("why_not"), and the keys of whoever looks.
/// Reads the run and opens the register.
/// @param of  item 0: the run has one
nlohmann::ordered_json approval_json(const ItemOfRun& of, const ApprovalPlace& place, const Visitor& visitor,
                                     Clock::UtcTime now);

/// Refuses what nobody can approve here, and what is older than the run or its last certificate.
/// @return the run
/// @throws StaleApproval, std::invalid_argument, RunFileError
StoredRun require_approvable(const ApprovalForm& form, const ApprovalPlace& place);

/// What issue_run() is asked for by a form.
IssueAsked issue_asked(const ApprovalForm& form, const ApprovalPlace& place);

/// A certificate that was issued, for pages.
nlohmann::ordered_json issued_json(const IssueOutcome& outcome, const std::string& approver, bool training);

/// Approves and issues, as `abcal issue` does. The approver proves with their password who they are.
/// @return the certificate, for pages
/// @throws LoginRefused (name or password), StaleApproval, what issue_run() throws
nlohmann::ordered_json approve(const ApprovalForm& form, const ApprovalPlace& place, Clock::UtcTime now);

}  // namespace abcal::console
