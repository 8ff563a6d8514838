#include "app/witness/witness_client.h"

#include <fmt/format.h>
#include <signal.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <nlohmann/json.hpp>
#include <string_view>
#include <system_error>
#include <utility>

#include "app/document/json_text.h"
#include "app/system/channel.h"
#include "app/system/detached_process.h"
#include "app/system/helper_program.h"
#include "app/system/private_file.h"
#include "app/system/state_folder.h"
#include "app/witness/witness_socket.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

using Json = nlohmann::json;

/// Longest wait for the end of a witness that this program has started.
constexpr std::chrono::milliseconds kEnd{2000};

constexpr const char* kSilent = "the witness does not answer";

std::string environment(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

/// The bytes of a signature; empty if the text is not one.
std::string bytes_of(std::string_view hexadecimal) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  if (hexadecimal.size() != 128 || hexadecimal.find_first_not_of(kDigits) != std::string_view::npos)
    return {};
  std::string bytes;
  for (std::size_t k = 0; k < hexadecimal.size(); k += 2)
    bytes += static_cast<char>(16 * kDigits.find(hexadecimal[k]) + kDigits.find(hexadecimal[k + 1]));
  return bytes;
}

std::string member(const Json& json, const char* name) {
  const auto found = json.find(name);
  return found != json.end() && found->is_string() ? found->get<std::string>() : std::string();
}

/// The witness returned a line that does not agree with the question.
[[noreturn]] void refuse_line(const std::string& question, const std::string& line) {
  throw WitnessRefusal(fmt::format(
      "the witness was asked {}; found the line {}; required: a line that says so", question, line));
}

}  // namespace

/// A socket to the witness, and its process if this program has started it.
class WitnessClient::Connection {
 public:
  explicit Connection(const std::filesystem::path& socket)
      : socket_(connect_to(socket, ChannelKind::kPackets)) {}

  Connection(const std::filesystem::path& key, const std::filesystem::path& log) {
    ConnectedProcess started =
        start_connected(helper_program("abcal-witness", "signing a run while it is measured needs"),
                        {"--beside", "--key", key.string(), "--log", log.string()});
    socket_ = std::move(started.socket);
    process_ = started.process;
    ended_ = Descriptor(static_cast<int>(::syscall(SYS_pidfd_open, process_, 0)));
  }
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  ~Connection() {
    socket_.close();
    if (process_ <= 0) return;
    if (is_silent_ || !has_ended()) {
      ::kill(process_, SIGKILL);  // Its log loses nothing.
      (void)has_ended();
    }
    ::waitpid(process_, nullptr, WNOHANG);
  }

  /// @return nullopt if the connection has ended
  /// @throws WitnessSilent at the deadline
  std::optional<std::string> ask(const std::string& question, Instant deadline) {
    if (!send_packet(socket_.number(), question)) return std::nullopt;
    if (wait_until_readable(socket_.number(), deadline - Instant::clock::now()))
      return receive_witness_packet(socket_.number());
    is_silent_ = true;
    throw WitnessSilent(kSilent);
  }

 private:
  bool has_ended() const { return wait_until_readable(ended_.number(), kEnd); }

  Descriptor socket_, ended_;
  pid_t process_ = 0;       ///< 0: none.
  bool is_silent_ = false;  ///< Its end is not waited for.
};

/// An answer whose "ok" is true.
struct WitnessClient::Answer {
  Json json;
};

bool WitnessClient::is_declined() {
  return environment("ABCAL_WITNESS") == "none";
}

std::unique_ptr<WitnessClient> WitnessClient::find() {
  const std::string stated = environment("ABCAL_WITNESS"), key = environment("ABCAL_SIGNING_KEY");
  if (is_declined()) return nullptr;
  std::error_code ignored;
  if (!stated.empty() || std::filesystem::exists(kWitnessSocket, ignored)) {
    const std::string socket = stated.empty() ? kWitnessSocket : stated;
    try {
      return std::make_unique<WitnessClient>(socket, Limits{});
    } catch (const WitnessSilent& problem) {
      throw WitnessSilent(
          fmt::format("the witness of this computer: {}; required: `systemctl start abcal-witness`, or "
                      "ABCAL_WITNESS=none for runs without a witness",
                      problem.what()));
    }
  }
  if (key.empty()) return nullptr;
  const std::filesystem::path folder = state_folder();
  if (folder.empty())
    throw WitnessRefusal(
        "the log of the witness can be kept nowhere: found none of STATE_DIRECTORY, XDG_STATE_HOME and HOME; "
        "required: one of them, or ABCAL_WITNESS=none");
  std::filesystem::create_directories(folder);
  std::string fingerprint;
  try {  // Reported as a wrong setting, not as a witness that does not start.
    fingerprint = fingerprint_of(public_key_of(read_private_file(key, "key")));
  } catch (const std::invalid_argument& problem) {
    throw std::invalid_argument(fmt::format("ABCAL_SIGNING_KEY={}: {}", key, problem.what()));
  }
  // Each key has a log of its own.
  return std::make_unique<WitnessClient>(
      key, folder / fmt::format("witness-{}.db", fingerprint.substr(0, 16)), Limits{});
}

WitnessClient::WitnessClient(std::filesystem::path socket, Limits limits)
    : WitnessClient(std::move(socket), {}, {}, limits) {}

WitnessClient::WitnessClient(std::filesystem::path key, std::filesystem::path log, Limits limits)
    : WitnessClient({}, std::move(key), std::move(log), limits) {}

WitnessClient::WitnessClient(std::filesystem::path socket, std::filesystem::path key,
                             std::filesystem::path log, Limits limits)
    : socket_(std::move(socket)), key_(std::move(key)), log_(std::move(log)), limits_(limits) {
  public_pem_ = member(ask(R"({"do":"who"})").json, "public");
  if (public_pem_.empty()) throw WitnessRefusal("the witness has answered without its public key");
}

WitnessClient::~WitnessClient() = default;

WitnessedLine WitnessClient::begin(const std::string& run, const std::string& bench,
                                   const std::string& person, const std::string& head, bool simulated) {
  WitnessRequest request;
  request.what = WitnessAct::kBegin;
  request.run = run;
  request.bench = bench;
  request.person = person;
  request.head = head;
  request.simulated = simulated;
  return sign(request);
}

WitnessedLine WitnessClient::close(const std::string& run, std::int64_t dwells, const std::string& now,
                                   const std::string& events) {
  WitnessRequest request;
  request.what = WitnessAct::kClose;
  request.run = run;
  request.k = dwells;
  request.now = now;
  request.events = events;
  return sign(request);
}

WitnessedLine WitnessClient::head(const std::string& register_identity, std::int64_t entries,
                                  const std::string& head) {
  WitnessRequest request;
  request.what = WitnessAct::kHead;
  request.register_identity = register_identity;
  request.entries = entries;
  request.head = head;
  return sign(request);
}

std::optional<WitnessedLine> WitnessClient::fetch(const std::string& run, WitnessAct act, std::int64_t k) {
  return fetch_stored(run, act, k);
}

std::optional<WitnessedLine> WitnessClient::fetch_latest_head(const std::string& register_identity) {
  return fetch_stored(register_identity, WitnessAct::kHead, std::nullopt);
}

/// @param k  absent: the line with the highest number
std::optional<WitnessedLine> WitnessClient::fetch_stored(const std::string& run, WitnessAct act,
                                                         std::optional<std::int64_t> k) {
  Json question = {{"do", "fetch"}, {"run", run}, {"act", to_string(act)}};
  if (k) question["k"] = *k;
  const std::string words = json_text(question);
  std::optional<WitnessedLine> line = line_of(ask(words), words);
  if (!line) return std::nullopt;
  const WitnessStatement found = parse_witness_line(line->line);
  const bool is_head = act == WitnessAct::kHead;
  const bool is_number = !k || (is_head ? found.entries == *k : act != WitnessAct::kLink || found.k == *k);
  if (found.what != act || (is_head ? found.register_identity : found.run) != run || !is_number)
    refuse_line(words, line->line);
  return line;
}

WitnessedLine WitnessClient::sign(const WitnessRequest& request) {
  try {
    require_valid(request);
  } catch (const std::invalid_argument& problem) {
    throw WitnessRefusal(problem.what());
  }
  const std::string question = to_json(request);
  std::optional<WitnessedLine> line = line_of(ask(question), question);
  if (!line) refuse_line(question, "");
  if (static_cast<const WitnessRequest&>(parse_witness_line(line->line)) != request)
    refuse_line(question, line->line);
  return *std::move(line);
}

/// A line that the witness has signed. @return nullopt if the witness has none
std::optional<WitnessedLine> WitnessClient::line_of(const Answer& answer, const std::string& question) const {
  if (answer.json.contains("none")) return std::nullopt;
  WitnessedLine line{member(answer.json, "line"), bytes_of(member(answer.json, "signature"))};
  if (!is_witnessed_by(line, public_pem_))
    throw WitnessRefusal(
        "the witness has answered with a line that is not signed by its key; required: the same witness as "
        "at the beginning");
  try {
    (void)parse_witness_line(line.line);
  } catch (const std::invalid_argument&) {
    refuse_line(question, line.line);
  }
  return line;
}

// ---- Questions

/// Asks until the deadline. A connection from before may have been closed by the witness: then once more.
WitnessClient::Answer WitnessClient::ask(const std::string& question) {
  const Instant deadline = Instant::clock::now() + limits_.answer;
  std::unique_ptr<Connection> connection;
  {
    std::unique_lock lock(mutex_);
    if (!changed_.wait_until(lock, deadline, [&] { return !is_asking_; })) throw WitnessSilent(kSilent);
    is_asking_ = true;
    connection = std::move(connection_);
  }
  // A late answer must not be taken for that to another question: the connection ends.
  const auto give_back = [&](std::unique_ptr<Connection> kept) {
    connection.reset();
    const std::lock_guard lock(mutex_);
    connection_ = std::move(kept);
    is_asking_ = false;
    changed_.notify_all();
  };
  std::optional<std::string> packet;
  try {
    if (connection) packet = connection->ask(question, deadline);
    if (!packet) {
      connection.reset();
      connection = connect();
      packet = connection->ask(question, is_beside() ? Instant::clock::now() + limits_.start : deadline);
    }
    if (!packet) throw WitnessSilent("the witness has closed the connection without an answer");
  } catch (...) {
    give_back(nullptr);
    throw;
  }
  give_back(std::move(connection));
  Answer answer{Json::parse(*packet, nullptr, false)};
  const auto ok = answer.json.is_object() ? answer.json.find("ok") : answer.json.end();
  if (ok == answer.json.end() || !ok->is_boolean())
    throw WitnessRefusal("the witness has answered something else than a JSON object with \"ok\"");
  if (ok->get<bool>()) return answer;
  if (answer.json.contains("again")) throw WitnessSilent(member(answer.json, "why"));
  throw WitnessRefusal(member(answer.json, "why"));
}

std::unique_ptr<WitnessClient::Connection> WitnessClient::connect() const {
  if (is_beside()) return std::make_unique<Connection>(key_, log_);
  try {
    return std::make_unique<Connection>(socket_);
  } catch (const std::runtime_error& problem) {
    throw WitnessSilent(problem.what());
  }
}

// ---- Links in the background

void WitnessClient::post_link(const std::string& run, std::int64_t k, const std::string& previous,
                              const std::string& now) {
  WitnessRequest request;
  request.what = WitnessAct::kLink;
  request.run = run;
  request.k = k;
  request.previous = previous;
  request.now = now;
  const std::lock_guard lock(mutex_);
  posted_.push_back(std::move(request));
  changed_.notify_all();
  if (!worker_.joinable()) worker_ = std::jthread([this](const std::stop_token& stop) { work(stop); });
}

std::vector<LinkAnswer> WitnessClient::take_answers() {
  const std::lock_guard lock(mutex_);
  return std::exchange(answers_, {});
}

bool WitnessClient::wait_until_answered(std::chrono::milliseconds longest) {
  std::unique_lock lock(mutex_);
  return changed_.wait_for(lock, longest, [&] { return posted_.empty(); });
}

void WitnessClient::work(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (changed_.wait(lock, stop, [&] { return !posted_.empty(); }) && !stop.stop_requested()) {
    const WitnessRequest request = posted_.front();
    LinkAnswer answer{request.k, std::nullopt, {}};
    lock.unlock();
    try {
      answer.line = sign(request);
    } catch (const WitnessRefusal& refused) {
      answer.refusal = refused.what();
    } catch (const std::exception&) {  // Silent: the same link again, later.
    }
    lock.lock();
    if (!answer.line && answer.refusal.empty()) {
      changed_.wait_for(lock, stop, limits_.again, [] { return false; });
      continue;
    }
    answers_.push_back(std::move(answer));
    posted_.pop_front();
    changed_.notify_all();
  }
}

}  // namespace abcal
