#pragma once

#include <cstdint>
#include <future>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "app/console/bench_link.h"
#include "app/console/guard_watch.h"
#include "app/console/page.h"
#include "app/console/request.h"
#include "app/console/server_common.h"

namespace abcal::console {

/// Brings pages and the process that holds the bench together: messages of the bench go to every page, and
/// requests of the one page that steers go to the bench. For the thread of the connections.
class Control {
 public:
  Control(ServerCommon& common, Session::Options bench);

  /// Finds the process that holds the bench, or starts it.
  void begin() { bench_->begin(); }

  /// A page whose WebSocket is open begins to watch.
  void join(const std::shared_ptr<Page>& page);
  void leave(Page& page);
  /// A message of a page: a request, which is refused, carried out here, or passed on to the bench.
  void receive(Page& page, std::string_view text);
  /// The whole state, for a page that begins or has missed messages.
  void send_snapshot(Page& page);
  /// To be called each second: checks whether the page that steers still answers the beats.
  void check_beats();

  /// The logins of the pages that are open.
  std::vector<std::string> logins() const;
  /// Closes the pages of persons who may not use the console any more.
  void close_pages(const std::vector<std::string>& logins);

  /// Ends the bench, or leaves it running; waits. For any thread. @return whether an activity was stopped
  bool end(bool leave_running);

 private:
  using Json = nlohmann::json;

  /// A request that was passed on, and the page that waits for the reply.
  struct PassedOn {
    std::weak_ptr<Page> page;
    std::uint64_t id = 0;
    std::string text;  ///< For the log.
    bool is_stop = false;
  };

  void broadcast(const std::string& text);
  void receive_snapshot(std::string_view json);
  void receive_state(BenchState state, const Message& words);
  void receive_reply(const Json& reply);
  void note_end(bool was_on);
  void receive_guard(const GuardWatch::Known& known);
  void confirm_stop();
  /// @return the reason of a refusal, empty: done; absent: the bench replies to it
  Session::Refusal carry_out(Page& page, const Request& request, std::string_view text);
  Session::Refusal take_control(Page& page, const TakeControl& take);
  static Session::Refusal not_allowed(const Page& page);
  Session::Refusal ask_control(Page& page);
  Session::Refusal answer_control(const AnswerControl& answer);
  void give_control(Page* page);
  std::string control_message() const;
  std::string bench_message() const;

  ServerCommon& common_;
  std::unique_ptr<BenchLink> bench_;
  BenchState bench_state_ = BenchState::kStarting;
  Message bench_words_{"The process that holds the bench is being started."};
  std::map<std::uint64_t, PassedOn> passed_on_;
  std::uint64_t passed_on_so_far_ = 0;
  std::promise<bool> bench_closed_;
  bool bench_is_closed_ = false;
  std::set<std::shared_ptr<Page>> pages_;
  Page* controller_ = nullptr;
  bool controller_silent_ = false;
  Page* asking_ = nullptr;  ///< A page that asks for control.
  std::int64_t pages_so_far_ = 0;
  GuardWatch::Known guard_;                      ///< Last report of the guards.
  std::optional<Clock::Instant> stop_asked_at_;  ///< A Stop that neither bench nor guard has confirmed yet.
  std::unique_ptr<GuardWatch> guard_watch_;      ///< Last: its thread ends before the members that it uses.
};

}  // namespace abcal::console
