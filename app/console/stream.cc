#include "app/console/stream.h"

#include <boost/beast/ssl.hpp>
#include <boost/beast/websocket/teardown.hpp>
#include <variant>

namespace abcal::console {
namespace {

using Secure = boost::beast::ssl_stream<Stream::Plain>;

}  // namespace

struct Stream::Layers {
  explicit Layers(boost::asio::ip::tcp::socket socket) : all(std::in_place_type<Plain>, std::move(socket)) {}
  Layers(boost::asio::ip::tcp::socket socket, boost::asio::ssl::context& tls)
      : all(std::in_place_type<Secure>, std::move(socket), tls) {}

  std::variant<Plain, Secure> all;
};

Stream::Stream(boost::asio::ip::tcp::socket socket, boost::asio::ssl::context* tls)
    : layers_(tls == nullptr ? std::make_unique<Layers>(std::move(socket))
                             : std::make_unique<Layers>(std::move(socket), *tls)) {}

Stream::Stream(Stream&& other) noexcept = default;
Stream& Stream::operator=(Stream&& other) noexcept = default;
Stream::~Stream() = default;

Stream::Plain& Stream::next_layer() {
  if (auto* secure = std::get_if<Secure>(&layers_->all)) return secure->next_layer();
  return std::get<Plain>(layers_->all);
}

const Stream::Plain& Stream::next_layer() const {
  if (const auto* secure = std::get_if<Secure>(&layers_->all)) return secure->next_layer();
  return std::get<Plain>(layers_->all);
}

void Stream::async_handshake(std::function<void(boost::beast::error_code)> handler) {
  if (auto* secure = std::get_if<Secure>(&layers_->all))
    secure->async_handshake(boost::asio::ssl::stream_base::server, std::move(handler));
  else
    handler(boost::beast::error_code());
}

void Stream::read_some(const GatheredBuffers<boost::asio::mutable_buffer>& buffers, ReadOrWritten handler) {
  std::visit([&](auto& layer) { layer.async_read_some(buffers, std::move(handler)); }, layers_->all);
}

void Stream::write_some(const GatheredBuffers<boost::asio::const_buffer>& buffers, ReadOrWritten handler) {
  std::visit([&](auto& layer) { layer.async_write_some(buffers, std::move(handler)); }, layers_->all);
}

void Stream::tear_down(boost::beast::role_type role, std::function<void(boost::beast::error_code)> handler) {
  using boost::beast::websocket::async_teardown;
  if (auto* secure = std::get_if<Secure>(&layers_->all))
    secure->async_shutdown(std::move(handler));  // As Beast closes a WebSocket over TLS.
  else
    async_teardown(role, std::get<Plain>(layers_->all), std::move(handler));
}

}  // namespace abcal::console
