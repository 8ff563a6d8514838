#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/ssl.hpp>
#include <boost/beast/websocket/teardown.hpp>
#include <utility>
#include <variant>

namespace abcal::console {

/// A connection with TLS or without, as Beast's asynchronous functions take it.
class Stream {
 public:
  using Plain = boost::beast::tcp_stream;
  using Secure = boost::beast::ssl_stream<Plain>;
  // Asio asks for this name. NOLINTNEXTLINE(readability-identifier-naming)
  using executor_type = Plain::executor_type;

  /// @param tls  null: without
  Stream(boost::asio::ip::tcp::socket socket, boost::asio::ssl::context* tls)
      : stream_(tls == nullptr
                    ? std::variant<Plain, Secure>(std::in_place_type<Plain>, std::move(socket))
                    : std::variant<Plain, Secure>(std::in_place_type<Secure>, std::move(socket), *tls)) {}

  executor_type get_executor() { return next_layer().get_executor(); }
  /// What is below TLS, with its time limits.
  Plain& next_layer() {
    if (auto* secure = std::get_if<Secure>(&stream_)) return secure->next_layer();
    return std::get<Plain>(stream_);
  }
  const Plain& next_layer() const {
    if (const auto* secure = std::get_if<Secure>(&stream_)) return secure->next_layer();
    return std::get<Plain>(stream_);
  }

  /// Where there is TLS: its beginning; else calls the handler at once.
  template <class Handler>
  void async_handshake(Handler&& handler) {
    if (auto* secure = std::get_if<Secure>(&stream_))
      secure->async_handshake(boost::asio::ssl::stream_base::server, std::forward<Handler>(handler));
    else
      handler(boost::beast::error_code());
  }

  template <class Buffers, class Handler>
  void async_read_some(const Buffers& buffers, Handler&& handler) {
    if (auto* secure = std::get_if<Secure>(&stream_))
      secure->async_read_some(buffers, std::forward<Handler>(handler));
    else
      std::get<Plain>(stream_).async_read_some(buffers, std::forward<Handler>(handler));
  }
  template <class Buffers, class Handler>
  void async_write_some(const Buffers& buffers, Handler&& handler) {
    if (auto* secure = std::get_if<Secure>(&stream_))
      secure->async_write_some(buffers, std::forward<Handler>(handler));
    else
      std::get<Plain>(stream_).async_write_some(buffers, std::forward<Handler>(handler));
  }

  /// The end of a WebSocket; Beast finds it by its name.
  template <class Handler>
  friend void async_teardown(boost::beast::role_type role, Stream& stream, Handler&& handler) {
    using boost::beast::websocket::async_teardown;
    if (auto* secure = std::get_if<Secure>(&stream.stream_))
      secure->async_shutdown(std::forward<Handler>(handler));  // As Beast does it.
    else
      async_teardown(role, std::get<Plain>(stream.stream_), std::forward<Handler>(handler));
  }

 private:
  std::variant<Plain, Secure> stream_;
};

}  // namespace abcal::console
