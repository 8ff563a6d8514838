// Slow work of the console: done in a pool, once for all who wait, cancelled when nobody waits, stored by its
// hash.

#include "app/console/workshop.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/executor_work_guard.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <future>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "app/system/child_process.h"
#include "tests/console/console_fixture.h"

namespace abcal::console {
namespace {

using testing::HasSubstr;
using Json = nlohmann::json;

std::shared_ptr<const Product> product_of(const std::string& body) {
  return std::make_shared<const Product>(Product{200, "text/plain", body});
}

class WorkshopTest : public testing::Test {
 protected:
  void run_until(const std::function<bool()>& done) {
    const auto deadline = std::chrono::steady_clock::now() + test::kPatience;
    while (!done()) {
      ASSERT_LT(std::chrono::steady_clock::now(), deadline);
      io.run_one_for(std::chrono::milliseconds(50));
      io.restart();
    }
  }

  boost::asio::io_context io;
  boost::asio::executor_work_guard<boost::asio::io_context::executor_type> stays{io.get_executor()};
  Workshop workshop{io, 2};
};

TEST_F(WorkshopTest, MakesOnceWhatSeveralWaitFor) {
  std::promise<void> go;
  std::shared_future<void> gone = go.get_future().share();
  std::atomic<int> made = 0;
  int told = 0;
  std::vector<Workshop::Ticket> tickets;
  for (int i = 0; i < 3; ++i)
    tickets.push_back(workshop.order(
        "a.run/report.pdf",
        [&](const std::stop_token&) {
          ++made;
          gone.wait();
          return product_of("a report");
        },
        [&](const auto& product) {
          ++told;
          EXPECT_EQ(product->body, "a report");
        }));
  EXPECT_EQ(workshop.in_progress(), 3U);
  go.set_value();
  run_until([&] { return told == 3; });
  EXPECT_EQ(made, 1);
  EXPECT_EQ(workshop.in_progress(), 0U);
}

TEST_F(WorkshopTest, EndsWhatNobodyWaitsForAnyMore) {
  std::promise<bool> ended;
  std::promise<void> begun;
  const auto wait_for_stop = [&](const std::stop_token& cancelled) {
    std::promise<void> stopped;
    const std::stop_callback on_stop(cancelled, [&] { stopped.set_value(); });
    begun.set_value();
    ended.set_value(stopped.get_future().wait_for(test::kPatience) == std::future_status::ready);
    return product_of("");
  };
  const auto not_told = [](const auto&) { ADD_FAILURE() << "nobody waits"; };
  Workshop::Ticket first = workshop.order("a", wait_for_stop, not_told);
  Workshop::Ticket second = workshop.order("a", wait_for_stop, not_told);
  begun.get_future().wait();
  std::future<bool> end = ended.get_future();
  first.reset();
  EXPECT_EQ(end.wait_for(std::chrono::seconds(0)), std::future_status::timeout);
  second.reset();
  EXPECT_TRUE(end.get());
  // A later request is independent of the cancelled one.
  bool told = false;
  const Workshop::Ticket third = workshop.order(
      "a", [](const std::stop_token&) { return product_of("anew"); },
      [&](const auto& product) { told = product->body == "anew"; });
  run_until([&] { return told; });
}

TEST_F(WorkshopTest, WhatFailsIsAnAnswer) {
  std::string said;
  const Workshop::Ticket ticket = workshop.order(
      "",
      [](const std::stop_token&) -> std::shared_ptr<const Product> {
        throw std::runtime_error("no such angle");
      },
      [&](const auto& product) { said = product->body; });
  run_until([&] { return !said.empty(); });
  EXPECT_EQ(said, "no such angle\n");
}

/// Many orders of one person take one thread, and those of a person who goes first do not wait behind them.
TEST_F(WorkshopTest, OnePersonTakesOneThreadAndTheNewestOrdersWait) {
  std::promise<void> go;
  const std::shared_future<void> gone = go.get_future().share();
  std::atomic<int> begun = 0;
  std::map<int, unsigned> statuses;
  std::vector<Workshop::Ticket> tickets;
  const auto order = [&](int number, const Turn& turn, bool is_held) {
    tickets.push_back(workshop.order(
        "",
        [&begun, gone, is_held](const std::stop_token&) {
          ++begun;
          if (is_held) gone.wait();
          return product_of("");
        },
        [&statuses, number](const auto& product) { statuses[number] = product->status; }, turn));
  };
  for (int k = 0; k < 50; ++k) order(k, {"watcher", false}, true);
  order(100, {"operator", true}, false);
  run_until([&] { return statuses.size() == 47; });
  EXPECT_EQ(statuses.at(100), 200U) << "the other thread was free for it";
  EXPECT_EQ(begun, 2);
  EXPECT_FALSE(statuses.contains(0)) << "it is being made";
  for (int k = 47; k < 50; ++k) EXPECT_FALSE(statuses.contains(k)) << "one of the newest waits: " << k;
  for (int k = 1; k < 47; ++k) EXPECT_EQ(statuses.at(k), 429U) << k;
  go.set_value();
  run_until([&] { return statuses.size() == 51; });
  EXPECT_EQ(statuses.at(0), 200U);
  EXPECT_EQ(statuses.at(49), 200U);
}

TEST_F(WorkshopTest, WhoGoesFirstIsServedBeforeThoseWhoCameBefore) {
  Workshop one{io, 1};
  std::promise<void> go;
  const std::shared_future<void> gone = go.get_future().share();
  std::vector<std::string> made;
  std::vector<Workshop::Ticket> tickets;
  for (const std::string who : {"a", "b", "c", "operator"})
    tickets.push_back(one.order(
        "",
        [gone](const std::stop_token&) {
          gone.wait();
          return product_of("");
        },
        [&made, who](const auto&) { made.push_back(who); }, {who, who == "operator"}));
  go.set_value();
  run_until([&] { return made.size() == 4; });
  EXPECT_THAT(made, testing::ElementsAre("a", "operator", "b", "c"));
}

TEST(ProductCacheTest, KeepsByTheHashOfWhatItWasMadeOf) {
  const test::TemporaryFolder folder;
  const std::filesystem::path file = folder / "a.run";
  test::write_file(file, "one");
  ProductCache cache(100);
  const std::string key = cache.key_of("report", {file, folder / "absent"});
  EXPECT_FALSE(key.empty());
  EXPECT_EQ(key, cache.key_of("report", {file, folder / "absent"}));
  EXPECT_NE(key, cache.key_of("result", {file, folder / "absent"}));
  EXPECT_NE(key, cache.key_of("report", {file}));
  test::write_file(file, "other bytes");
  EXPECT_NE(key, cache.key_of("report", {file, folder / "absent"}));
  test::write_file(folder / "a.run-wal", "");
  EXPECT_EQ(cache.key_of("report", {file}), "") << "somebody writes to it";
}

TEST(ProductCacheTest, ForgetsWhatWasNotAskedForLongest) {
  ProductCache cache(100);
  cache.keep("a", product_of(std::string(40, 'a')));
  cache.keep("b", product_of(std::string(40, 'b')));
  EXPECT_NE(cache.find("a"), nullptr);
  cache.keep("c", product_of(std::string(40, 'c')));
  EXPECT_EQ(cache.find("b"), nullptr);
  EXPECT_NE(cache.find("a"), nullptr);
  cache.keep("large", product_of(std::string(60, 'l')));
  EXPECT_EQ(cache.find("large"), nullptr);
}

/// A run of 3 x 360 angles in the folder of a console, and a small one.
class LargeRunTest : public ConsoleTest {
 protected:
  void measure() {
    std::filesystem::create_directories(runs());
    BenchText large = bench;
    large.protocol = "steps = 360\nstep_deg = 1.0\nsettle_s = 0.05\ndwell_readings = 10\n";
    for (const auto& [text, name] :
         {std::pair{bench.text(), std::string("small")}, {large.text(), "large"}}) {
      test::write_file(folder / (name + ".toml"), text);
      const auto ran =
          test::run_program({"run", name + ".toml", "-o", "runs/" + name + ".run"}, folder.path());
      ASSERT_EQ(ran.exit_code, 0) << ran.err;
    }
  }
  double seconds_for(const std::string& path) {
    const auto begin = std::chrono::steady_clock::now();
    EXPECT_EQ(test::http_get(port, path).status, 200U) << path;
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  }
  std::unique_ptr<test::RawConnection> ask_for_pdf() const {
    auto asks = std::make_unique<test::RawConnection>(port);
    asks->send("GET /runs/large.run/report.pdf HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port) +
               "\r\n\r\n");
    return asks;
  }
  /// A program in place of abcal-pdf that takes its time.
  void print_slowly() {
    const std::filesystem::path bin = folder / "bin";
    std::filesystem::create_directory(bin);
    test::write_file(bin / "abcal-pdf", "#!/bin/sh\nsleep 60\n");
    std::filesystem::permissions(bin / "abcal-pdf", std::filesystem::perms::owner_all);
    set_helper_folder(bin);
  }
  /// Whether an abcal-pdf of this process is at work.
  static bool is_printing() {
    for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
      std::ifstream stat(entry.path() / "stat");
      std::string pid, name, state, parent;
      if (stat >> pid >> name >> state >> parent && name.starts_with("(abcal-pdf") && state != "Z" &&
          parent == std::to_string(::getpid()))
        return true;
    }
    return false;
  }
  static bool comes_true(const std::function<bool()>& what) { return test::wait_for(what, test::kPatience); }
};

TEST_F(LargeRunTest, ItsPdfDelaysNoOtherAnswer) {
  measure();
  print_slowly();
  open();
  const auto asks = ask_for_pdf();
  ASSERT_TRUE(comes_true(is_printing));
  double longest_s = 0.0;
  int answers = 0;
  for (int round = 0; round < 3; ++round) {
    for (const char* path :
         {"/runs", "/runs/small.run/result", "/runs/small.run/readings.csv", "/start-form"}) {
      longest_s = std::max(longest_s, seconds_for(path));
      ++answers;
    }
    // The answers came before the PDF, not after.
    if (round == 0) {
      EXPECT_TRUE(is_printing());
    }
  }
  std::printf("%d other answers during a PDF of 3 x 360 angles, the longest after %.3f s\n", answers,
              longest_s);
}

TEST_F(LargeRunTest, ItsPdfIsCancelledWhenTheClientGoes) {
  measure();
  print_slowly();
  open();
  auto asks = ask_for_pdf();
  ASSERT_TRUE(comes_true(is_printing));
  const auto left = std::chrono::steady_clock::now();
  asks.reset();
  ASSERT_TRUE(comes_true([] { return !is_printing(); }));
  std::printf("abcal-pdf ended %.2f s after the client had gone\n",
              std::chrono::duration<double>(std::chrono::steady_clock::now() - left).count());
  // A finished one would be kept, and not be made again.
  asks = ask_for_pdf();
  EXPECT_TRUE(comes_true(is_printing));
}

}  // namespace
}  // namespace abcal::console
