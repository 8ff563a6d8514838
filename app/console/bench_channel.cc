#include "app/console/bench_channel.h"

#include <boost/asio/buffer.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/write.hpp>
#include <utility>

namespace abcal::console {
namespace {

/// Longest line, in bytes. A snapshot of a run of 3 x 360 angles has half a megabyte.
constexpr std::size_t kLongestLine = 64 * 1024 * 1024;

}  // namespace

void BenchChannel::begin(std::function<void(std::string_view)> line, std::function<void()> end) {
  line_ = std::move(line);
  end_ = std::move(end);
  read();
}

void BenchChannel::read() {
  boost::asio::async_read_until(
      socket_, boost::asio::dynamic_buffer(input_, kLongestLine), '\n',
      [self = shared_from_this()](boost::system::error_code error, std::size_t length) {
        if (error) return self->end();
        const std::string line = self->input_.substr(0, length - 1);
        self->input_.erase(0, length);
        if (self->line_ && !line.empty()) self->line_(line);
        self->read();
      });
}

void BenchChannel::end() {
  line_ = nullptr;
  if (const auto end = std::exchange(end_, nullptr)) end();
}

void BenchChannel::close() {
  boost::system::error_code ignored;
  socket_.close(ignored);
}

void BenchChannel::send(char kind, std::string_view json) {
  std::string line(1, kind);
  line.append(json).push_back('\n');
  queue_.push_back(std::move(line));
  if (!writing_) write();
}

void BenchChannel::write() {
  writing_ = true;
  boost::asio::async_write(socket_, boost::asio::buffer(queue_.front()),
                           [self = shared_from_this()](boost::system::error_code error, std::size_t) {
                             self->writing_ = false;
                             self->queue_.pop_front();
                             if (error) {
                               self->queue_.clear();
                               return;  // The pending read fails as well, and reports the end.
                             }
                             if (!self->queue_.empty()) return self->write();
                             if (self->drained) self->drained();
                           });
}

}  // namespace abcal::console
