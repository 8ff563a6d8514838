#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <string_view>
#include <thread>

#include "app/console/server.h"
#include "app/system/helper_program.h"
#include "app/system/output.h"
#include "tests/app/program_fixtures.h"
#include "tests/console/client.h"
#include "tests/support/temporary_folder.h"

namespace abcal::console {

/// A console with a simulated bench in a folder of its own, and what it logged.
class ConsoleTest : public testing::Test {
 protected:
  ConsoleTest() {
    set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
    send_log_to([this](std::string_view words) {
      const std::lock_guard lock(log_mutex_);
      log_ += words;
    });
    options.port = 0;
    options.longest_queue = 100000;  // No message is dropped, however slow the page of a test.
    pace = 500.0;
  }
  ~ConsoleTest() override {
    close();
    send_log_to(nullptr);
  }

  void open() {
    std::filesystem::create_directories(runs());
    test::write_file(folder / "bench.toml", bench.text());
    stop_ = std::stop_source();
    server_ = std::make_unique<Server>(options, Session::Options{folder / "bench.toml", runs(), pace});
    port = server_->port();
    thread_ = std::jthread([this] { something_was_on = server_->serve(stop_.get_token()); });
  }
  void close() {
    stop_.request_stop();
    thread_ = {};
    server_.reset();
  }

  std::filesystem::path runs() const { return folder / "runs"; }
  std::string logged() {
    const std::lock_guard lock(log_mutex_);
    return log_;
  }
  bool is_logged(const std::string& text) {
    return test::wait_for([&] { return logged().find(text) != std::string::npos; }, test::kPatience);
  }
  std::size_t run_files() const {
    std::size_t count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(runs()))
      count += entry.path().extension() == ".run" ? 1 : 0;
    return count;
  }
  /// A page that steers, and has received all messages so far.
  std::unique_ptr<test::PageClient> steering_page(const test::Headers& headers = {}) {
    auto page = std::make_unique<test::PageClient>(port, headers);
    EXPECT_TRUE(page->ok({{"do", "control"}}));
    page->wait_for([](const auto& m) { return m["type"] == "control" && m["page"].is_number(); }, "control");
    return page;
  }

  test::TemporaryFolder folder;
  BenchText bench;
  ServerOptions options;
  double pace;
  std::uint16_t port = 0;
  bool something_was_on = false;

 private:
  std::mutex log_mutex_;
  std::string log_;
  std::unique_ptr<Server> server_;
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace abcal::console
