// The service of a witness: several clients, and clients that send anything.
#include "app/witness/witness_service.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "protocol/record/sqlite.h"
#include "tests/app/witness/witness_fixtures.h"
#include "tests/support/program.h"

namespace abcal {
namespace {

using Json = nlohmann::json;
using testing::HasSubstr;
using testing::IsEmpty;

class WitnessServiceTest : public WitnessTest {
 protected:
  Descriptor connect() const { return connect_to(socket, ChannelKind::kPackets); }

  std::optional<ServedWitness> served{std::in_place, open_log(), socket};
};

TEST_F(WitnessServiceTest, SaysWhoItIs) {
  const Descriptor client = connect();
  const Json who = ask_witness(client, kWho);
  EXPECT_EQ(who.at("ok"), true);
  EXPECT_EQ(who.at("public"), public_pem);
  EXPECT_EQ(who.at("fingerprint"), fingerprint_of(public_pem));
}

TEST_F(WitnessServiceTest, SignsWithTheUserOfTheOtherEnd) {
  const Descriptor client = connect();
  const Json answer = ask_witness(client, to_json(begin_request()));
  ASSERT_EQ(answer.at("ok"), true) << answer;
  EXPECT_EQ(parse_witness_line(answer.at("line")).uid, ::geteuid());
  EXPECT_EQ(answer.at("signature").get<std::string>().size(), 128U);
  Json pretended = Json::parse(to_json(link_request(1)));
  pretended["uid"] = 12345;
  EXPECT_THAT(ask_witness(client, pretended.dump()).at("why"), HasSubstr("\"uid\""));
}

TEST_F(WitnessServiceTest, AnswersOnlyTheUsersThatItsConfigurationNames) {
  served.reset();
  served.emplace(open_log(), socket, std::set<std::uint32_t>{::geteuid() + 1});
  const Descriptor client = connect();
  EXPECT_EQ(ask_witness(client, kWho).at("ok"), true);
  EXPECT_THAT(ask_witness(client, to_json(begin_request())).at("why"),
              HasSubstr("does not answer the user with the ID " + std::to_string(::geteuid())));
  EXPECT_EQ(ask_witness(client, R"({"do":"fetch","run":"run-1","act":"begin","k":0})").at("ok"), false);
  served.reset();
  served.emplace(open_log(), socket, std::set<std::uint32_t>{::geteuid()});
  EXPECT_EQ(ask_witness(connect(), to_json(begin_request())).at("ok"), true);
}

TEST_F(WitnessServiceTest, FetchesWhatIsStored) {
  const Descriptor client = connect();
  const auto fetch = [&](const std::string& run, const char* act, const std::optional<int>& k) {
    Json question = {{"do", "fetch"}, {"run", run}, {"act", act}};
    if (k) question["k"] = *k;
    return ask_witness(client, question.dump());
  };
  const Json signed_head = ask_witness(client, to_json(head_request(5)));
  ask_witness(client, to_json(begin_request()));
  const Json signed_link = ask_witness(client, to_json(link_request(1)));
  ASSERT_EQ(signed_link.at("ok"), true);
  EXPECT_EQ(fetch("run-1", "link", 1), signed_link);
  EXPECT_EQ(fetch("register-1", "head", std::nullopt), signed_head);
  EXPECT_EQ(fetch("run-1", "link", 2), Json({{"ok", true}, {"none", true}}));
  EXPECT_EQ(fetch("register-2", "head", std::nullopt), Json({{"ok", true}, {"none", true}}));
  EXPECT_EQ(fetch("run-1", "end", 1).at("ok"), false);
  EXPECT_THAT(ask_witness(client, R"({"do":"fetch","run":"run-1","act":"link","k":"1"})").at("why"),
              HasSubstr("\"k\""));
}

TEST_F(WitnessServiceTest, ServesSeveralClientsAtATime) {
  constexpr int kClients = 5, kLinks = 20;
  std::vector<std::thread> clients;
  std::vector<int> good(kClients);
  for (int c = 0; c < kClients; ++c)
    clients.emplace_back([&, c] {
      const std::string run = "run-" + std::to_string(c);
      const Descriptor client = connect();
      std::vector<WitnessRequest> requests{begin_request(run)};
      for (int k = 1; k <= kLinks; ++k) requests.push_back(link_request(k, run));
      requests.push_back(close_request(kLinks, run));
      for (const WitnessRequest& request : requests) {
        const Json answer = ask_witness(client, to_json(request));
        const WitnessStatement found = parse_witness_line(answer.at("line"));
        if (static_cast<const WitnessRequest&>(found) == request) ++good[static_cast<std::size_t>(c)];
      }
    });
  for (std::thread& client : clients) client.join();
  EXPECT_THAT(good, testing::Each(kLinks + 2));
  served.reset();
  const std::unique_ptr<WitnessLog> log = open_log();
  EXPECT_EQ(log->size(), kClients * (kLinks + 2));
  EXPECT_THAT(log->verify(), IsEmpty());
}

TEST_F(WitnessServiceTest, RefusesRubbishAndServesOn) {
  const Descriptor client = connect(), other = connect();
  for (const std::string& rubbish :
       {std::string("rubbish"), std::string("\0\xff\xfe", 3), std::string("{}"), std::string("[]"),
        std::string("null"), std::string(R"({"do":17})"), std::string(R"({"do":"begin"})"),
        std::string(R"({"do":"begin","run":"\ud800"})"), std::string(R"({"do":"fetch"})"),
        std::string(R"({"do":"link","run":{"k":1}})"), std::string(60'000, '['),
        "{\"" + std::string(60'000, '\x01') + "\":1}", std::string(kLongestWitnessPacket, 'x'),
        std::string(kLongestWitnessPacket + 1, 'x'), std::string(2 * kLongestWitnessPacket, 'x')}) {
    const Json answer = ask_witness(client, rubbish);
    ASSERT_TRUE(answer.is_object()) << rubbish.substr(0, 100);
    EXPECT_EQ(answer.at("ok"), false) << rubbish.substr(0, 100);
    EXPECT_FALSE(answer.contains("again")) << "a repetition would be refused as well";
    EXPECT_FALSE(answer.at("why").get<std::string>().empty());
    EXPECT_EQ(ask_witness(other, kWho).at("ok"), true);
  }
  EXPECT_THAT(ask_witness(client, std::string(kLongestWitnessPacket + 1, 'x')).at("why"),
              HasSubstr("found a packet of 65537 bytes; required: at most 65536"));
  std::string long_name = to_json(begin_request());
  long_name.insert(1, '"' + std::string(50'000, 'x') + "\":1,");
  const std::string why = ask_witness(client, long_name).at("why");
  EXPECT_THAT(why, HasSubstr("xxxx"));
  EXPECT_LT(why.size(), 5'000U);
  served.reset();
  EXPECT_EQ(open_log()->size(), 0);
}

TEST_F(WitnessServiceTest, AClientThatDoesNotReadIsDisconnected) {
  const Descriptor deaf = connect(), other = connect();
  pollfd room{.fd = deaf.number(), .events = POLLOUT, .revents = 0};
  int sent = 0;
  while (send_packet(deaf.number(), kWho)) {
    ASSERT_LT(++sent, 1'000'000);
    ASSERT_EQ(::poll(&room, 1, 60'000), 1) << "the service does not read";
  }
  EXPECT_EQ(ask_witness(other, kWho).at("ok"), true);
}

TEST_F(WitnessServiceTest, AnEndedClientLeavesNothing) {
  for (int k = 0; k < 100; ++k) (void)send_packet(connect().number(), kWho);
  const Descriptor empty = connect(), other = connect();
  EXPECT_EQ(ask_witness(empty, ""), Json(nullptr)) << "an empty packet is the end";
  EXPECT_EQ(ask_witness(other, kWho).at("ok"), true);
}

TEST_F(WitnessServiceTest, OneClientTooManyTakesThePlaceOfTheMostSilentOne) {
  std::vector<Descriptor> clients;
  // The owner is a client, too.
  for (std::size_t k = 1; k < WitnessService::kMostClients; ++k) {
    clients.push_back(connect());
    ASSERT_EQ(ask_witness(clients.back(), kWho).at("ok"), true);
  }
  ASSERT_EQ(ask_witness(clients[0], kWho).at("ok"), true);
  const Descriptor late = connect();
  EXPECT_EQ(ask_witness(late, kWho).at("ok"), true);
  EXPECT_EQ(ask_witness(clients[1], kWho), Json(nullptr)) << "the most silent one";
  EXPECT_EQ(ask_witness(clients[0], kWho).at("ok"), true);
  EXPECT_EQ(ask_witness(clients[2], kWho).at("ok"), true);
  EXPECT_EQ(ask_witness(served->owner(), kWho).at("ok"), true);
}

TEST_F(WitnessServiceTest, AsksForPatienceWhenItsLogCannotBeWritten) {
  served.reset();
  file = folder / "witness\xff.db";  // The reason names the file, and an answer is UTF-8.
  served.emplace(open_log(), socket);
  const Descriptor client = connect();
  SqliteDatabase other(file, SqliteDatabase::Mode::kReadWrite);
  other.execute("alter table answer rename to hidden");
  const Json answer = ask_witness(client, to_json(begin_request()));
  EXPECT_EQ(answer.at("ok"), false);
  EXPECT_EQ(answer.value("again", false), true) << answer;
  other.execute("alter table hidden rename to answer");
  EXPECT_EQ(ask_witness(client, to_json(begin_request())).at("ok"), true);
}

TEST_F(WitnessServiceTest, IsThereForAllUsersAndOnce) {
  struct stat facts {};
  ASSERT_EQ(::stat(socket.c_str(), &facts), 0);
  EXPECT_EQ(facts.st_mode & 0777U, 0666U);
  try {
    ServedWitness(open_log(), socket);
    ADD_FAILURE() << "two services on one socket";
  } catch (const std::runtime_error& problem) {
    EXPECT_THAT(problem.what(), HasSubstr("another process serves this socket"));
  }
  const Descriptor client = connect();
  EXPECT_EQ(ask_witness(client, kWho).at("ok"), true);
  served.reset();
  EXPECT_FALSE(std::filesystem::exists(socket));
}

TEST_F(WitnessServiceTest, TheSocketOfAKilledServiceIsReplacedAndNoOtherFile) {
  served.reset();
  (void)listen_as_witness(socket);  // Closed, but not removed.
  ASSERT_TRUE(std::filesystem::exists(socket));
  served.emplace(open_log(), socket);
  const Descriptor client = connect();
  EXPECT_EQ(ask_witness(client, kWho).at("ok"), true);
  test::write_file(folder / "key.pem", key);
  EXPECT_THROW((void)listen_as_witness(folder / "key.pem"), std::runtime_error);
  EXPECT_EQ(test::read_file(folder / "key.pem"), key);
  EXPECT_THROW((void)listen_as_witness(folder / std::string(200, 'x')), std::runtime_error);
}

}  // namespace
}  // namespace abcal
