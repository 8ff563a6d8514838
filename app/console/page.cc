#include "app/console/page.h"

#include <fmt/format.h>

#include <boost/asio/buffer.hpp>
#include <utility>

#include "app/console/control.h"

namespace abcal::console {
namespace {

namespace beast = boost::beast;
namespace websocket = beast::websocket;

}  // namespace

Page::Page(Control& control, ServerCommon& common, Stream stream, Owner owner)
    : control_(control), common_(common), socket_(std::move(stream)), owner_(std::move(owner)) {}

Asker Page::asker() const {
  return {fmt::format("page {} at {}", number, peer().remote), visitor().who, visitor().login};
}

void Page::open(const HttpRequest& request) {
  websocket::stream_base::timeout limits{};
  limits.handshake_timeout = common_.options.request_time;
  limits.idle_timeout = common_.options.silent_time;
  limits.keep_alive_pings = true;
  beast::get_lowest_layer(socket_).expires_never();  // The WebSocket has its own time limits.
  socket_.set_option(limits);
  socket_.read_message_max(kLongestRequest);
  socket_.text(true);
  socket_.async_accept(request, [self = shared_from_this()](beast::error_code error) {
    if (error) return;
    self->control_.join(self);
    self->read();
  });
}

void Page::send(const SharedText& message) {
  if (behind_) return;
  if (queue_.size() >= common_.options.longest_queue) {
    std::erase_if(queue_, [](const Waiting& waiting) { return !waiting.is_reply; });
    behind_ = true;
    return;
  }
  push({message, false});
}

void Page::reply(std::string message) {
  ++replies_;
  push({std::make_shared<const std::string>(std::move(message)), true});
}

void Page::close() {
  beast::get_lowest_layer(socket_).close();  // All operations in progress end with an error.
}

void Page::push(Waiting message) {
  queue_.push_back(std::move(message));
  if (!writing_) write();
}

void Page::read() {
  socket_.async_read(buffer_, [self = shared_from_this()](beast::error_code error, std::size_t) {
    if (error) {
      // The stated length of the frame is too large, or its bytes exceed the buffer.
      if (error == websocket::error::message_too_big || error == websocket::error::buffer_overflow)
        self->common_.log_refusal(self->peer(), "a message",
                                  fmt::format("longer than {} bytes", kLongestRequest));
      self->control_.leave(*self);
      return;
    }
    const auto data = self->buffer_.cdata();
    self->control_.receive(*self, {static_cast<const char*>(data.data()), data.size()});
    self->buffer_.consume(self->buffer_.size());
    self->paused_ = self->replies_ >= self->common_.options.longest_queue;
    if (!self->paused_) self->read();
  });
}

void Page::write() {
  writing_ = true;
  now_ = std::move(queue_.front());
  queue_.pop_front();
  socket_.async_write(boost::asio::buffer(*now_.text),
                      [self = shared_from_this()](beast::error_code error, std::size_t) {
                        self->writing_ = false;
                        if (error) {
                          self->control_.leave(*self);
                          return;
                        }
                        if (self->now_.is_reply) --self->replies_;
                        if (self->paused_ && self->replies_ < self->common_.options.longest_queue) {
                          self->paused_ = false;
                          self->read();
                        }
                        if (std::exchange(self->behind_, false)) self->control_.send_snapshot(*self);
                        if (!self->writing_ && !self->queue_.empty()) self->write();
                      });
}

}  // namespace abcal::console
