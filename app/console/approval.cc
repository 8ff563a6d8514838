#include "app/console/approval.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "app/formats/xml_query.h"
#include "app/laboratory/issuing/issue_run.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_operator.h"
#include "protocol/record/sha256.h"

namespace abcal::console {
namespace {

using ApprovalJson = nlohmann::ordered_json;

/// The certificates of an item, with their status in the register, if there is one that can be read.
ApprovalJson certificates_of(const ItemOfRun& of, const ApprovalPlace& place, Clock::UtcTime now) {
  ApprovalJson list = ApprovalJson::array();
  const std::vector<IssuedCertificate> kept = ResultsFile::certificates(of.run, of.item);
  if (kept.empty()) return list;
  std::optional<lab::Register> opened;
  if (!place.register_location.empty()) opened = lab::Register::open(place.register_location, now);
  for (const IssuedCertificate& issued : kept) {
    const auto status = opened ? opened->status_of(issued.number) : std::nullopt;
    const Message words = status ? status->words() : Message();
    list.push_back({{"number", issued.number},
                    {"date", issued.date},
                    {"measured_by", issued.measured_by},
                    {"approved_by", issued.approved_by},
                    {"replaces", issued.replaces},
                    {"reason", issued.reason},
                    {"sha256", sha256_of(issued.xml)},
                    {"status", words.english()},
                    {"messages", messages_json({words})},
                    {"holds", status && status->holds()}});
  }
  return list;
}

/// Why an item of a run cannot have a certificate; empty: it can.
Message why_not_item(int item, const StoredRun& stored) {
  const std::size_t count = stored.items.size();
  if (item == 0 && count > 1)
    return Message("The run has {items} items, each with a certificate of its own: choose one of them.",
                   count);
  const auto k = static_cast<std::size_t>(std::max(item, 1));
  if (k > count) return {"The run has {items} items, and no item {item}.", count, item};
  if (stored.items[k - 1].dropped_at) return Message("Item {item} was left out of the run.", item);
  return {};
}

/// Why nobody can have a certificate issued on this page; empty: it is possible.
Message why_not_here(const ItemOfRun& of, const StoredRun& stored, const ApprovalPlace& place) {
  if (place.register_location.empty())
    return Message(
        "Certificates are issued on this page with a register only (ABCAL_REGISTER); see `abcal issue`.");
  if (place.laboratory_file.empty())
    return Message("The console knows no laboratory file; start it with `abcal serve --laboratory FILE`.");
  if (stored.state != RunState::kComplete || !RunFile::is_closed(of.run))
    return Message("The run is not complete and closed.");
  if (!has_experiments(stored.header.plan)) return Message("This is a levelling, no calibration.");
  return why_not_item(of.item, stored);
}

/// An approver, logged in for one approval.
class Approver {
 public:
  Approver(const ApprovalForm& form, const ApprovalPlace& place, const Clock& clock)
      : clock_(clock), opened_(lab::Register::open(place.register_location, clock.utc_now())) {
    constexpr std::chrono::minutes kForOneApproval{10};
    try {
      login_ = opened_.log_in(form.approver, form.password, clock.utc_now(), kForOneApproval);
    } catch (const lab::RegisterError& refused) {
      (void)opened_.find_person({});  // Throws if the register is lost.
      throw LoginRefused(refused.what());
    }
  }
  Approver(const Approver&) = delete;
  Approver& operator=(const Approver&) = delete;
  ~Approver() {
    try {
      opened_.log_out(login_, clock_.utc_now());
    } catch (const std::exception&) {
      return;  // The login expires by itself.
    }
  }
  lab::LoggedIn who() { return opened_.who(login_, clock_.utc_now()); }

 private:
  const Clock& clock_;
  lab::Register opened_;
  std::string login_;
};

void require_current(const ApprovalForm& form) {
  if (sha256_of_file(form.of.run) != form.run_sha256)
    throw StaleApproval(Message("the run is not the one that was looked at; open its result again"));
  const std::vector<IssuedCertificate> issued = ResultsFile::certificates(form.of.run, form.of.item);
  const std::string last = issued.empty() ? std::string() : issued.back().number;
  if (last != form.replaces)
    throw StaleApproval(
        Message("certificate {number} was issued for this run meanwhile; open its result again",
                last.empty() ? "none" : last));
}

/// The valid keys of a person that the register knows.
ApprovalJson keys_of(const std::string& person, const ApprovalPlace& place, Clock::UtcTime now) {
  ApprovalJson list = ApprovalJson::array();
  for (const lab::SigningKey& key : lab::Register::open(place.register_location, now).keys())
    if (key.kind == "person" && key.owner == person && key.valid_to.empty())
      list.push_back({{"fingerprint", key.fingerprint}, {"valid_from", key.valid_from}});
  return list;
}

}  // namespace

StoredRun require_approvable(const ApprovalForm& form, const ApprovalPlace& place) {
  StoredRun stored = RunFile::load(form.of.run);
  if (const Message why = why_not_here(form.of, stored, place); !why.empty())
    throw Telling<std::invalid_argument>(why);
  require_current(form);
  return stored;
}

IssueAsked issue_asked(const ApprovalForm& form, const ApprovalPlace& place) {
  IssueAsked asked;
  asked.run = form.of.run.string();
  asked.item = form.of.item;
  asked.certificate.laboratory = place.laboratory_file.string();
  asked.replaces = form.replaces;
  asked.reason = form.reason;
  asked.amendment = form.amendment;
  return asked;
}

namespace {

/// Every statement that an amendment changes, as its XML lists it.
std::vector<std::string> changed_by(const IssuedCertificate& issued) {
  if (issued.replaces.empty()) return {};
  const XmlDocument document = parse_xml(issued.xml, issued.number);
  return XmlQuery(document.get())
      .texts("dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_amendment']/dcc:reference");
}

}  // namespace

ApprovalJson issued_json(const IssueOutcome& outcome, const std::string& approver, bool training) {
  return {{"number", outcome.known_now.empty() ? outcome.issued.number : outcome.known_now},
          {"training", training},
          {"approved_by", approver},
          {"warnings", outcome.warnings},
          {"changed", changed_by(outcome.issued)}};
}

ApprovalJson approval_json(const ItemOfRun& of, const ApprovalPlace& place, const Visitor& visitor,
                           Clock::UtcTime now) {
  const StoredRun stored = RunFile::load(of.run);
  const Message why = why_not_here(of, stored, place);
  return {{"run_sha256", why.empty() ? sha256_of_file(of.run) : ""},
          {"measured_by", describe(operators_of(stored))},
          {"person", visitor.who.name},
          {"why_not", why.english()},
          {"messages", messages_json({why})},
          {"keys", why.empty() ? keys_of(visitor.who.name, place, now) : ApprovalJson::array()},
          {"certificates", certificates_of(of, place, now)}};
}

ApprovalJson approve(const ApprovalForm& form, const ApprovalPlace& place, const Clock& clock) {
  const StoredRun stored = require_approvable(form, place);
  Approver approver(form, place, clock);
  const lab::LoggedIn who = approver.who();
  if (const auto why = why_not_approve(who.person(), stored)) throw Telling<std::invalid_argument>(*why);
  Registered registered{lab::Register::open(place.register_location, clock.utc_now()), who};
  const IssueOutcome outcome = issue_run(issue_asked(form, place), &registered, clock);
  return issued_json(outcome, who.name(), registered.opened.facts().training);
}

}  // namespace abcal::console
