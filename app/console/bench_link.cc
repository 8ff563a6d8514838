#include "app/console/bench_link.h"

#include <fmt/format.h>
#include <sys/wait.h>

#include <boost/asio/post.hpp>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/document/json_text.h"
#include "app/system/channel.h"
#include "app/system/detached_process.h"
#include "app/system/helper_program.h"
#include "app/system/output.h"
#include "drivers/text/names.h"

namespace abcal::console {
namespace {

using LinkJson = nlohmann::json;

constexpr std::chrono::milliseconds kRetry{20};
constexpr std::chrono::milliseconds kRetryOfService{500};
constexpr std::chrono::seconds kLongestStart{10};
constexpr std::chrono::seconds kWatchInterval{1};
constexpr std::chrono::seconds kSilentBench{3};

LinkJson json_of(const Asker& by) {
  return {
      {"by", by.page}, {"name", by.who.name}, {"register", by.who.register_identity}, {"login", by.login}};
}

constexpr auto kStates = names<BenchState>({{BenchState::kStarting, "starting"},
                                            {BenchState::kOn, "on"},
                                            {BenchState::kSilent, "silent"},
                                            {BenchState::kGone, "gone"}});

}  // namespace

std::string_view to_string(BenchState state) {
  return kStates.of(state);
}

BenchLink::BenchLink(boost::asio::io_context& io, Options options, Listener listener)
    : io_(io), options_(std::move(options)), listener_(std::move(listener)), again_(io), next_watch_(io) {}

void BenchLink::begin() {
  begun_ = clock_.now();
  connect();
  watch();
}

void BenchLink::connect() {
  Descriptor socket;
  std::string why;
  try {
    socket = connect_to(options_.socket, ChannelKind::kBytes);
  } catch (const std::system_error& error) {
    why = error.what();
  }
  if (socket.number() >= 0) return connected(std::move(socket));
  if (!std::filesystem::is_directory(std::filesystem::absolute(options_.socket).parent_path())) {
    notify(BenchState::kGone, Message::bare(why));
    return try_again(kRetryOfService);
  }
  if (!options_.start) {
    notify(BenchState::kGone, Message("No process holds the bench ({why}): start its service.", why));
    return try_again(kRetryOfService);
  }
  if (!std::exchange(started_, true)) {
    begun_ = clock_.now();
    start_process();
  } else if (clock_.now() - begun_ > kLongestStart) {
    notify(
        BenchState::kGone,
        Message("The process that holds the bench cannot be started; see where this console was started."));
    started_ = false;
  }
  try_again(kRetry);
}

void BenchLink::start_process() {
  try {
    // The process may have another working folder.
    const auto absolute = [](const std::filesystem::path& path) {
      return std::filesystem::absolute(path).string();
    };
    process_ = start_detached(
        helper_program("abcal", "the console needs"),
        {"bench", absolute(options_.bench.bench_file), "--runs", absolute(options_.bench.runs), "--pace",
         fmt::format("{}", options_.bench.pace), "--socket", absolute(options_.socket)});
  } catch (const std::exception& error) {
    print_error(error.what());
  }
}

void BenchLink::try_again(std::chrono::milliseconds after) {
  again_.expires_after(after);
  again_.async_wait([this](boost::system::error_code cancelled) {
    if (!cancelled && !leaving_) connect();
  });
}

void BenchLink::connected(Descriptor socket) {
  started_ = false;
  heard_ = clock_.now();
  channel_ = std::make_shared<BenchChannel>(io_, std::move(socket));
  channel_->begin([this](std::string_view line) { received(line); }, [this] { lost(); });
  notify(BenchState::kOn, {});
}

void BenchLink::received(std::string_view line) {
  heard_ = clock_.now();
  if (state_ == BenchState::kSilent) notify(BenchState::kOn, {});
  const std::string_view json = line.substr(1);
  switch (line[0]) {
    case bench_line::kMessage:
      return listener_.message(json);
    case bench_line::kSnapshot:
      return listener_.snapshot(json);
    case bench_line::kReply:
      return listener_.reply(LinkJson::parse(json));
    case bench_line::kEnd:
      leaving_ = true;
      return listener_.end(LinkJson::parse(json).at("was_on").get<bool>());
    default:
      return;
  }
}

void BenchLink::lost() {
  channel_.reset();
  if (leaving_) return listener_.end(false);
  notify(BenchState::kGone, Message("The process that held the bench has died. Its guard halts the stage, if "
                                    "it had moved it; the run can be resumed."));
  try_again(kRetry);
}

/// Checks each second whether the other end still sends.
void BenchLink::watch() {
  next_watch_.expires_after(kWatchInterval);
  next_watch_.async_wait([this](boost::system::error_code cancelled) {
    if (cancelled) return;
    // Collects a process that was started here and has ended: it leaves no zombie.
    if (process_ > 0 && ::waitpid(process_, nullptr, WNOHANG) != 0) process_ = -1;
    if (channel_ && state_ == BenchState::kOn && clock_.now() - heard_ > kSilentBench)
      notify(BenchState::kSilent,
             Message("The process that holds the bench does not answer: nothing is known of the stage."));
    watch();
  });
}

void BenchLink::notify(BenchState state, const Message& words) {
  if (state_ == state && state != BenchState::kOn) return;
  state_ = state;
  listener_.state(state, words);
}

void BenchLink::ask_snapshot() {
  if (channel_) channel_->send(bench_line::kAskSnapshot);
}

void BenchLink::control_taken(const Asker& by) {
  if (channel_) channel_->send(bench_line::kControl, json_text(json_of(by)));
}

void BenchLink::request(std::uint64_t id, const Asker& by, const Request& request) {
  LinkJson json = json_of(by);
  json["id"] = id;
  json["request"] = request.json;
  channel_->send(bench_line::kRequest, json_text(json));
}

bool BenchLink::close_bench() {
  leaving_ = true;
  if (!channel_) return false;
  channel_->send(bench_line::kClose);
  return true;
}

bool BenchLink::wait_for_process(std::chrono::milliseconds longest) {
  const Clock::Instant last = clock_.now() + longest;
  while (process_ > 0 && ::waitpid(process_, nullptr, WNOHANG) == 0) {
    if (clock_.now() > last) return false;
    clock_.sleep_until(clock_.now() + std::chrono::milliseconds(5));
  }
  process_ = -1;
  return true;
}

void BenchLink::leave() {
  leaving_ = true;
  again_.cancel();
  next_watch_.cancel();
  if (channel_) channel_->close();
}

}  // namespace abcal::console
