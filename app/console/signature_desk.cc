#include "app/console/signature_desk.h"

#include <algorithm>
#include <utility>

namespace abcal::console {
namespace {

/// Most certificates that wait, more than a full platter has; the oldest is dropped and can be made again.
constexpr std::size_t kMostWaiting = 40;

bool is_same(const ItemOfRun& a, const ItemOfRun& b) {
  return a.run == b.run && a.item == b.item;
}

}  // namespace

Registered SignatureDesk::approver(const StoredRun& run, const Visitor& visitor, Clock::UtcTime now) const {
  lab::Register opened = lab::Register::open(place_.register_location, now);
  std::optional<lab::LoggedIn> who;
  try {
    who = opened.who(visitor.login, now);
  } catch (const lab::RegisterError& refused) {
    (void)opened.find_person({});  // Throws if the register is lost.
    throw LoginRefused(refused.what());
  }
  if (const auto why = why_not_approve(who->person(), run)) throw Telling<std::invalid_argument>(*why);
  return {std::move(opened), *std::move(who)};
}

nlohmann::ordered_json SignatureDesk::prepare(const ApprovalForm& form, const Visitor& visitor,
                                              const Clock& clock) {
  const StoredRun stored = require_approvable(form, place_);
  Registered registered = approver(stored, visitor, clock.utc_now());
  Waiting waits{form, registered.approver.name(),
                prepare_to_sign(issue_asked(form, place_), registered, clock)};
  std::erase_if(waiting_, [&](const Waiting& each) { return is_same(each.form.of, form.of); });
  if (waiting_.size() >= kMostWaiting) waiting_.pop_front();
  const IssuedCertificate& made = waits.awaited.prepared.issued;
  nlohmann::ordered_json json{{"number", made.number}, {"xml", made.xml}};
  waiting_.push_back(std::move(waits));
  return json;
}

nlohmann::ordered_json SignatureDesk::take(const ItemOfRun& of, const std::string& signed_xml,
                                           const Visitor& visitor, const Clock& clock) {
  const auto found = std::find_if(waiting_.begin(), waiting_.end(), [&](const Waiting& each) {
    return is_same(each.form.of, of) && each.person == visitor.who.name;
  });
  if (found == waiting_.end())
    throw StaleApproval(Message(
        "no certificate of this item waits for your signature; make the one that is to be signed again"));
  const StoredRun stored = require_approvable(found->form, place_);
  Registered registered = approver(stored, visitor, clock.utc_now());
  const IssueOutcome outcome = issue_signed(found->awaited, signed_xml, registered, clock);
  waiting_.erase(found);
  return issued_json(outcome, registered.approver.name(), outcome.training);
}

}  // namespace abcal::console
