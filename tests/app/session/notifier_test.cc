// Notifications of a run: their kinds, and that a receiver on this machine gets them as they were meant.

#include "app/measure/session/notifier.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/asio/ip/tcp.hpp>
#include <filesystem>
#include <future>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/system/helper_program.h"
#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using boost::asio::ip::tcp;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr const char* kUtc = "2026-01-02T03:04:05.000Z";
constexpr std::chrono::seconds kLong{30};

FinishedEvent finished() {
  FinishedEvent event;
  event.file = "/runs/a.run";
  event.complete = true;
  event.verdict = "usable";
  event.measured = event.planned = 225;
  return event;
}

/// A server on this machine that takes one connection and serves it by `talk`; heard() gives its result.
class Receiver {
 public:
  explicit Receiver(std::function<std::string(tcp::iostream& client)> talk)
      : heard_(std::async(std::launch::async, [this, talk = std::move(talk)] {
          tcp::iostream client;
          acceptor_.accept(client.socket());
          client.expires_after(kLong);
          return talk(client);
        })) {}
  std::string address(const std::string& scheme) const {
    return scheme + "://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port());
  }
  std::string heard() { return heard_.get(); }

 private:
  boost::asio::io_context io_;
  tcp::acceptor acceptor_{io_, {boost::asio::ip::address_v4::loopback(), 0}};
  std::future<std::string> heard_;
};

/// Takes a POST and answers. @return its body
std::string take_post(tcp::iostream& client, const std::string& status) {
  std::size_t size = 0;
  for (std::string line; std::getline(client, line) && line != "\r";) {
    if (line.starts_with("Content-Length: ")) size = std::stoul(line.substr(16));
  }
  std::string body(size, '\0');
  client.read(body.data(), static_cast<std::streamsize>(size));
  client << "HTTP/1.1 " << status << "\r\nContent-Length: 0\r\nConnection: close\r\n\r\n" << std::flush;
  return body;
}

/// Takes a mail (RFC 5321). @return all that the client said
std::string take_mail(tcp::iostream& client) {
  std::string all;
  bool is_data = false;
  client << "220 here\r\n" << std::flush;
  for (std::string line; std::getline(client, line);) {
    all += line + "\n";
    if (is_data && line != ".\r") continue;
    const bool begins_data = line == "DATA\r", quits = line == "QUIT\r";
    client << (begins_data ? "354 go on\r\n" : quits ? "221 bye\r\n" : "250 good\r\n") << std::flush;
    is_data = begins_data;
    if (quits) break;
  }
  return all;
}

NotifyConfig webhook(std::string address) {
  NotifyConfig config;
  config.webhook = std::move(address);
  return config;
}

class NotifierTest : public testing::Test {
 protected:
  void SetUp() override { set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path()); }
  /// Sends the messages of a run that begins and ends. @return the problems
  static std::vector<std::string> tell(const NotifyConfig& config) {
    Notifier notifier(config);
    RunBeganEvent began;
    began.file = "/runs/a.run";
    began.bench = "bench 3";
    began.item = "SN-7";
    began.operator_name = "N. N.";
    notifier.send(began, kUtc);
    notifier.send(finished(), kUtc);
    return notifier.failures(kLong);
  }
};

TEST_F(NotifierTest, FaultsAndTheEndAreMessagesAndNothingElse) {
  EXPECT_EQ(message_of(PortLostEvent{Message("/dev/ttyUSB0 vanished")})->at("event"), "port_lost");
  EXPECT_EQ(message_of(PortBackEvent{Message("it is back")})->at("event"), "port_back");
  EXPECT_EQ(message_of(NoticeEvent{"watchdog", Message("the stage was halted")})->at("text"),
            "the stage was halted");
  EXPECT_FALSE(message_of(NoticeEvent{"temperature", Message("it drifts")}));
  EXPECT_FALSE(message_of(AngleBegunEvent{3}));
  EXPECT_EQ(message_of(finished())->at("text"), "complete: usable");
  FinishedEvent early = finished();
  early.complete = false;
  early.reason = Message("the port did not come back");
  EXPECT_EQ(message_of(early)->at("text"), "ended early: the port did not come back");
}

TEST_F(NotifierTest, AWebhookGetsTheEndOfARunAsJson) {
  Receiver receiver([](tcp::iostream& client) { return take_post(client, "204 No Content"); });
  EXPECT_THAT(tell(webhook(receiver.address("http") + "/hook")), IsEmpty());
  const auto message = nlohmann::json::parse(receiver.heard());
  EXPECT_EQ(message.at("schema"), "abcal.message/1");
  EXPECT_EQ(message.at("event"), "finished");
  EXPECT_EQ(message.at("bench"), "bench 3");
  EXPECT_EQ(message.at("run"), "a.run");
  EXPECT_EQ(message.at("utc"), kUtc);
  EXPECT_EQ(message.at("planned"), 225);
}

TEST_F(NotifierTest, AReceiverThatRefusesOrIsNotThereIsAFailureWithItsReason) {
  Receiver receiver([](tcp::iostream& client) { return take_post(client, "500 No"); });
  EXPECT_THAT(tell(webhook(receiver.address("http"))), ElementsAre(HasSubstr("the webhook answers 500")));
  EXPECT_THAT(tell(webhook("http://127.0.0.1:1/")), ElementsAre(HasSubstr("connect")));
  EXPECT_THAT(tell(webhook("env:ABCAL_TEST_NO_SUCH_WEBHOOK")),
              ElementsAre(HasSubstr("ABCAL_TEST_NO_SUCH_WEBHOOK of [notify] webhook is not set")));
}

TEST_F(NotifierTest, AMailServerGetsTheSameInWords) {
  Receiver receiver(take_mail);
  NotifyConfig config;
  config.mail_to = "to@example.org";
  config.mail_from = "from@example.org\r\nBcc: other@example.org";
  config.mail_server = receiver.address("smtp");
  EXPECT_THAT(tell(config), IsEmpty());
  const std::string mail = receiver.heard();
  EXPECT_THAT(mail, HasSubstr("RCPT TO:<to@example.org>"));
  EXPECT_THAT(mail, HasSubstr("Subject: abcal bench 3: finished"));
  EXPECT_THAT(mail, HasSubstr("complete: usable"));
  EXPECT_THAT(mail, testing::Not(HasSubstr("\nBcc:")));
}

TEST_F(NotifierTest, NobodyIsToldWhereNobodyIsNamed) {
  set_helper_folder("/nowhere");
  EXPECT_THAT(tell({}), IsEmpty());
  EXPECT_THAT(tell(webhook("http://127.0.0.1:1/")), ElementsAre(HasSubstr("abcal-transfer")));
}

}  // namespace
}  // namespace abcal
