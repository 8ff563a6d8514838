#include "app/console/bench_service.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cstdio>

#include <algorithm>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cerrno>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>

#include "app/console/bench_channel.h"
#include "app/console/interrupted_run.h"
#include "app/console/live_view.h"
#include "app/console/queue_desk.h"
#include "app/console/run_library.h"
#include "app/document/json_text.h"
#include "app/system/channel.h"
#include "app/system/real_clock.h"
#include "app/system/version.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_file.h"

namespace abcal::console {
namespace {

namespace asio = boost::asio;
using asio::local::stream_protocol;
using Json = nlohmann::json;

/// Most events that may wait for the thread of the connections; strips beyond it are dropped.
constexpr int kMostPendingEvents = 500;
/// Lines that may wait for a console; beyond it they are dropped, and it gets a snapshot instead.
constexpr std::size_t kMostLines = 2000;
constexpr std::chrono::seconds kBenchBeat{1};
/// The default socket of a bench is the name of its file with this end, hidden.
constexpr std::string_view kSocketEnd = ".bench";

/// Reads the person and page that BenchLink has written. An older console states the page only.
Asker asker_of(const Json& json) {
  Asker by;
  by.page = json.value("by", "");
  by.who = {json.value("name", ""), json.value("register", "")};
  by.login = json.value("login", "");
  return by;
}

/// States the reason of a refusal in a reply.
void refuse(Json& reply, const Message& why) {
  reply["why"] = why.english();
  reply["message"] = message_json(why);
}

/// The lock of one bench, held as long as this process lives, however it ends.
class BenchLock {
 public:
  explicit BenchLock(const std::filesystem::path& socket) {
    const std::string file = socket.string() + ".lock";
    descriptor_ = ::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (descriptor_ < 0)
      throw std::runtime_error(
          fmt::format("{}: {}", file, std::error_code(errno, std::generic_category()).message()));
    if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
      ::close(descriptor_);
      throw BenchIsHeld(fmt::format("another process holds this bench already ({})", file));
    }
    // The process number, for people.
    const std::string pid = fmt::format("{}\n", ::getpid());
    if (::ftruncate(descriptor_, 0) != 0 || ::write(descriptor_, pid.data(), pid.size()) < 0) return;
  }
  ~BenchLock() { ::close(descriptor_); }
  BenchLock(const BenchLock&) = delete;
  BenchLock& operator=(const BenchLock&) = delete;

 private:
  int descriptor_ = -1;
};

}  // namespace

std::filesystem::path default_bench_socket(const Session::Options& bench) {
  return bench.runs / fmt::format(".{}{}", bench.bench_file.stem().string(), kSocketEnd);
}

std::optional<std::string> bench_of_socket(const std::string& file) {
  if (!file.starts_with('.') || !file.ends_with(kSocketEnd) || file.size() <= 1 + kSocketEnd.size())
    return std::nullopt;
  return file.substr(1, file.size() - 1 - kSocketEnd.size());
}

struct BenchService::Impl {
  /// A console at the other end of a channel.
  struct Console {
    std::shared_ptr<BenchChannel> channel;
    bool behind = false;  ///< Lines were dropped.
  };

  explicit Impl(Options the_options);
  ~Impl();

  void accept();
  void attach(stream_protocol::socket socket);
  void receive(Console& console, std::string_view line);
  Session::Refusal carry_out(const Asker& by, const Command& command);
  void pass_on(Event event);
  void broadcast(const std::string& message);
  void beat();
  void end_if_not_needed();
  void begin_end();
  void finish();

  Options options;
  BenchLock lock;
  RealClock clock;
  LiveView live;
  asio::io_context io;
  stream_protocol::acceptor acceptor{io};
  asio::steady_timer next_beat{io};
  asio::steady_timer lingering{io};
  asio::steady_timer flushing{io};
  std::set<std::shared_ptr<Console>> consoles;
  std::atomic<int> pending = 0;
  bool idle = true;
  bool ending = false;
  bool was_on = false;
  std::unique_ptr<Session> session;
  std::unique_ptr<QueueDesk> desk;
  std::jthread ender;
};

BenchService::Impl::Impl(Options the_options)
    : options(std::move(the_options)),
      lock(options.socket),
      live({{"program", std::string("abcal ") + program_version()},
            {"bench_file", options.bench.bench_file.filename().string()},
            {"pace", options.bench.pace}},
           clock) {
  std::error_code ignored;
  std::filesystem::remove(options.socket, ignored);  // Left by a killed process: the lock is ours.
  acceptor.assign(stream_protocol(), listen_at(options.socket, ChannelKind::kBytes, kForThisUser).release());
  live.offer(find_interrupted_run(options.bench.runs));
  session = std::make_unique<Session>(options.bench, [this](Event event) { pass_on(std::move(event)); });
  desk = std::make_unique<QueueDesk>(
      options.bench.runs / fmt::format(".{}.queue.json", options.bench.bench_file.stem().string()), *session,
      [this](Event event) { pass_on(std::move(event)); });
  accept();
  beat();
  end_if_not_needed();
}

BenchService::Impl::~Impl() {
  ender = {};
  session->close();
  std::error_code ignored;
  std::filesystem::remove(options.socket, ignored);
}

void BenchService::Impl::accept() {
  acceptor.async_accept([this](boost::system::error_code error, stream_protocol::socket socket) {
    if (error == asio::error::operation_aborted) return;
    if (!error) attach(std::move(socket));
    accept();
  });
}

void BenchService::Impl::attach(stream_protocol::socket socket) {
  const auto console = std::make_shared<Console>();
  console->channel = std::make_shared<BenchChannel>(std::move(socket));
  console->channel->drained = [this, weak = std::weak_ptr(console)] {
    const auto slow = weak.lock();
    if (slow && std::exchange(slow->behind, false))
      slow->channel->send(bench_line::kMessage, live.snapshot());
  };
  consoles.insert(console);
  lingering.cancel();
  console->channel->begin([this, console](std::string_view line) { receive(*console, line); },
                          [this, console] {
                            console->channel->drained = nullptr;
                            consoles.erase(console);
                            end_if_not_needed();
                          });
}

void BenchService::Impl::receive(Console& console, std::string_view line) {
  if (line[0] == bench_line::kAskSnapshot)
    return console.channel->send(bench_line::kSnapshot, live.snapshot());
  if (line[0] == bench_line::kClose) return begin_end();
  if (line[0] == bench_line::kControl) {
    const Json json = Json::parse(line.substr(1), nullptr, /*allow_exceptions=*/false);
    if (json.is_object()) session->control_taken(asker_of(json));
    return;
  }
  if (line[0] != bench_line::kRequest) return;
  Json reply = {{"id", 0}, {"ok", false}};
  try {
    const Json json = Json::parse(line.substr(1));
    reply["id"] = json.at("id");
    const Request request = read_request(json.at("request"));
    const Session::Refusal refusal = carry_out(asker_of(json), request.command);
    reply["ok"] = !refusal;
    if (refusal) refuse(reply, *refusal);
  } catch (const std::exception& error) {
    refuse(reply, message_of(error));
  }
  console.channel->send(bench_line::kReply, json_text(reply));
}

Session::Refusal BenchService::Impl::carry_out(const Asker& by, const Command& command) {
  struct Do {
    Impl& impl;
    const Asker& by;
    Session::Refusal operator()(const CheckBench& check) const {
      return impl.session->check(check.with_motion, by);
    }
    Session::Refusal operator()(const StartRun& start) const { return impl.session->start(start.choice, by); }
    Session::Refusal operator()(const HoldRun&) const { return impl.session->hold(by); }
    Session::Refusal operator()(const ContinueRun&) const { return impl.session->continue_run(by); }
    Session::Refusal operator()(const Stop&) const { return impl.session->stop(by); }
    Session::Refusal operator()(const ResumeRun& resume) const {
      const auto path = RunLibrary::find_in(impl.options.bench.runs, resume.run);
      if (!path) return Message("there is no such run in the run folder");
      return impl.session->resume({path->string(), resume.without_missing_items}, by);
    }
    Session::Refusal operator()(const Jog& jog) const { return impl.session->jog(jog, by); }
    Session::Refusal operator()(const KeepTurning& sign) const { return impl.session->keep_turning(sign); }
    Session::Refusal operator()(const Note& note) const { return impl.session->note(note.text, by); }
    Session::Refusal operator()(const Acknowledge& seen) const {
      const auto path = RunLibrary::find_in(impl.options.bench.runs, seen.run);
      if (!path) return Message("there is no such run in the run folder");
      return impl.session->acknowledge(*path, by);
    }
    Session::Refusal operator()(const Level&) const { return impl.session->level(by); }
    Session::Refusal operator()(const Probe&) const { return impl.session->probe(); }
    Session::Refusal operator()(const QueueCommand& queue) const { return impl.desk->carry_out(by, queue); }
    Session::Refusal operator()(const Beat&) const { return std::nullopt; }
    Session::Refusal operator()(const TakeControl&) const { return std::nullopt; }
    Session::Refusal operator()(const ReleaseControl&) const { return std::nullopt; }
    Session::Refusal operator()(const AskControl&) const { return std::nullopt; }
    Session::Refusal operator()(const AnswerControl&) const { return std::nullopt; }
  };
  return std::visit(Do{*this, by}, command);
}

/// In the measuring thread: hands the event over and returns.
void BenchService::Impl::pass_on(Event event) {
  const bool can_be_missed = std::holds_alternative<StripSeen>(event);
  if (can_be_missed && pending > kMostPendingEvents) return;
  ++pending;
  asio::post(io, [this, event = std::move(event), seen = clock.utc_now()] {
    --pending;
    if (const auto* activity = std::get_if<ActivitySeen>(&event)) {
      idle = activity->activity == Activity::kIdle;
      end_if_not_needed();
    }
    if (const std::string message = live.apply(event, seen); !message.empty()) broadcast(message);
    desk->see(event);
  });
}

void BenchService::Impl::broadcast(const std::string& message) {
  for (const std::shared_ptr<Console>& console : consoles) {
    if (console->behind) continue;
    if (console->channel->waiting() >= kMostLines)
      console->behind = true;
    else
      console->channel->send(bench_line::kMessage, message);
  }
}

/// Sends a beat each second: a page that receives it knows that everything in between is alive.
void BenchService::Impl::beat() {
  next_beat.expires_after(kBenchBeat);
  next_beat.async_wait([this](boost::system::error_code cancelled) {
    if (cancelled) return;
    broadcast(json_text({{"type", "beat"}, {"utc", format_utc(clock.utc_now())}}));
    beat();
  });
}

void BenchService::Impl::end_if_not_needed() {
  lingering.cancel();
  if (options.linger.count() == 0 || !idle || !consoles.empty()) return;
  lingering.expires_after(options.linger);
  lingering.async_wait([this](boost::system::error_code cancelled) {
    if (!cancelled && idle && consoles.empty()) begin_end();
  });
}

void BenchService::Impl::begin_end() {
  if (std::exchange(ending, true)) return;
  // In a thread of its own, so that consoles still see the end.
  ender = std::jthread([this] {
    const bool stopped = !session->stop({"the end of the program", {}, {}});
    session->close();
    asio::post(io, [this, stopped] {
      was_on = stopped;
      for (const auto& console : consoles)
        console->channel->send(bench_line::kEnd, json_text({{"was_on", stopped}}));
      finish();
    });
  });
}

/// Ends when all lines are written, or after 1 s.
void BenchService::Impl::finish() {
  static constexpr std::chrono::milliseconds kPollInterval{5};
  static constexpr int kMostPolls = 200;
  struct Poll {
    Impl& impl;
    int polls = 0;
    void operator()(boost::system::error_code) {
      const bool written = std::all_of(impl.consoles.begin(), impl.consoles.end(),
                                       [](const auto& console) { return console->channel->waiting() == 0; });
      if (written || ++polls > kMostPolls) return impl.io.stop();
      impl.flushing.expires_after(kPollInterval);
      impl.flushing.async_wait(*this);
    }
  };
  Poll{*this}({});
}

BenchService::BenchService(Options options) : impl_(std::make_unique<Impl>(std::move(options))) {}

BenchService::~BenchService() = default;

bool BenchService::serve(const std::stop_token& stop) {
  const std::stop_callback on_stop(stop, [this] { asio::post(impl_->io, [this] { impl_->begin_end(); }); });
  impl_->io.run();
  return impl_->was_on;
}

}  // namespace abcal::console
