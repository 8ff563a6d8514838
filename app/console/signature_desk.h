#pragma once

#include <deque>
#include <nlohmann/json.hpp>
#include <string>

#include "app/console/approval.h"
#include "app/console/download.h"
#include "app/console/persons.h"
#include "app/laboratory/issuing/issue_run.h"

namespace abcal::console {

/// Approval by key: the certificate is made here and signed where the approver's private key is, which is
/// never sent here. Keeps certificates that wait for their signature; after a restart they are prepared
/// again, with the same number. The person logged in is the approver. For one thread.
class SignatureDesk {
 public:
  explicit SignatureDesk(ApprovalPlace place) : place_(std::move(place)) {}

  /// Makes the certificate that is to be signed. @return its number, and its XML, for pages
  /// @throws StaleApproval, LoginRefused, std::invalid_argument (not permitted), those of prepare_to_sign()
  nlohmann::ordered_json prepare(const ApprovalForm& form, const Visitor& visitor, const Clock& clock);

  /// Issues the signed certificate. @return the certificate, for pages
  /// @throws as prepare(); StaleApproval if no certificate of this person waits; those of issue_signed()
  nlohmann::ordered_json take(const ItemOfRun& of, const std::string& signed_xml, const Visitor& visitor,
                              const Clock& clock);

 private:
  struct Waiting {
    ApprovalForm form;
    std::string person;
    AwaitedSignature awaited;
  };
  /// Opens the register as the visitor. @throws LoginRefused, std::invalid_argument (not permitted)
  Registered approver(const StoredRun& run, const Visitor& visitor, Clock::UtcTime now) const;

  ApprovalPlace place_;
  std::deque<Waiting> waiting_;
};

}  // namespace abcal::console
