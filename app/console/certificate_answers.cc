// The certificates of a run on the page: those issued, and the approval by password or by key.
#include <fmt/format.h>

#include <functional>
#include <utility>

#include "app/console/answers.h"
#include "app/console/approval.h"
#include "app/console/target.h"
#include "app/system/output.h"

namespace abcal::console {
namespace {

namespace http = boost::beast::http;

constexpr Term kNoSuchRun = "There is no such run, or no such item.";
constexpr Term kLogInAsApprover =
    "Log in on this page as the person who approves: with a key nobody approves for another.";

/// The data of a request that outlive it: the request is gone when the certificate is made.
struct Attempt {
  Peer peer;
  HttpRequest head;
  std::string name, run;
  nlohmann::ordered_json answer;
  http::status status = http::status::ok;
  Message problem;
  Clock::Duration wait{};  ///< After too many failures; nothing was tried then.
  bool wrong_password = false;
};

/// Stores the result of `make`, or the reason of its failure.
void carry_out_attempt(Attempt& attempt, const std::function<nlohmann::ordered_json()>& make,
                       const Message& not_logged_in) {
  attempt.status = http::status::unprocessable_entity;
  try {
    attempt.answer = make();
    attempt.status = http::status::ok;
  } catch (const LoginRefused&) {
    attempt.wrong_password = true;
    attempt.problem = not_logged_in;
  } catch (const StaleApproval& stale) {
    attempt.status = http::status::conflict;
    attempt.problem = stale.message();
  } catch (const std::exception& error) {
    attempt.problem = message_of(error);
  }
}

std::shared_ptr<Attempt> attempt_of(const Asked& asked, const std::string& target, const std::string& name,
                                    const ItemOfRun& of) {
  auto attempt = std::make_shared<Attempt>();
  attempt->peer = asked.peer;
  attempt->head = head_of(asked.request);
  attempt->head.target(target);
  attempt->head.method(http::verb::post);
  attempt->name = name;
  attempt->run = of.run.filename().string();
  if (of.item > 0) attempt->run += fmt::format(", item {}", of.item);
  return attempt;
}

void log_issued(const Attempt& attempt, const char* how) {
  print_log("console: certificate {} of {}, approved by {} at {}{}\n",
            attempt.answer.at("number").get<std::string>(), attempt.run, attempt.name, attempt.peer.remote,
            how);
}

}  // namespace

bool Answers::is_signed_certificate(const HttpRequest& request) {
  return request.method() == http::verb::post && view(request.target()).ends_with("/signed-certificate");
}

/// POST /approve: a form with `run`, `run_sha256`, `item` if the run has several, and `replaces`, `reason`
/// and `amendment` if there is a certificate already. With `name` and `password` of the approver the
/// certificate is issued; the login of the page does not count, as the approver has to be present. With
/// `by_key` the certificate to be signed is made for the person logged in.
HttpResponse Answers::approve_certificate(const Asked& asked, Slow& later) {
  const auto form = parse_form(asked.request.body());
  if (!form) return refuse(asked, http::status::bad_request, Message("The form cannot be read."));
  const auto field = [&](const char* name) { return field_of(*form, name); };
  const auto of = find_item(field("run"), field("item"));
  if (!of) return refuse(asked, http::status::not_found, kNoSuchRun);
  const ApprovalForm filled{*of,
                            field("run_sha256"),
                            field("name"),
                            field("password"),
                            field("replaces"),
                            field("reason"),
                            field("amendment")};
  try {
    require_plain_text("reason", filled.reason, kLongestNote);
  } catch (const RequestError& error) {
    return refuse(asked, http::status::bad_request, message_of(error));
  }
  if (form->contains("by_key")) return prepare_certificate(asked, filled, later);
  if (common_.options.register_location.empty() || filled.approver.empty() || filled.password.empty())
    return refuse(asked, http::status::bad_request,
                  Message("Required: a register, and name and password of a person who may approve."));
  const auto attempt = attempt_of(asked, "/approve", filled.approver, *of);
  const auto finish = [this, attempt]() -> HttpResponse {
    const Asked then{attempt->peer, attempt->head, Access::kGranted, {}};
    if (attempt->wait > Clock::Duration::zero()) return logins_.refuse_throttled(then, attempt->wait);
    if (!attempt->problem.empty()) return refuse(then, attempt->status, attempt->problem);
    log_issued(*attempt, "");
    return json_answer(attempt->head, attempt->answer);
  };
  later.where = &seal_;
  later.job = [this, attempt, filled, finish] {
    attempt->wait = logins_.wait(attempt->name, attempt->peer);
    if (attempt->wait > Clock::Duration::zero()) return Slow::Finish(finish);
    carry_out_attempt(
        *attempt, [&] { return approve(filled, approval_place(), common_.clock); },
        Message("Name or password is not right."));
    if (attempt->wrong_password) logins_.failed(attempt->name, attempt->peer);
    if (attempt->problem.empty()) logins_.succeeded(attempt->name, attempt->peer);
    return Slow::Finish(finish);
  };
  return {};
}

HttpResponse Answers::prepare_certificate(const Asked& asked, const ApprovalForm& form, Slow& later) {
  if (asked.visitor.login.empty()) return refuse(asked, http::status::unprocessable_entity, kLogInAsApprover);
  const auto attempt = attempt_of(asked, "/approve", asked.visitor.who.name, form.of);
  const auto finish = [this, attempt]() -> HttpResponse {
    const Asked then{attempt->peer, attempt->head, Access::kGranted, {}};
    if (!attempt->problem.empty()) return refuse(then, attempt->status, attempt->problem);
    print_log("console: certificate {} of {} waits for the signature of {}\n",
              attempt->answer.at("number").get<std::string>(), attempt->run, attempt->name);
    return json_answer(attempt->head, attempt->answer);
  };
  later.where = &seal_;
  later.job = [this, attempt, form, visitor = asked.visitor, finish] {
    carry_out_attempt(
        *attempt, [&] { return signatures_.prepare(form, visitor, common_.clock); }, kLogInAsApprover);
    return Slow::Finish(finish);
  };
  return {};
}

/// POST /runs/NAME/signed-certificate, /runs/NAME/items/K/signed-certificate: the XML that was prepared, with
/// the signature of the person logged in.
HttpResponse Answers::take_signed_certificate(const Asked& asked, const std::vector<std::string>& words,
                                              Slow& later) {
  const auto of = find_item(words);
  if (!of) return refuse(asked, http::status::not_found, kNoSuchRun);
  if (asked.visitor.login.empty()) return refuse(asked, http::status::unprocessable_entity, kLogInAsApprover);
  const auto attempt = attempt_of(asked, "/signed-certificate", asked.visitor.who.name, *of);
  const auto finish = [this, attempt]() -> HttpResponse {
    const Asked then{attempt->peer, attempt->head, Access::kGranted, {}};
    if (!attempt->problem.empty()) return refuse(then, attempt->status, attempt->problem);
    log_issued(*attempt, ", signed with a key");
    return json_answer(attempt->head, attempt->answer);
  };
  later.where = &seal_;
  later.job = [this, attempt, of = *of, visitor = asked.visitor, xml = asked.request.body(), finish] {
    carry_out_attempt(
        *attempt, [&] { return signatures_.take(of, xml, visitor, common_.clock); }, kLogInAsApprover);
    return Slow::Finish(finish);
  };
  return {};
}

/// GET /runs/NAME/approval, /runs/NAME/items/K/approval
bool Answers::order_approval(const std::vector<std::string>& words, const Visitor& visitor, Slow& later) {
  const auto of = find_item(words);
  if (!of || words.back() != "approval") return false;
  later.workshop = &analyses_;
  later.name.clear();  // The answer depends on the person.
  later.make = [this, of = *of, visitor, place = approval_place()](const std::stop_token&) {
    return made_of_json(approval_json(of, place, visitor, common_.clock.utc_now()));
  };
  return true;
}

}  // namespace abcal::console
