// The client of a witness, with a witness that is silent, killed, started again, or lies.
#include "app/witness/witness_client.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <pwd.h>
#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "app/system/helper_program.h"
#include "app/system/private_file.h"
#include "protocol/record/signature.h"
#include "tests/app/witness/witness_fixtures.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

/// Long enough for a busy machine; no test that passes waits for it.
constexpr auto kLong = 60s;
/// Time until a witness that never answers is given up.
constexpr auto kShort = 500ms;

constexpr WitnessClient::Limits kPatient{.answer = kLong, .start = kLong, .again = 1ms};
constexpr WitnessClient::Limits kImpatient{.answer = kShort, .start = kLong, .again = 1ms};

/// A witness that answers as a test says: nothing: it closes the connection; empty: it is silent.
class ScriptedWitness {
 public:
  using Reply = std::function<std::optional<std::string>(const std::string& question)>;

  ScriptedWitness(const std::filesystem::path& path, Reply reply)
      : reply_(std::move(reply)), listener_(listen_as_witness(path)) {
    std::array<int, 2> ends{};
    if (::pipe(ends.data()) != 0) throw std::runtime_error("no pipe");
    end_ = Descriptor(ends[1]);
    thread_ = std::thread([this, ended = Descriptor(ends[0])] { serve(ended); });
  }
  ScriptedWitness(const ScriptedWitness&) = delete;
  ScriptedWitness& operator=(const ScriptedWitness&) = delete;
  ~ScriptedWitness() {
    end_.close();
    thread_.join();
  }

 private:
  void serve(const Descriptor& ended) {
    std::vector<Descriptor> clients;
    for (;;) {
      std::vector<pollfd> waiting{{.fd = ended.number(), .events = POLLIN, .revents = 0},
                                  {.fd = listener_.number(), .events = POLLIN, .revents = 0}};
      for (const Descriptor& client : clients)
        waiting.push_back({.fd = client.number(), .events = POLLIN, .revents = 0});
      ::poll(waiting.data(), waiting.size(), -1);
      if (waiting[0].revents != 0) return;
      for (std::size_t k = 2; k < waiting.size(); ++k) {
        if (waiting[k].revents == 0) continue;
        const auto question = receive_witness_packet(waiting[k].fd);
        const auto reply = question ? reply_(*question) : std::nullopt;
        if (!reply)
          clients[k - 2].close();
        else if (!reply->empty())
          (void)send_packet(waiting[k].fd, *reply);
      }
      std::erase_if(clients, [](const Descriptor& client) { return client.number() < 0; });
      if (waiting[1].revents != 0)
        clients.emplace_back(::accept4(listener_.number(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    }
  }

  Reply reply_;
  Descriptor listener_, end_;
  std::thread thread_;
};

class WitnessClientTest : public WitnessTest {
 protected:
  WitnessClientTest() {
    set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
    write_private_file(key_file, key);
  }
  ~WitnessClientTest() override {
    for (const char* name : {"ABCAL_WITNESS", "ABCAL_SIGNING_KEY", "XDG_STATE_HOME", "STATE_DIRECTORY"})
      ::unsetenv(name);
  }

  /// The program, which serves `path`.
  std::unique_ptr<test::Program> start(const std::filesystem::path& path) const {
    auto program = std::make_unique<test::Program>(
        helper_program("abcal-witness", "this test needs").program,
        std::vector<std::string>{"--key", key_file.string(), "--log", file.string(), "--socket",
                                 path.string(), "--user", ::getpwuid(::geteuid())->pw_name},
        folder.path());
    EXPECT_TRUE(test::wait_for([&] { return serves(path) || !program->running(); }, kLong));
    EXPECT_TRUE(program->running()) << program->err();
    return program;
  }

  static bool serves(const std::filesystem::path& path) {
    try {
      (void)connect_to(path, ChannelKind::kPackets);
      return true;
    } catch (const std::runtime_error&) {
      return false;
    }
  }

  std::unique_ptr<WitnessClient> connect(const WitnessClient::Limits& limits = kPatient) const {
    return std::make_unique<WitnessClient>(socket, limits);
  }

  static WitnessedLine begin(WitnessClient& client, const std::string& run = "run-1") {
    return client.begin(run, "left", "A. B.", link_of(run, 0), false);
  }

  static void post(WitnessClient& client, std::int64_t k, const std::string& run = "run-1") {
    client.post_link(run, k, link_of(run, k - 1), link_of(run, k));
  }

  /// The answer of an honest witness to "who".
  std::string who() const { return nlohmann::json({{"ok", true}, {"public", public_pem}}).dump(); }

  static std::string reply_with(const WitnessedLine& line) {
    std::ostringstream signature;
    for (const char byte : line.signature)
      signature << "0123456789abcdef"[static_cast<unsigned char>(byte) / 16]
                << "0123456789abcdef"[static_cast<unsigned char>(byte) % 16];
    return nlohmann::json({{"ok", true}, {"line", line.line}, {"signature", signature.str()}}).dump();
  }

  std::filesystem::path key_file = folder / "key.pem";
};

template <class Error, class Call>
std::string words_of(const Call& call) {
  try {
    (void)call();
  } catch (const Error& error) {
    return error.what();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

TEST_F(WitnessClientTest, SignsARunAndARegister) {
  const ServedWitness served(open_log(), socket);
  const std::unique_ptr<WitnessClient> client = connect();
  EXPECT_EQ(client->public_pem(), public_pem);
  EXPECT_FALSE(client->is_beside());
  const WitnessedLine begun = begin(*client);
  EXPECT_EQ(static_cast<const WitnessRequest&>(parse_witness_line(begun.line)), begin_request());
  EXPECT_TRUE(is_witnessed_by(begun, public_pem));
  for (int k = 1; k <= 3; ++k) post(*client, k);
  ASSERT_TRUE(client->wait_until_answered(kLong));
  const std::vector<LinkAnswer> answers = client->take_answers();
  ASSERT_EQ(answers.size(), 3U);
  for (int k = 1; k <= 3; ++k) {
    const LinkAnswer& answer = answers[static_cast<std::size_t>(k - 1)];
    EXPECT_EQ(answer.k, k);
    ASSERT_TRUE(answer.line) << answer.refusal;
    EXPECT_EQ(parse_witness_line(answer.line->line).now, link_of("run-1", k));
    EXPECT_EQ(client->fetch("run-1", WitnessAct::kLink, k), answer.line);
  }
  EXPECT_THAT(client->take_answers(), IsEmpty());
  const WitnessedLine closed = client->close("run-1", 3, link_of("run-1", 3), sha256_of("events"));
  EXPECT_EQ(client->fetch("run-1", WitnessAct::kClose), closed);
  EXPECT_EQ(client->fetch("run-1", WitnessAct::kBegin), begun);
  EXPECT_EQ(client->fetch("run-2", WitnessAct::kBegin), std::nullopt);
  const WitnessedLine head = client->head("register-1", 5, sha256_of("entry 5"));
  EXPECT_EQ(client->fetch_latest_head("register-1"), head);
  EXPECT_EQ(client->fetch("register-1", WitnessAct::kHead, 5), head);
  EXPECT_EQ(client->fetch_latest_head("register-2"), std::nullopt);
}

TEST_F(WitnessClientTest, PassesOnARefusal) {
  const ServedWitness served(open_log(), socket);
  const std::unique_ptr<WitnessClient> client = connect();
  EXPECT_THAT(words_of<WitnessRefusal>(
                  [&] { return client->close("run-1", 0, link_of("run-1", 0), link_of("e", 0)); }),
              HasSubstr("run-1: found no beginning"));
  EXPECT_THAT(words_of<WitnessRefusal>([&] { return client->head("register-1", 1, "no hash"); }),
              HasSubstr("\"head\""));
  begin(*client);
  post(*client, 2);
  post(*client, 1);
  ASSERT_TRUE(client->wait_until_answered(kLong));
  const std::vector<LinkAnswer> answers = client->take_answers();
  ASSERT_EQ(answers.size(), 2U);
  EXPECT_FALSE(answers[0].line);
  EXPECT_THAT(answers[0].refusal, HasSubstr("required: dwell 1"));
  EXPECT_TRUE(answers[1].line) << "a refused link does not hold up the next one";
}

TEST_F(WitnessClientTest, ASilentWitnessIsAskedAgainBeforeTheNextLink) {
  std::mutex mutex;
  bool is_silent = true;
  std::vector<std::int64_t> asked;
  std::unique_ptr<WitnessLog> log = open_log();
  const ScriptedWitness served(socket, [&](const std::string& question) -> std::optional<std::string> {
    if (question == kWho) return who();
    const std::lock_guard lock(mutex);
    const WitnessRequest request = parse_witness_request(question);
    if (request.what == WitnessAct::kLink) asked.push_back(request.k);
    if (is_silent && request.what == WitnessAct::kLink) return "";
    return reply_with(log->answer(request, 0));
  });
  const std::unique_ptr<WitnessClient> client = connect(kImpatient);
  begin(*client);
  post(*client, 1);
  post(*client, 2);
  ASSERT_TRUE(test::wait_for(
      [&] {
        const std::lock_guard lock(mutex);
        return asked.size() == 2;
      },
      kLong));
  EXPECT_FALSE(client->wait_until_answered(0ms));
  EXPECT_THAT(client->take_answers(), IsEmpty());
  {
    const std::lock_guard lock(mutex);
    EXPECT_THAT(asked, ElementsAre(1, 1));
    is_silent = false;
  }
  ASSERT_TRUE(client->wait_until_answered(kLong));
  const std::vector<LinkAnswer> answers = client->take_answers();
  ASSERT_EQ(answers.size(), 2U);
  EXPECT_EQ(answers[0].k, 1);
  EXPECT_EQ(answers[1].k, 2);
}

TEST_F(WitnessClientTest, AQuestionToASilentWitnessEnds) {
  const ScriptedWitness served(socket, [&](const std::string& question) {
    return std::optional<std::string>(question == kWho ? who() : "");
  });
  const std::unique_ptr<WitnessClient> client = connect(kImpatient);
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_THAT(words_of<WitnessSilent>([&] { return begin(*client); }), HasSubstr("does not answer"));
  EXPECT_GE(std::chrono::steady_clock::now() - begun, kShort);
  EXPECT_THAT(words_of<WitnessSilent>([&] { return client->fetch("run-1", WitnessAct::kBegin); }),
              HasSubstr("does not answer"));
}

TEST_F(WitnessClientTest, AWitnessThatCannotSignNowIsAskedAgain) {
  std::mutex mutex;
  int refused = 0;
  std::unique_ptr<WitnessLog> log = open_log();
  const ScriptedWitness served(socket, [&](const std::string& question) -> std::optional<std::string> {
    if (question == kWho) return who();
    const std::lock_guard lock(mutex);
    const WitnessRequest request = parse_witness_request(question);
    if (request.what == WitnessAct::kLink && ++refused <= 3)
      return R"({"ok":false,"again":true,"why":"the disk is full"})";
    if (request.what == WitnessAct::kClose) return R"({"ok":false,"again":true,"why":"the disk is full"})";
    return reply_with(log->answer(request, 0));
  });
  const std::unique_ptr<WitnessClient> client = connect();
  begin(*client);
  post(*client, 1);
  ASSERT_TRUE(client->wait_until_answered(kLong));
  EXPECT_TRUE(client->take_answers().at(0).line);
  EXPECT_THAT(words_of<WitnessSilent>(
                  [&] { return client->close("run-1", 1, link_of("run-1", 1), link_of("e", 0)); }),
              HasSubstr("the disk is full"));
}

/// The witness has signed, but its answer is lost.
TEST_F(WitnessClientTest, ALostAnswerIsNoLostSignature) {
  std::unique_ptr<WitnessLog> log = open_log();
  bool is_lost = false;
  const ScriptedWitness served(socket, [&](const std::string& question) -> std::optional<std::string> {
    if (question == kWho) return who();
    const WitnessRequest request = parse_witness_request(question);
    const WitnessedLine line = log->answer(request, 0);
    if (request.what == WitnessAct::kLink && !std::exchange(is_lost, true)) return std::nullopt;
    return reply_with(line);
  });
  const std::unique_ptr<WitnessClient> client = connect();
  begin(*client);
  post(*client, 1);
  post(*client, 2);
  ASSERT_TRUE(client->wait_until_answered(kLong));
  const std::vector<LinkAnswer> answers = client->take_answers();
  ASSERT_EQ(answers.size(), 2U);
  EXPECT_EQ(parse_witness_line(answers.at(0).line->line).counter, 2);
  EXPECT_EQ(parse_witness_line(answers.at(1).line->line).counter, 3);
}

TEST_F(WitnessClientTest, AWitnessThatLiesIsFound) {
  std::unique_ptr<WitnessLog> log = open_log();
  const WitnessedLine honest = log->answer(begin_request(), 0);
  const WitnessedLine of_another_run = log->answer(begin_request("run-2"), 0);
  const WitnessedLine link = log->answer(link_request(1), 0);
  const std::string other_key = make_private_key();
  WitnessedLine no_line{"run-1", sign("run-1", key)};
  std::string reply;
  const ScriptedWitness served(
      socket, [&](const std::string& question) { return std::optional(question == kWho ? who() : reply); });
  const std::unique_ptr<WitnessClient> client = connect();
  const auto refusal = [&] { return words_of<WitnessRefusal>([&] { return begin(*client); }); };
  reply = reply_with({honest.line, sign(honest.line, other_key)});
  EXPECT_THAT(refusal(), HasSubstr("not signed by its key"));
  reply = reply_with({honest.line, ""});
  EXPECT_THAT(refusal(), HasSubstr("not signed by its key"));
  reply = reply_with(of_another_run);
  EXPECT_THAT(refusal(), AllOf(HasSubstr("run-2"), HasSubstr("required: a line that says so")));
  reply = reply_with(no_line);
  EXPECT_THAT(refusal(), HasSubstr("required: a line that says so"));
  for (const char* other :
       {"rubbish", "[]", "{}", R"({"ok":1})", R"({"ok":true})", R"({"ok":true,"none":true})"}) {
    reply = other;
    EXPECT_NE(refusal(), "") << other;
  }
  reply = reply_with(link);
  for (const auto& [run, act, k] : {std::tuple{"run-2", WitnessAct::kLink, 1},
                                    {"run-1", WitnessAct::kBegin, 0},
                                    {"run-1", WitnessAct::kLink, 2},
                                    {"run-1", WitnessAct::kHead, 1}})
    EXPECT_THAT(
        words_of<WitnessRefusal>([&, run = run, act = act, k = k] { return client->fetch(run, act, k); }),
        HasSubstr("required: a line that says so"));
  reply = reply_with(honest);
  EXPECT_EQ(begin(*client), honest);
}

TEST_F(WitnessClientTest, AKilledWitnessIsAskedAgainWhenItIsBack) {
  std::unique_ptr<test::Program> service = start(socket);
  const std::unique_ptr<WitnessClient> client = connect();
  begin(*client);
  post(*client, 1);
  ASSERT_TRUE(client->wait_until_answered(kLong));
  service->signal(SIGKILL);
  service->wait();
  post(*client, 2);
  post(*client, 3);
  EXPECT_FALSE(client->wait_until_answered(0ms));
  EXPECT_THAT(words_of<WitnessSilent>([&] { return client->fetch("run-1", WitnessAct::kLink, 1); }),
              HasSubstr(socket.string()));
  service = start(socket);
  ASSERT_TRUE(client->wait_until_answered(kLong));
  EXPECT_EQ(client->take_answers().size(), 3U);
  service->signal(SIGKILL);
  service->wait();
  service = start(socket);
  const WitnessedLine closed = client->close("run-1", 3, link_of("run-1", 3), sha256_of("events"));
  EXPECT_EQ(parse_witness_line(closed.line).counter, 5) << "at the first attempt, over a new connection";
  service->signal(SIGKILL);
  service->wait();
  EXPECT_THAT(open_log()->verify(), IsEmpty());
}

TEST_F(WitnessClientTest, AFrozenWitnessIsSilentAndItsLateAnswerIsNotTakenForAnother) {
  const std::unique_ptr<test::Program> service = start(socket);
  const std::unique_ptr<WitnessClient> client = connect(kImpatient);
  service->signal(SIGSTOP);
  EXPECT_THAT(words_of<WitnessSilent>([&] { return begin(*client); }), HasSubstr("does not answer"));
  service->signal(SIGCONT);
  const std::unique_ptr<WitnessClient> patient = connect();
  EXPECT_EQ(parse_witness_line(begin(*patient, "run-2").line).run, "run-2");
  EXPECT_EQ(parse_witness_line(begin(*client, "run-3").line).run, "run-3");
}

TEST_F(WitnessClientTest, TwoProcessesWithOneLog) {
  constexpr int kLinks = 20;
  std::vector<std::thread> threads;
  std::vector<std::size_t> signed_links(2);
  for (std::size_t p = 0; p < 2; ++p)
    threads.emplace_back([&, p] {
      const std::filesystem::path path = folder / ("socket-" + std::to_string(p));
      const std::unique_ptr<test::Program> service = start(path);  // Both make the log.
      WitnessClient client(path, kPatient);
      const std::string run = "run-" + std::to_string(p);
      begin(client, run);
      for (int k = 1; k <= kLinks; ++k) post(client, k, run);
      EXPECT_TRUE(client.wait_until_answered(kLong));
      for (const LinkAnswer& answer : client.take_answers())
        signed_links[p] += answer.line.has_value() ? 1 : 0;
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_THAT(signed_links, ElementsAre(kLinks, kLinks));
  const std::unique_ptr<WitnessLog> log = open_log();
  EXPECT_EQ(log->size(), 2 * (kLinks + 1));
  EXPECT_THAT(log->verify(), IsEmpty()) << "also in the order of their times";
}

// ---- Which witness

class WitnessFindTest : public WitnessClientTest {
 protected:
  WitnessFindTest() { ::setenv("XDG_STATE_HOME", (folder / "state").c_str(), 1); }

  void SetUp() override {
    if (std::filesystem::exists(kWitnessSocket)) GTEST_SKIP() << "this computer has a witness";
  }

  std::filesystem::path state =
      folder / fmt::format("state/abcal/witness-{}.db", fingerprint_of(public_key_of(key)).substr(0, 16));
};

/// Witnesses that this process has started, by their number.
std::vector<pid_t> witnesses_beside() {
  std::vector<pid_t> found;
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    std::string text;
    std::getline(std::ifstream(entry.path() / "stat"), text);
    // "NUMBER (NAME) STATE PARENT ..."
    const std::size_t name = text.find(" (abcal-witness) ");
    if (name == std::string::npos) continue;
    std::istringstream rest(text.substr(text.rfind(')') + 1));
    std::string state;
    pid_t parent = 0;
    rest >> state >> parent;
    if (parent == ::getpid() && state != "Z") found.push_back(std::stoi(text));
  }
  return found;
}

TEST_F(WitnessFindTest, NoneIsConfigured) {
  EXPECT_EQ(WitnessClient::find(), nullptr);
  ::setenv("ABCAL_SIGNING_KEY", key_file.c_str(), 1);
  ::setenv("ABCAL_WITNESS", "none", 1);
  EXPECT_EQ(WitnessClient::find(), nullptr);
}

TEST_F(WitnessFindTest, TheStatedSocketComesFirst) {
  ::setenv("ABCAL_SIGNING_KEY", key_file.c_str(), 1);
  ::setenv("ABCAL_WITNESS", socket.c_str(), 1);
  EXPECT_THAT(words_of<WitnessSilent>([] { return WitnessClient::find(); }),
              AllOf(HasSubstr(socket.string()), HasSubstr("ABCAL_WITNESS=none")));
  (void)listen_as_witness(socket);  // Its service was killed.
  EXPECT_THAT(words_of<WitnessSilent>([] { return WitnessClient::find(); }), HasSubstr(socket.string()));
  const ServedWitness served(open_log(), socket);
  const std::unique_ptr<WitnessClient> client = WitnessClient::find();
  ASSERT_TRUE(client);
  EXPECT_FALSE(client->is_beside());
  EXPECT_THAT(witnesses_beside(), IsEmpty());
}

TEST_F(WitnessFindTest, AWitnessBesideEndsWithItsClient) {
  ::setenv("ABCAL_SIGNING_KEY", key_file.c_str(), 1);
  std::unique_ptr<WitnessClient> client = WitnessClient::find();
  ASSERT_TRUE(client);
  EXPECT_TRUE(client->is_beside());
  EXPECT_EQ(client->public_pem(), public_pem);
  EXPECT_EQ(parse_witness_line(begin(*client).line).counter, 1);
  EXPECT_EQ(std::filesystem::status(state).permissions(),
            std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  EXPECT_EQ(witnesses_beside().size(), 1U);
  client.reset();
  EXPECT_THAT(witnesses_beside(), IsEmpty());
  EXPECT_FALSE(std::filesystem::exists(state.string() + "-wal")) << "it has ended in order";
  client = WitnessClient::find();
  EXPECT_EQ(parse_witness_line(begin(*client).line).counter, 1) << "the stored line";
}

TEST_F(WitnessFindTest, AWitnessBesideThatWasKilledIsStartedAgain) {
  ::setenv("ABCAL_SIGNING_KEY", key_file.c_str(), 1);
  const std::unique_ptr<WitnessClient> client = WitnessClient::find();
  begin(*client);
  const std::vector<pid_t> first = witnesses_beside();
  ASSERT_EQ(first.size(), 1U);
  ::kill(first[0], SIGKILL);
  post(*client, 1);
  ASSERT_TRUE(client->wait_until_answered(kLong));
  EXPECT_EQ(parse_witness_line(client->take_answers().at(0).line->line).counter, 2);
  EXPECT_NE(witnesses_beside(), first);
}

TEST_F(WitnessFindTest, AWitnessBesideThatHangsIsReplaced) {
  WitnessClient client(key_file, file, kImpatient);
  const std::vector<pid_t> first = witnesses_beside();
  ASSERT_EQ(first.size(), 1U);
  ::kill(first[0], SIGSTOP);
  EXPECT_THAT(words_of<WitnessSilent>([&] { return begin(client); }), HasSubstr("does not answer"));
  EXPECT_THAT(witnesses_beside(), IsEmpty());
  EXPECT_EQ(parse_witness_line(begin(client).line).run, "run-1");
}

TEST_F(WitnessFindTest, AKeyOrALogThatCannotBeUsedIsNamed) {
  ::setenv("ABCAL_SIGNING_KEY", key_file.c_str(), 1);
  std::filesystem::permissions(key_file, std::filesystem::perms::others_read,
                               std::filesystem::perm_options::add);
  const auto find = [] { return words_of<std::invalid_argument>([] { return WitnessClient::find(); }); };
  EXPECT_THAT(find(), AllOf(HasSubstr(key_file.string()), HasSubstr("chmod 600")));
  ::setenv("ABCAL_SIGNING_KEY", (folder / "none.pem").c_str(), 1);
  EXPECT_THAT(find(), HasSubstr("none.pem"));
  write_private_file(folder / "text.pem", "text");
  ::setenv("ABCAL_SIGNING_KEY", (folder / "text.pem").c_str(), 1);
  EXPECT_THAT(find(), HasSubstr("no private Ed25519 key"));
  test::write_file(
      state, "no database, but long enough to be read as one, one hundred bytes and more of it, see here");
  write_private_file(folder / "good.pem", key);
  ::setenv("ABCAL_SIGNING_KEY", (folder / "good.pem").c_str(), 1);
  EXPECT_THAT(words_of<WitnessRefusal>([] { return WitnessClient::find(); }), HasSubstr(state.string()));
  EXPECT_THAT(witnesses_beside(), IsEmpty());
}

// ---- The program

class WitnessProgramTest : public WitnessClientTest {
 protected:
  test::ProgramResult run(const std::vector<std::string>& arguments) const {
    test::Program program(helper_program("abcal-witness", "this test needs").program, arguments,
                          folder.path());
    const int code = program.wait();
    return {code, program.out(), program.err()};
  }
};

TEST_F(WitnessProgramTest, MakesAKeyOnce) {
  const std::string new_key = (folder / "new.pem").string();
  const test::ProgramResult made = run({"--make-key", "--key", new_key});
  EXPECT_EQ(made.exit_code, 0) << made.err;
  const std::string content = read_private_file(new_key, "key");
  EXPECT_EQ(made.out, public_key_of(content));
  EXPECT_EQ(run({"--make-key", "--key", new_key}).out, made.out);
  EXPECT_EQ(read_private_file(new_key, "key"), content);
}

TEST_F(WitnessProgramTest, ChecksItsLog) {
  open_log()->answer(begin_request(), 0);
  const std::vector<std::string> check{"--check", "--key", key_file.string(), "--log", file.string()};
  const test::ProgramResult whole = run(check);
  EXPECT_EQ(whole.exit_code, 0) << whole.err;
  EXPECT_EQ(whole.out, "1 lines, whole\n");
  SqliteDatabase(file, SqliteDatabase::Mode::kReadWrite).execute("update answer set run = 'run-2'");
  const test::ProgramResult changed = run(check);
  EXPECT_EQ(changed.exit_code, 1);
  EXPECT_THAT(changed.out, HasSubstr("line 1: it stands under run run-2"));
}

TEST_F(WitnessProgramTest, RefusesWrongUsage) {
  const std::string log = file.string(), path = socket.string(), secret = key_file.string();
  for (const std::vector<std::string>& wrong :
       std::vector<std::vector<std::string>>{{},
                                             {"--key", secret},
                                             {"--key", secret, "--socket", path},
                                             {"--key", secret, "--log", log},
                                             {"--key", secret, "--log", log, "--check", "--socket", path},
                                             {"--key", secret, "--log", log, "--check", "--make-key"},
                                             {"--key", secret, "--log", log, "--check"},
                                             {"--log", log, "--check"}})
    EXPECT_NE(run(wrong).exit_code, 0) << testing::PrintToString(wrong);
  EXPECT_FALSE(std::filesystem::exists(file)) << "a check makes no log";
  EXPECT_THAT(run({"--version"}).out, HasSubstr("abcal-witness "));
}

}  // namespace
}  // namespace abcal
