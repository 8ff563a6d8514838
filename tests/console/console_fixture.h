#pragma once

#include <gtest/gtest.h>
#include <spdlog/sinks/ostream_sink.h>
#include <spdlog/spdlog.h>

#include <filesystem>
#include <memory>
#include <mutex>
#include <sstream>
#include <stop_token>
#include <string>
#include <thread>

#include "app/console/server.h"
#include "tests/app/program_fixtures.h"
#include "tests/console/client.h"
#include "tests/support/temporary_folder.h"

namespace abcal::console {

/// A console with a simulated bench in a folder of its own, and what it logged.
class ConsoleTest : public testing::Test {
 protected:
  ConsoleTest() {
    sink_ = std::make_shared<spdlog::sinks::ostream_sink_mt>(log_);
    before_ = spdlog::default_logger();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("test", sink_));
    options.port = 0;
    options.longest_queue = 100000;  // However slow the page of a test, each message comes.
    pace = 500.0;
  }
  ~ConsoleTest() override {
    close();
    spdlog::set_default_logger(before_);
  }

  void open() {
    std::filesystem::create_directories(runs());
    test::write_file(folder / "bench.toml", bench.text());
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
    // The sink's lock is the one that guards the stream.
    sink_->flush();
    return log_.str();
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
  /// A page that steers, and has seen all that was told until then.
  std::unique_ptr<test::PageClient> steering_page() {
    auto page = std::make_unique<test::PageClient>(port);
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
  /// A stream buffer that one thread writes while another looks.
  class SharedLog : public std::ostream {
   public:
    SharedLog() : std::ostream(&buffer_) {}
    std::string str() { return buffer_.text(); }

   private:
    class Buffer : public std::streambuf {
     public:
      std::string text() {
        const std::lock_guard lock(mutex_);
        return text_;
      }

     protected:
      int_type overflow(int_type c) override {
        const std::lock_guard lock(mutex_);
        if (c != traits_type::eof()) text_ += traits_type::to_char_type(c);
        return c;
      }
      std::streamsize xsputn(const char* data, std::streamsize size) override {
        const std::lock_guard lock(mutex_);
        text_.append(data, static_cast<std::size_t>(size));
        return size;
      }

     private:
      std::mutex mutex_;
      std::string text_;
    };
    Buffer buffer_;
  };

  SharedLog log_;
  std::shared_ptr<spdlog::sinks::ostream_sink_mt> sink_;
  std::shared_ptr<spdlog::logger> before_;
  std::unique_ptr<Server> server_;
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace abcal::console
