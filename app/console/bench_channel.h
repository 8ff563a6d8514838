#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <cstddef>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "app/system/descriptor.h"

namespace abcal::console {

/// The wire between a console and the process that holds its bench: lines of text over a Unix socket. The
/// first letter of a line gives its kind.
namespace bench_line {
// From the bench:
constexpr char kMessage = 'M';   ///< JSON for every page.
constexpr char kSnapshot = 'S';  ///< JSON: the whole state, as requested.
constexpr char kReply = 'R';     ///< JSON: {"id", "ok", "why"}
constexpr char kEnd = 'E';       ///< JSON: {"was_on"}: the bench is at rest, and its process ends.
// To the bench:
constexpr char kRequest = 'Q';  ///< JSON: {"id", "by", "name", "register", "login", "request"}
constexpr char kControl = 'T';  ///< JSON: {"by", "name", "register", "login"}: who steers from now on.
constexpr char kAskSnapshot = 'A';
constexpr char kClose = 'C';  ///< Stop what is in progress, halt the stage, and end.
}  // namespace bench_line

/// Lines over a channel of bytes, both ways. For the thread of its socket.
class BenchChannel : public std::enable_shared_from_this<BenchChannel> {
 public:
  using Socket = boost::asio::local::stream_protocol::socket;

  explicit BenchChannel(Socket socket) : socket_(std::move(socket)) {}
  /// @param connected  by connect_to() with ChannelKind::kBytes
  BenchChannel(boost::asio::io_context& io, Descriptor connected)
      : socket_(io, Socket::protocol_type(), connected.release()) {}

  /// Reads until the end. `line` gets each line without its newline; `end` is called once, when the other
  /// side is gone.
  void begin(std::function<void(std::string_view line)> line, std::function<void()> end);
  void send(char kind, std::string_view json = {});
  /// Number of lines not written yet.
  std::size_t waiting() const { return queue_.size(); }
  /// Called each time that the last waiting line has been written.
  std::function<void()> drained;
  void close();

 private:
  void read();
  void write();
  void end();

  Socket socket_;
  std::string input_;
  std::deque<std::string> queue_;
  bool writing_ = false;
  std::function<void(std::string_view)> line_;
  std::function<void()> end_;
};

}  // namespace abcal::console
