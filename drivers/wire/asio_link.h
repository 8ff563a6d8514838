#pragma once

#include <sys/ioctl.h>

#include <array>
#include <atomic>
#include <boost/asio/bind_cancellation_slot.hpp>
#include <boost/asio/buffer.hpp>
#include <boost/asio/cancellation_signal.hpp>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/write.hpp>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>

#include "drivers/wire/receive_queue.h"

namespace abcal::wire {

/// An Asio port (serial_port or a socket), the one thread that owns it, and its receive queue. Used inside
/// this folder only, and only in .cc files: no public header knows Asio.
template <class Port>
class AsioLink {
 public:
  static constexpr Clock::Duration kWriteDeadline = std::chrono::seconds(2);
  static constexpr Clock::Duration kGrace = std::chrono::seconds(5);  ///< For the thread, on a busy machine.

  AsioLink(std::string name, Clock& clock, std::size_t queue_bytes)
      : clock_(clock), queue_(std::move(name), queue_bytes), port_(io_) {}

  ~AsioLink() {
    io_.stop();
    if (thread_.joinable()) thread_.join();
  }

  AsioLink(const AsioLink&) = delete;
  AsioLink& operator=(const AsioLink&) = delete;

  boost::asio::io_context& io() { return io_; }
  Port& port() { return port_; }
  ReceiveQueue& queue() { return queue_; }
  const ReceiveQueue& queue() const { return queue_; }

  /// The open and configured port is handed to its thread.
  void start() {
    io_.restart();
    work_.emplace(io_.get_executor());
    read_more();
    thread_ = std::thread([this] {
      try {
        io_.run();
      } catch (const std::exception& error) {
        queue_.close(std::string("the thread that reads it failed: ") + error.what());
      }
      ended_ = true;
    });
  }

  /// Bytes that have arrived by the deadline; empty: none. Bytes that the system holds at that time count as
  /// arrived: on a busy machine the thread that fetches them is late, not the instrument.
  /// @throws InstrumentError kLinkLost if the port or its thread has ended, or the thread stands still
  ReceivedBytes read_until(Clock::Instant deadline) {
    ReceivedBytes received = queue_.pop_until(deadline);
    int unfetched = 0;
    if (!received.bytes.empty() || ::ioctl(port_.native_handle(), FIONREAD, &unfetched) != 0 ||
        unfetched == 0) {
      return received;
    }
    received = queue_.pop_until(std::chrono::steady_clock::now() + kGrace);
    if (received.bytes.empty()) {
      throw InstrumentError(queue_.name(), Fault::kLinkLost, "the thread that reads from it does not answer");
    }
    return received;
  }

  /// @throws InstrumentError kNoReply after kWriteDeadline, kLinkLost if the port or its thread has ended
  void write(std::string_view bytes) {
    const std::lock_guard lock(write_mutex_);  // One write is never torn by another.
    queue_.throw_if_closed();
    if (bytes.empty()) return;
    const auto job = std::make_shared<WriteJob>(io_, bytes);
    auto result = job->result.get_future();
    boost::asio::post(io_, [this, job] {
      if (job->abandoned) return;
      job->timer.expires_after(kWriteDeadline);
      job->timer.async_wait([job](const boost::system::error_code& error) {
        if (error || job->done) return;
        job->timed_out = true;
        job->cancel.emit(boost::asio::cancellation_type::terminal);
      });
      boost::asio::async_write(
          port_, boost::asio::buffer(job->bytes),
          boost::asio::bind_cancellation_slot(
              job->cancel.slot(), [job](const boost::system::error_code& error, std::size_t written) {
                job->done = true;
                job->timer.cancel();
                job->result.set_value({error, written, job->timed_out});
              }));
    });
    wait_for(*job, result);
    const WriteResult outcome = result.get();
    if (!outcome.error) return;
    if (outcome.timed_out) {
      throw InstrumentError(queue_.name(), Fault::kNoReply,
                            "took " + std::to_string(outcome.written) + " of " +
                                std::to_string(bytes.size()) +
                                " bytes within 2 s; is flow control (RTS/CTS) set as in the instrument?");
    }
    queue_.close(lost_because(outcome.error));
    throw InstrumentError(queue_.name(), Fault::kLinkLost, lost_because(outcome.error));
  }

 private:
  struct WriteResult {
    boost::system::error_code error;
    std::size_t written = 0;
    bool timed_out = false;
  };

  /// Shared by the two handlers, since either may come last.
  struct WriteJob {
    WriteJob(boost::asio::io_context& io, std::string_view written) : bytes(written), timer(io) {}
    std::string bytes;  // A copy: a thread that hangs may come to it after the caller has gone.
    boost::asio::steady_timer timer;
    boost::asio::cancellation_signal cancel;
    bool done = false;
    bool timed_out = false;
    std::atomic<bool> abandoned = false;  ///< The caller was told that it failed: it is not sent later.
    std::promise<WriteResult> result;
  };

  /// The job's timer ends every write in time, but not without the thread that runs both.
  void wait_for(WriteJob& job, const std::future<WriteResult>& result) {
    const auto longest = std::chrono::steady_clock::now() + kWriteDeadline + kGrace;
    while (result.wait_for(std::chrono::milliseconds(20)) != std::future_status::ready) {
      const bool hangs = std::chrono::steady_clock::now() > longest;
      if (!ended_ && !hangs) continue;
      job.abandoned = true;
      if (ended_) {
        queue_.throw_if_closed();  // It says why.
        throw InstrumentError(queue_.name(), Fault::kLinkLost, "the thread that writes to it has ended");
      }
      throw InstrumentError(queue_.name(), Fault::kLinkLost, "the thread that writes to it does not answer");
    }
  }

  static std::string lost_because(const boost::system::error_code& error) {
    return "unplugged, switched off, or closed by the other side (" + error.message() + ")";
  }

  void read_more() {
    port_.async_read_some(boost::asio::buffer(chunk_),
                          [this](const boost::system::error_code& error, std::size_t count) {
                            if (count > 0) queue_.push({chunk_.data(), count}, clock_.now());
                            if (!error) {
                              read_more();
                            } else {  // A terminal whose other side closed reads as end of file or EIO.
                              queue_.close(lost_because(error));
                            }
                          });
  }

  Clock& clock_;
  ReceiveQueue queue_;
  boost::asio::io_context io_;
  Port port_;
  std::optional<boost::asio::executor_work_guard<boost::asio::io_context::executor_type>> work_;
  std::array<char, 65536> chunk_{};
  std::mutex write_mutex_;
  std::atomic<bool> ended_ = false;  ///< No thread runs io_ any more.
  std::thread thread_;
};

}  // namespace abcal::wire
