#include "app/console/control.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <chrono>
#include <filesystem>
#include <iterator>
#include <utility>

#include "app/bench_file/bench_records.h"
#include "app/console/bench_service.h"
#include "app/document/json_text.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/bench/make_bench.h"
#include "app/system/output.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_file.h"

namespace abcal::console {
namespace {

using Json = nlohmann::json;

/// A page that sends nothing for this time is reported as silent.
constexpr std::chrono::seconds kSilent{3};

/// The process that holds the bench has this time to confirm a halt; then the guard is asked directly.
constexpr std::chrono::milliseconds kPatienceWithBench{400};

constexpr Term kNobodyHalts =
    "no guard answers that could halt the stage, and it is not confirmed at rest: stop it by its own switch";

/// The bench in the words of the guards' log; empty: its file cannot be read now.
std::string bench_in_log(const std::filesystem::path& bench_file) {
  try {
    return bench_in_words(read_bench(bench_file, register_records()));
  } catch (const std::exception&) {  // Who begins an activity is told.
    return {};
  }
}

SharedText shared(std::string text) {
  return std::make_shared<const std::string>(std::move(text));
}

/// @param why  the reason of a refusal; empty: the request was accepted
std::string reply_to(std::uint64_t id, const Message& why) {
  Json reply = {{"type", "reply"}, {"id", id}, {"ok", why.empty()}};
  if (!why.empty()) {
    reply["why"] = why.english();
    reply["messages"] = messages_json({why});
  }
  return json_text(reply);
}

}  // namespace

Control::Control(ServerCommon& common, Session::Options bench) : common_(common) {
  BenchLink::Listener listener;
  listener.message = [this](std::string_view json) { broadcast(std::string(json)); };
  listener.snapshot = [this](std::string_view json) { receive_snapshot(json); };
  listener.reply = [this](const Json& reply) { receive_reply(reply); };
  listener.state = [this](BenchState state, const Message& words) { receive_state(state, words); };
  listener.end = [this](bool was_on) { note_end(was_on); };
  const bool is_service = !common.options.bench_socket.empty();
  const std::filesystem::path socket = is_service ? common.options.bench_socket : default_bench_socket(bench);
  guard_watch_ = std::make_unique<GuardWatch>(
      socket.string() + ".lock", [file = bench.bench_file] { return bench_in_log(file); },
      [this](const GuardWatch::Known& known) {
        boost::asio::post(common_.io, [this, known] { receive_guard(known); });
      });
  bench_ = std::make_unique<BenchLink>(common.io, BenchLink::Options{std::move(bench), socket, !is_service},
                                       std::move(listener));
}

/// The guards of the stage know more of an axis, or less.
void Control::receive_guard(const GuardWatch::Known& known) {
  guard_ = known;
  const SharedText text = shared(json_text(guard_.message));
  for (const std::shared_ptr<Page>& page : pages_) page->send(text);
  if (stop_asked_at_ && known.is_at_rest && known.message.contains("halted")) confirm_stop();
}

/// The guard has halted the stage in place of the process that holds the bench.
void Control::confirm_stop() {
  const double took_s = to_seconds(common_.clock.now() - *std::exchange(stop_asked_at_, std::nullopt));
  broadcast(json_text({{"type", "halt"},
                       {"axes", {{"x", "halted"}, {"z", "halted"}}},
                       {"took_s", took_s},
                       {"since", format_utc(common_.clock.utc_now())}}));
  for (auto passed = passed_on_.begin(); passed != passed_on_.end();) {
    const std::shared_ptr<Page> page = passed->second.is_stop ? passed->second.page.lock() : nullptr;
    if (page) page->reply(reply_to(passed->second.id, {}));
    passed = passed->second.is_stop ? passed_on_.erase(passed) : std::next(passed);
  }
}

// ---- The bench

void Control::broadcast(const std::string& text) {
  const SharedText message = shared(text);
  for (const std::shared_ptr<Page>& page : pages_)
    if (!page->waits_for_snapshot) page->send(message);
}

void Control::receive_snapshot(std::string_view json) {
  const SharedText text = shared(std::string(json));
  const SharedText control = shared(control_message());
  for (const std::shared_ptr<Page>& page : pages_) {
    if (!std::exchange(page->waits_for_snapshot, false)) continue;
    page->send(text);
    page->send(control);
  }
}

std::string Control::bench_message() const {
  return json_text({{"type", "bench"},
                    {"state", to_string(bench_state_)},
                    {"words", bench_words_.english()},
                    {"messages", messages_json({bench_words_})}});
}

/// The process that holds the bench has started or ended.
void Control::receive_state(BenchState state, const Message& words) {
  bench_state_ = state;
  bench_words_ = words;
  const SharedText text = shared(bench_message());
  for (const std::shared_ptr<Page>& page : pages_) page->send(text);
  if (state == BenchState::kGone) {
    for (const auto& [number, lost] : std::exchange(passed_on_, {})) {
      if (const std::shared_ptr<Page> page = lost.page.lock())
        page->reply(json_text(
            {{"type", "reply"}, {"id", lost.id}, {"ok", false}, {"lost", true}, {"why", words.english()}}));
    }
  }
  if (state != BenchState::kOn) return;
  for (const std::shared_ptr<Page>& page : pages_) page->waits_for_snapshot = true;
  bench_->ask_snapshot();
}

/// The bench has answered a request that was passed on.
void Control::receive_reply(const Json& reply) {
  const auto found = passed_on_.find(reply.at("id").get<std::uint64_t>());
  if (found == passed_on_.end()) return;
  const PassedOn answered = std::move(found->second);
  passed_on_.erase(found);
  const std::shared_ptr<Page> page = answered.page.lock();
  if (!page) return;
  Message why;
  if (!reply.at("ok").get<bool>())
    why = reply.contains("message") ? message_from_json(reply.at("message"))
                                    : Message::bare(reply.at("why").get<std::string>());
  // The process that holds the bench has nothing to stop, but its guard may have.
  if (answered.is_stop && !why.empty() && !guard_.is_at_rest)
    why = guard_.has_guard ? Message() : Message(kNobodyHalts);
  if (answered.is_stop && guard_.is_at_rest) stop_asked_at_.reset();
  if (!why.empty()) common_.log_refusal(page->peer(), answered.text, why.english());
  page->reply(reply_to(answered.id, why));
}

void Control::note_end(bool was_on) {
  if (!std::exchange(bench_is_closed_, true)) bench_closed_.set_value(was_on);
}

bool Control::end(bool leave_running) {
  boost::asio::post(common_.io, [this, leave_running] {
    if (leave_running) bench_->leave();
    const bool waits = !leave_running && bench_->close_bench();
    if (!waits) note_end(false);
  });
  // Twice the longest halt that a driver waits for.
  constexpr std::chrono::seconds kLongestEnd{60};
  std::future<bool> closed = bench_closed_.get_future();
  if (closed.wait_for(kLongestEnd) == std::future_status::ready) return closed.get();
  print_error(
      "the process that holds the bench does not answer: the stage may be moving, stop it by its own switch");
  return true;
}

// ---- The pages

void Control::join(const std::shared_ptr<Page>& page) {
  page->number = ++pages_so_far_;
  page->heard = common_.clock.now();
  pages_.insert(page);
  const Visitor& visitor = page->visitor();
  page->send(shared(json_text({{"type", "you"},
                               {"number", page->number},
                               {"person", visitor.who.name},
                               {"may_steer", visitor.may_steer}})));
  broadcast(control_message());  // Who watches has changed.
  if (bench_state_ != BenchState::kOn) page->send(shared(bench_message()));
  if (!guard_.message.is_null()) page->send(shared(json_text(guard_.message)));
  send_snapshot(*page);
}

void Control::leave(Page& page) {
  const std::shared_ptr<Page> left = page.shared_from_this();
  pages_.erase(left);
  if (asking_ == &page) asking_ = nullptr;
  if (controller_ == &page) {
    give_control(nullptr);
  } else {
    broadcast(control_message());
  }
}

void Control::send_snapshot(Page& page) {
  const bool is_asked =
      std::any_of(pages_.begin(), pages_.end(), [](const auto& other) { return other->waits_for_snapshot; });
  page.waits_for_snapshot = true;
  if (!is_asked) bench_->ask_snapshot();
}

std::vector<std::string> Control::logins() const {
  std::vector<std::string> logins;
  for (const std::shared_ptr<Page>& page : pages_)
    if (!page->visitor().login.empty()) logins.push_back(page->visitor().login);
  return logins;
}

void Control::close_pages(const std::vector<std::string>& logins) {
  const std::set<std::shared_ptr<Page>> open = pages_;
  for (const std::shared_ptr<Page>& page : open)
    if (std::ranges::find(logins, page->visitor().login) != logins.end()) page->close();
}

void Control::receive(Page& page, std::string_view text) {
  page.heard = common_.clock.now();
  std::uint64_t id = 0;
  Message why;
  try {
    const Request request = parse_request(text);
    if (std::holds_alternative<Beat>(request.command)) return;
    id = static_cast<std::uint64_t>(request.id);
    Session::Refusal refusal = carry_out(page, request, text);
    if (!refusal) return;
    why = *std::move(refusal);
  } catch (const RequestError& error) {
    id = error.id();
    why = message_of(error);
  }
  if (!why.empty()) common_.log_refusal(page.peer(), text, why.english());
  page.reply(reply_to(id, why));
}

Session::Refusal Control::carry_out(Page& page, const Request& request, std::string_view text) {
  if (const auto* take = std::get_if<TakeControl>(&request.command))
    return take_control(page, *take).value_or(Message());
  if (std::holds_alternative<AskControl>(request.command)) return ask_control(page).value_or(Message());
  // Anybody who sees that something goes wrong may stop it, with control or without.
  if (controller_ != &page && !std::holds_alternative<Stop>(request.command))
    return Message("this page only watches; take control first");
  if (std::holds_alternative<ReleaseControl>(request.command)) {
    give_control(nullptr);
    return Message();
  }
  if (const auto* answer = std::get_if<AnswerControl>(&request.command))
    return answer_control(*answer).value_or(Message());
  const bool is_stop = std::holds_alternative<Stop>(request.command);
  if (is_stop) {
    stop_asked_at_ = common_.clock.now();
    const bool answers = bench_->is_on() && bench_state_ == BenchState::kOn;
    guard_watch_->stop(page.asker().for_people(),
                       answers ? kPatienceWithBench : std::chrono::milliseconds(0));
    if (!bench_->is_on() && !guard_.is_at_rest) return guard_.has_guard ? Message() : Message(kNobodyHalts);
  }
  if (!bench_->is_on()) return Message("the process that holds the bench is not there");
  if (std::holds_alternative<KeepTurning>(request.command)) {
    constexpr std::uint64_t kUnanswered = 0;
    bench_->request(kUnanswered, page.asker(), request);
    return std::nullopt;
  }
  passed_on_[++passed_on_so_far_] = {page.weak_from_this(), static_cast<std::uint64_t>(request.id),
                                     std::string(text), is_stop};
  bench_->request(passed_on_so_far_, page.asker(), request);
  return std::nullopt;
}

// ---- Control

void Control::check_beats() {
  const bool is_silent = controller_ != nullptr && common_.clock.now() - controller_->heard > kSilent;
  if (std::exchange(controller_silent_, is_silent) != is_silent) broadcast(control_message());
}

std::string Control::control_message() const {
  Json message = {{"type", "control"}, {"page", nullptr}, {"asks", nullptr}, {"watch", Json::array()}};
  for (const std::shared_ptr<Page>& page : pages_)
    message["watch"].push_back({{"page", page->number}, {"who", page->asker().for_people()}});
  if (asking_ != nullptr)
    message["asks"] = {{"page", asking_->number}, {"who", asking_->asker().for_people()}};
  if (controller_ != nullptr) {
    message["page"] = controller_->number;
    message["who"] = controller_->asker().for_people();
    message["silent"] = controller_silent_;
  }
  return json_text(message);
}

void Control::give_control(Page* page) {
  controller_ = page;
  controller_silent_ = false;
  if (page == nullptr || page == asking_) asking_ = nullptr;
  broadcast(control_message());
}

/// Why this page may not steer; nullopt if it may.
Session::Refusal Control::not_allowed(const Page& page) {
  if (page.visitor().may_steer) return std::nullopt;
  if (page.visitor().who.name.empty())
    return Message(
        "who has the token may watch and stop, but not steer; required: a person with the right to measure");
  return Message("{who} may watch and stop, but not steer; required: a person with the right to measure",
                 page.visitor().who.name);
}

Session::Refusal Control::ask_control(Page& page) {
  if (Session::Refusal refusal = not_allowed(page)) return refusal;
  if (controller_ == nullptr) return Message("nobody steers; take control");
  if (controller_ == &page) return Message("this page steers already");
  if (asking_ != nullptr && asking_ != &page)
    return Message("{who} has asked before", asking_->asker().for_people());
  asking_ = &page;
  broadcast(control_message());
  return std::nullopt;
}

Session::Refusal Control::answer_control(const AnswerControl& answer) {
  if (asking_ == nullptr || asking_->number != answer.page)
    return Message("page {page} does not ask for control", answer.page);
  Page* const asking = std::exchange(asking_, nullptr);
  if (!answer.hand_over) {
    broadcast(control_message());
    return std::nullopt;
  }
  bench_->control_taken(asking->asker());
  give_control(asking);
  return std::nullopt;
}

Session::Refusal Control::take_control(Page& page, const TakeControl& take) {
  if (Session::Refusal refusal = not_allowed(page)) return refusal;
  if (controller_ != nullptr && controller_ != &page && !take.from_another)
    return Message("{who} steers; take control from it first", controller_->asker().for_people());
  if (controller_ != &page) bench_->control_taken(page.asker());
  give_control(&page);
  return std::nullopt;
}

}  // namespace abcal::console
