// Persons and pages that are refused: the refusal is logged, and nothing moves.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <regex>
#include <string>
#include <vector>

#include "app/console/asset.h"
#include "app/console/login_throttle.h"
#include "app/console/tls.h"
#include "app/system/real_clock.h"
#include "tests/console/console_fixture.h"

namespace abcal::console {
namespace {

using testing::HasSubstr;
using Json = test::PageClient::Json;

class SecurityTest : public ConsoleTest {
 protected:
  /// The status with which a WebSocket is declined; 101 if it is granted.
  unsigned upgrade(test::Headers headers, const std::string& target = "/live") {
    headers.insert({{"Connection", "Upgrade"},
                    {"Upgrade", "websocket"},
                    {"Sec-WebSocket-Version", "13"},
                    {"Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="}});
    return test::http_get(port, target, headers).status;
  }
  void expect_that_nothing_moved(const test::Headers& headers = {}) {
    test::PageClient page(port, headers);
    const Json snapshot = page.wait_for_type("snapshot");
    EXPECT_EQ(snapshot["activity"]["activity"], "idle");
    EXPECT_TRUE(snapshot["run"].is_null());
    EXPECT_TRUE(snapshot["stage"]["x"]["target_deg"].is_null());
    EXPECT_TRUE(snapshot["stage"]["z"]["target_deg"].is_null());
    EXPECT_EQ(run_files(), 0U);
  }
};

TEST_F(SecurityTest, ThePageAllowsNothingFromElsewhere) {
  open();
  const test::Answer answer = test::http_get(port, "/");
  ASSERT_EQ(answer.status, 200U);
  const std::string policy = answer.headers.at("Content-Security-Policy");
  EXPECT_THAT(policy, HasSubstr("default-src 'none'"));
  EXPECT_THAT(policy, HasSubstr("script-src 'self';"));
  EXPECT_THAT(policy, HasSubstr("frame-ancestors 'none'"));
  EXPECT_THAT(policy, testing::Not(HasSubstr("unsafe")));
  EXPECT_EQ(answer.headers.at("X-Content-Type-Options"), "nosniff");
  EXPECT_EQ(answer.headers.at("Referrer-Policy"), "no-referrer");
  EXPECT_EQ(answer.headers.count("Access-Control-Allow-Origin"), 0U);
  EXPECT_EQ(answer.headers.count("Strict-Transport-Security"), 0U) << "without TLS it would lock pages out";
  for (const Asset& asset : assets()) {
    EXPECT_EQ(test::http_get(port, std::string(asset.path)).body, asset.body) << asset.path;
    // A namespace is a name, no address; and stop.js asks how it was loaded itself.
    const std::string body = std::regex_replace(
        std::string(asset.body), std::regex("xmlns=\"http://www.w3.org/2000/svg\"|'https:' *\\?"), "");
    for (const char* elsewhere :
         {"=\"http", "'http", "url(", "style=\"", "onclick", "innerHTML", "<script>", "eval("})
      EXPECT_THAT(body, testing::Not(HasSubstr(elsewhere))) << asset.path;
  }
}

TEST_F(SecurityTest, AnotherPageIsRefusedAndLogged) {
  open();
  for (const char* origin : {"http://evil.example.org", "null", "http://127.0.0.1:1"}) {
    EXPECT_EQ(upgrade({{"Origin", origin}}), 403U) << origin;
    EXPECT_EQ(test::http_get(port, "/runs", {{"Origin", origin}}).status, 403U) << origin;
  }
  EXPECT_TRUE(is_logged("Another page may not use this console"));
  EXPECT_EQ(upgrade({{"Origin", "http://127.0.0.1:" + std::to_string(port)}}), 101U);
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, AnotherNameForOurAddressIsRefusedAndLogged) {
  open();
  for (const char* host : {"evil.example.org", "", "127.0.0.1:1"}) {
    EXPECT_EQ(upgrade({{"Host", host}}), 421U) << host;
    EXPECT_EQ(test::http_get(port, "/", {{"Host", host}}).status, 421U) << host;
  }
  EXPECT_TRUE(is_logged("not known by that name"));
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, WithoutTheTokenNothingIsShown) {
  options.access.token = "0123456789abcdef";
  open();
  const std::string cookie_name = "abcal_token_" + std::to_string(port);
  for (const char* path : {"/", "/app.js", "/runs", "/runs/a.run/result", "/who", "/login", "/logout"})
    EXPECT_EQ(test::http_get(port, path).status, 401U) << path;
  EXPECT_EQ(upgrade({}), 401U);
  EXPECT_EQ(upgrade({{"Authorization", "Bearer 0123456789abcdeF"}}), 401U);
  EXPECT_EQ(upgrade({{"Cookie", cookie_name + "=0123456789abcdeF"}}), 401U);
  EXPECT_EQ(upgrade({{"Cookie", cookie_name + "=0123456789abcdef0"}}), 401U);
  EXPECT_EQ(upgrade({{"Cookie", "abcal_token=0123456789abcdef"}}), 401U);
  EXPECT_TRUE(is_logged("no token"));

  // Not in the address of a request, where others may see it.
  for (const char* target : {"/?token=0123456789abcdef", "/login?token=0123456789abcdef"})
    EXPECT_EQ(test::http_get(port, target).status, 401U) << target;
  EXPECT_EQ(upgrade({}, "/live?token=0123456789abcdef"), 401U);
  for (const char* form : {"token=0123456789abcdeF", "token=", "name=N.+N.&password=0123456789abcdef", "%zz"})
    EXPECT_NE(test::http_post(port, "/login", form).status, 303U) << form;
  EXPECT_TRUE(is_logged("This is not the token"));

  const test::Answer welcome = test::http_post(port, "/login", "token=0123456789abcdef");
  ASSERT_EQ(welcome.status, 303U) << welcome.body;
  EXPECT_EQ(welcome.headers.at("Location"), "/");
  EXPECT_EQ(welcome.headers.at("Set-Cookie"),
            cookie_name + "=0123456789abcdef; HttpOnly; SameSite=Strict; Path=/; Max-Age=2592000");
  const test::Headers cookie{{"Cookie", cookie_name + "=0123456789abcdef"}};
  EXPECT_EQ(test::http_get(port, "/runs", cookie).status, 200U);
  EXPECT_EQ(upgrade(cookie), 101U);
  // The token itself is in no log, wherever it was sent.
  EXPECT_THAT(logged(), testing::Not(HasSubstr("0123456789abcde")));
  // The cookie does not let another page in.
  test::Headers elsewhere = cookie;
  elsewhere["Origin"] = "http://evil.example.org";
  EXPECT_EQ(upgrade(elsewhere), 403U);
  EXPECT_EQ(test::http_post(port, "/login", "token=0123456789abcdef", {{"Origin", "http://evil.example.org"}})
                .status,
            403U);
  expect_that_nothing_moved(cookie);
}

TEST_F(SecurityTest, WhoGuessesTheTokenHasToWait) {
  options.access.token = "0123456789abcdef";
  open();
  for (int i = 0; i < LoginThrottle::kFree; ++i)
    EXPECT_EQ(test::http_post(port, "/login", "token=guess").status, 401U) << i;
  const test::Answer slowed = test::http_post(port, "/login", "token=0123456789abcdef");
  EXPECT_EQ(slowed.status, 429U);
  EXPECT_EQ(slowed.headers.at("Retry-After"), "1");
}

TEST_F(SecurityTest, OthersThanThisComputerGetNothingWithoutTlsAndWithoutSayingWhoTheyAre) {
  std::filesystem::create_directories(runs());
  const auto refusal = [&](const ServerOptions& tried) -> std::string {
    try {
      const Server server(tried, Session::Options{folder / "bench.toml", runs(), pace});
      return "started";
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
  };
  ServerOptions everywhere = options;
  everywhere.address = "0.0.0.0";
  everywhere.access.token = "0123456789abcdef";
  EXPECT_THAT(refusal(everywhere), HasSubstr("without TLS"));
  everywhere.access.token.clear();
  everywhere.tls = own_tls_identity(folder.path(), {"localhost"}, RealClock().utc_now());
  EXPECT_THAT(refusal(everywhere), HasSubstr("required: a token or a register"));
  ServerOptions proxied = options;
  proxied.access.hosts = {"bench.example.org"};
  EXPECT_THAT(refusal(proxied), HasSubstr("reaches a proxy"));
  proxied = options;
  proxied.trusted_proxies = {"127.0.0.1"};
  EXPECT_THAT(refusal(proxied), HasSubstr("reaches a proxy"));
}

TEST_F(SecurityTest, WhatAProxyPassesOnToAConsoleOfThisComputerAloneIsRefused) {
  open();
  for (const char* header : {"Forwarded", "X-Forwarded-For", "X-Real-IP", "Via"}) {
    EXPECT_EQ(test::http_get(port, "/", {{header, "for=192.0.2.1"}}).status, 403U) << header;
    EXPECT_EQ(upgrade({{header, "192.0.2.1"}}), 403U) << header;
  }
  EXPECT_TRUE(is_logged("see `abcal serve --trusted-proxy`"));
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, OnlyATrustedProxySaysWhereARequestComesFrom) {
  options.access.token = "0123456789abcdef";
  options.access.hosts = {"bench.example.org"};
  options.trusted_proxies = {"127.0.0.1"};
  open();
  const auto guess = [&](const char* client, const char* token) {
    return test::http_post(port, "/login", std::string("token=") + token,
                           {{"Host", "bench.example.org"},
                            {"X-Forwarded-For", client},
                            {"Origin", "https://bench.example.org"}});
  };
  for (int i = 0; i < LoginThrottle::kFree; ++i) EXPECT_EQ(guess("192.0.2.1", "guess").status, 401U);
  EXPECT_EQ(guess("192.0.2.1", "0123456789abcdef").status, 429U);
  // Addresses before the one that the proxy wrote can be forged.
  EXPECT_EQ(guess("198.51.100.7, 192.0.2.1", "0123456789abcdef").status, 429U);
  const test::Answer other = guess("192.0.2.2", "0123456789abcdef");
  EXPECT_EQ(other.status, 303U);
  EXPECT_THAT(other.headers.at("Set-Cookie"), HasSubstr("; Secure")) << "the browser speaks TLS to the proxy";
  EXPECT_TRUE(is_logged("refused from 192.0.2.1 by 127.0.0.1:"));
}

TEST_F(SecurityTest, ANoteCannotTurnTheDirectionOfWriting) {
  open();
  auto page = steering_page();
  for (const char* turned : {"\u202egnp.run", "a \u2066b", "\u200f", "\u061c"}) {
    const Json reply = page->ask({{"do", "note"}, {"text", turned}});
    EXPECT_FALSE(reply["ok"].get<bool>());
    EXPECT_THAT(reply["why"].get<std::string>(), HasSubstr("direction of writing"));
  }
  // Other notes get the reply that no run is in progress.
  EXPECT_THAT(page->ask({{"do", "note"}, {"text", "Tür \u05e9\u05dc\u05d5\u05dd"}})["why"].get<std::string>(),
              HasSubstr("no run is in progress"));
}

TEST_F(SecurityTest, NamesThatTurnTheDirectionOfWritingAreShownAsTheyAre) {
  std::filesystem::create_directories(runs());
  test::write_file(runs() / "a\u202enur.run", "nothing");
  open();
  const std::string list = test::http_get(port, "/runs").body;
  EXPECT_THAT(list, HasSubstr("a[U+202E]nur.run"));
  EXPECT_THAT(list, testing::Not(HasSubstr("\u202e")));
}

TEST_F(SecurityTest, NoPathLeadsOutOfTheRunFolder) {
  test::write_file(folder / "secret.run", "secret");
  test::write_file(folder / "secret.txt", "secret");
  std::filesystem::create_directories(runs() / "inside.run");
  test::write_file(runs() / "inside.run" / "secret.run", "secret");
  test::write_file(runs() / "notes.txt", "secret");
  std::filesystem::create_symlink(folder / "secret.run", runs() / "link.run");
  open();
  for (const char* path : {"/../bench.toml",
                           "/runs/../secret.run/result",
                           "/runs/..%2fsecret.run/result",
                           "/runs/%2e%2e%2fsecret.run/readings.csv",
                           "/runs/..%5csecret.run/result",
                           "/runs//result",
                           "/runs/./result",
                           "/runs/inside.run/result",
                           "/runs/inside.run%2fsecret.run/result",
                           "/runs/link.run/result",
                           "/runs/link.run/readings.csv",
                           "/runs/notes.txt/result",
                           "/runs/secret.run%00/result",
                           "//etc/passwd",
                           "/runs/%/result",
                           "/runs/%zz/result",
                           "/etc/passwd",
                           "http://127.0.0.1/runs",
                           "/runs/\xff/result",
                           "/index.html/../../bench.toml",
                           "/live",
                           "*"}) {
    const test::Answer answer = test::http_get(port, path);
    EXPECT_TRUE(answer.status == 404 || answer.status == 400) << path << ": " << answer.status;
    EXPECT_THAT(answer.body, testing::Not(HasSubstr("secret"))) << path;
    EXPECT_THAT(answer.body, testing::Not(HasSubstr("g_loc"))) << path;
  }
  EXPECT_TRUE(is_logged("There is no such page"));
  EXPECT_EQ(Json::parse(test::http_get(port, "/runs").body), Json::array());
  auto page = steering_page();
  for (const char* run : {"../secret.run", "link.run", "/etc/passwd", "", ".", "inside.run", "secret.run"})
    EXPECT_FALSE(page->ok({{"do", "resume"}, {"run", run}, {"confirmed", true}})) << run;
  EXPECT_TRUE(is_logged("there is no such run in the run folder"));
}

TEST_F(SecurityTest, RefusesWhatIsNoRequest) {
  open();
  const std::string host = "Host: 127.0.0.1:" + std::to_string(port) + "\r\n";
  const auto status = [&](const std::string& bytes) {
    test::RawConnection connection(port);
    connection.send(bytes);
    return connection.answer().status;
  };
  EXPECT_EQ(status("nonsense\r\n\r\n"), 400U);
  EXPECT_EQ(status("GET / HTTP/9.9\r\n\r\n"), 400U);
  EXPECT_EQ(status("GET /\x01 HTTP/1.1\r\n" + host + "\r\n"), 400U);
  EXPECT_EQ(status("GET / HTTP/1.1\r\n" + host + "X: " + std::string(20'000, 'a') + "\r\n\r\n"), 431U);
  EXPECT_EQ(status("GET /" + std::string(20'000, 'a') + " HTTP/1.1\r\n" + host + "\r\n"), 431U);
  EXPECT_EQ(status("POST / HTTP/1.1\r\n" + host + "Content-Length: 99999999\r\n\r\n"), 413U);
  // Only a person who hands in a signed certificate may send more.
  for (const char* path : {"/", "/approve", "/runs/a.run/signed-certificate"}) {
    EXPECT_EQ(status(std::string("POST ") + path + " HTTP/1.1\r\n" + host + "Content-Length: 2000\r\n\r\n"),
              413U);
    EXPECT_EQ(status(std::string("POST ") + path + " HTTP/1.1\r\n" + host +
                     "Transfer-Encoding: chunked\r\n\r\n7d0\r\n" + std::string(2000, 'x') + "\r\n"),
              413U);
  }
  EXPECT_EQ(status("POST / HTTP/1.1\r\n" + host + "Content-Length: 0\r\n\r\n"), 405U);
  EXPECT_EQ(status("DELETE /runs HTTP/1.1\r\n" + host + "\r\n"), 405U);
  for (const char* why : {"Only GET is answered here", "header limit", "body limit", "bad version"})
    EXPECT_TRUE(is_logged(why)) << why;
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, ATargetInAbsoluteFormIsServedIfItsHostIsOursAndThatOfTheHeader) {
  open();
  const std::string ours = "127.0.0.1:" + std::to_string(port);
  const auto status = [&](const std::string& target, const std::string& host) {
    test::RawConnection connection(port);
    connection.send("GET " + target + " HTTP/1.1\r\nHost: " + host + "\r\n\r\n");
    return connection.answer().status;
  };
  const unsigned page = status("/", ours);
  EXPECT_EQ(page, 200U);
  for (const std::string& target : {"http://" + ours + "/", "http://" + ours, "HTTP://" + ours + "/?a=b"})
    EXPECT_EQ(status(target, ours), page) << target;
  EXPECT_EQ(status("http://" + ours + "/nothing", ours), 404U);
  EXPECT_EQ(status("http://elsewhere.example/", "elsewhere.example"), 421U) << "a host that is not ours";
  EXPECT_EQ(status("http://" + ours + "/", "elsewhere.example"), 421U);
  for (const std::string& target :
       {std::string("http://elsewhere.example/"), "http://a@" + ours + "/", "http://" + ours + ".example/",
        std::string("http:///"), "ftp://" + ours + "/", "http:/" + ours + "/"})
    EXPECT_EQ(status(target, ours), 400U) << target;
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, RefusesMessagesThatAreNoRequests) {
  open();
  auto page = steering_page();
  for (const char* text : {"", "{", "[]", "null", R"({"do":"start"})",
                           R"({"do":"jog","axis":"x","by_deg":1e999,"confirmed":true})",
                           R"({"do":"start","confirmed":true,"and":1})"}) {
    page->send(text);
    const Json reply = page->wait_for_type("reply");
    EXPECT_EQ(reply["ok"], false) << text;
    EXPECT_NE(reply["why"], "") << text;
  }
  EXPECT_TRUE(is_logged("required: \"confirmed\": true"));
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, AnOversizedMessageEndsTheConnection) {
  open();
  auto page = steering_page();
  page->send(std::string(5000, ' '));
  EXPECT_TRUE(page->wait_for_end());
  EXPECT_TRUE(is_logged("longer than 4096 bytes"));
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, AWatchingPageCannotSteer) {
  open();
  test::PageClient watcher(port);
  for (const Json& request :
       std::vector<Json>{{{"do", "start"}, {"confirmed", true}},
                         {{"do", "jog"}, {"axis", "x"}, {"by_deg", 5}, {"confirmed", true}},
                         {{"do", "check"}},
                         {{"do", "stop"}},
                         {{"do", "hold"}},
                         {{"do", "note"}, {"text", "x"}},
                         {{"do", "control"}, {"release", true}}})
    EXPECT_FALSE(watcher.ok(request)) << request;
  EXPECT_TRUE(is_logged("only watches"));
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, OnePageSteersAtATime) {
  open();
  auto first = steering_page();
  test::PageClient second(port);
  EXPECT_THAT(second.ask({{"do", "control"}})["why"].get<std::string>(),
              HasSubstr("take control from it first"));
  EXPECT_TRUE(second.ok({{"do", "control"}, {"from_another", true}}));
  EXPECT_FALSE(first->ok({{"do", "check"}}));
  EXPECT_TRUE(second.ok({{"do", "control"}, {"release", true}}));
  EXPECT_TRUE(first->ok({{"do", "control"}}));
  // A page that is gone steers no longer.
  first.reset();
  EXPECT_TRUE(test::wait_for([&] { return second.ok({{"do", "control"}}); }, test::kPatience));
}

TEST_F(SecurityTest, SilentConnectionsLockOutNobody) {
  open();  // With the default limits and times.
  std::vector<std::unique_ptr<test::RawConnection>> silent;
  for (int i = 0; i < 100; ++i) silent.push_back(std::make_unique<test::RawConnection>(port));
  const auto begun = std::chrono::steady_clock::now();
  // Also of the same address: the oldest gives way.
  EXPECT_EQ(test::http_get(port, "/").status, 200U);
  expect_that_nothing_moved();
  EXPECT_LT(std::chrono::steady_clock::now() - begun, options.request_time / 2);
  EXPECT_TRUE(silent.front()->closed());
  EXPECT_TRUE(is_logged("the oldest was ended"));
}

TEST_F(SecurityTest, SilentConnectionsAreEndedInTime) {
  options.request_time = std::chrono::seconds(1);
  open();
  test::RawConnection half(port), silent(port);
  half.send("GET / HTTP/1.1\r\n");  // The rest is never sent.
  EXPECT_TRUE(half.closed());
  EXPECT_TRUE(silent.closed());
  EXPECT_TRUE(is_logged("not complete after 1 s"));
}

TEST_F(SecurityTest, ConnectionsThatWereLetInAreLimitedInNumber) {
  options.most_connections = 3;
  options.most_of_address = 2;
  open();
  std::vector<std::unique_ptr<test::PageClient>> pages;
  for (int i = 0; i < 2; ++i) pages.push_back(std::make_unique<test::PageClient>(port));
  EXPECT_EQ(test::http_get(port, "/").status, 503U);
  EXPECT_TRUE(is_logged("there are 2 connections already"));
  pages.pop_back();
  EXPECT_TRUE(test::wait_for([&] { return test::http_get(port, "/").status == 200; }, test::kPatience));
}

TEST_F(SecurityTest, ARequestThatComesByteByByteIsCutOffAndHoldsUpNobody) {
  options.request_time = std::chrono::seconds(1);
  open();
  std::vector<std::unique_ptr<test::RawConnection>> slow;
  for (int i = 0; i < 20; ++i) slow.push_back(std::make_unique<test::RawConnection>(port));
  const std::string request = "GET / HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port) + "\r\nX: ";
  std::size_t sent = 0;
  // Single bytes now and then do not restart the time limit.
  const auto cut_off = [&] {
    for (const auto& connection : slow)
      connection->send(sent < request.size() ? request.substr(sent, 1) : "x");
    ++sent;
    EXPECT_EQ(test::http_get(port, "/runs").status, 200U) << "somebody else";
    return logged().find("not complete after 1 s") != std::string::npos;
  };
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_TRUE(test::wait_for(cut_off, test::kPatience));
  EXPECT_GE(std::chrono::steady_clock::now() - begun, std::chrono::milliseconds(900));
  for (const auto& connection : slow) EXPECT_TRUE(connection->closed());
  expect_that_nothing_moved();
}

TEST_F(SecurityTest, AnAnswerThatIsNeverTakenEndsTheConnection) {
  options.most_connections = 1;
  options.request_time = std::chrono::seconds(1);
  open();
  test::RawConnection deaf(port, 4096);
  const std::string request =
      "GET /uplot.js HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port) + "\r\n\r\n";
  std::string many;
  for (int i = 0; i < 20; ++i) many += request;  // More than the system's buffers hold.
  deaf.send(many);
  EXPECT_TRUE(test::wait_for([&] { return test::http_get(port, "/").status == 503; }, test::kPatience))
      << "it has the only connection";
  EXPECT_TRUE(is_logged("its answer was not taken"));
  EXPECT_TRUE(test::wait_for([&] { return test::http_get(port, "/").status == 200; }, test::kPatience));
}

TEST_F(SecurityTest, APageThatAnswersNoPingIsGoneAndSteersNoLonger) {
  options.silent_time = std::chrono::seconds(3);  // A slow machine needs some to open the other page.
  open();
  auto silent = steering_page();  // It answers pings only while it is asked for messages.
  test::PageClient other(port);
  EXPECT_FALSE(other.ok({{"do", "control"}}));
  EXPECT_TRUE(test::wait_for([&] { return other.ok({{"do", "control"}}); }, test::kPatience));
}

}  // namespace
}  // namespace abcal::console
