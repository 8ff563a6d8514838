#pragma once

#include <array>
#include <boost/asio/buffer.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/beast/core/error.hpp>
#include <boost/beast/core/role.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <cstddef>
#include <functional>
#include <memory>
#include <type_traits>
#include <utility>

namespace abcal::console {

/// Up to 16 buffers in the form that Asio takes, the most that one call reads or writes. The rest follows
/// with the next call.
template <class Buffer>
class GatheredBuffers {
 public:
  // Asio asks for these names. NOLINTBEGIN(readability-identifier-naming)
  using value_type = Buffer;
  using const_iterator = const Buffer*;
  // NOLINTEND(readability-identifier-naming)

  template <class Buffers>
  explicit GatheredBuffers(const Buffers& buffers) {
    const auto end = boost::asio::buffer_sequence_end(buffers);
    for (auto next = boost::asio::buffer_sequence_begin(buffers); next != end && count_ < all_.size();
         ++next) {
      const Buffer buffer(*next);
      if (buffer.size() > 0) all_[count_++] = buffer;
    }
  }

  const_iterator begin() const { return all_.data(); }
  const_iterator end() const { return all_.data() + count_; }

 private:
  std::array<Buffer, 16> all_;
  std::size_t count_ = 0;
};

/// A connection with TLS or without, as Beast's asynchronous functions take it. The layers below are compiled
/// once, in stream.cc: for each type of buffer and handler they would take half of the console's compile
/// time.
class Stream {
 public:
  using Plain = boost::beast::tcp_stream;
  // Asio asks for this name. NOLINTNEXTLINE(readability-identifier-naming)
  using executor_type = Plain::executor_type;

  /// @param tls  null: no TLS
  Stream(boost::asio::ip::tcp::socket socket, boost::asio::ssl::context* tls);
  Stream(Stream&& other) noexcept;
  Stream& operator=(Stream&& other) noexcept;
  ~Stream();

  executor_type get_executor() { return next_layer().get_executor(); }
  /// The TCP layer below TLS, with its time limits.
  Plain& next_layer();
  const Plain& next_layer() const;

  /// Performs the TLS handshake; without TLS calls the handler at once.
  void async_handshake(std::function<void(boost::beast::error_code)> handler);

  template <class Buffers, class Handler>
  void async_read_some(const Buffers& buffers, Handler&& handler) {
    read_some(GatheredBuffers<boost::asio::mutable_buffer>(buffers),
              copyable(std::forward<Handler>(handler)));
  }
  template <class Buffers, class Handler>
  void async_write_some(const Buffers& buffers, Handler&& handler) {
    write_some(GatheredBuffers<boost::asio::const_buffer>(buffers), copyable(std::forward<Handler>(handler)));
  }

  /// Ends a WebSocket; Beast finds this function by its name.
  template <class Handler>
  friend void async_teardown(boost::beast::role_type role, Stream& stream, Handler&& handler) {
    stream.tear_down(role, copyable(std::forward<Handler>(handler)));
  }

 private:
  struct Layers;
  using ReadOrWritten = std::function<void(boost::beast::error_code, std::size_t)>;

  /// Beast's handlers can only be moved; they are called once.
  template <class Handler>
  static auto copyable(Handler&& handler) {
    return [kept = std::make_shared<std::decay_t<Handler>>(std::forward<Handler>(handler))](auto... outcome) {
      std::move (*kept)(outcome...);
    };
  }
  void read_some(const GatheredBuffers<boost::asio::mutable_buffer>& buffers, ReadOrWritten handler);
  void write_some(const GatheredBuffers<boost::asio::const_buffer>& buffers, ReadOrWritten handler);
  void tear_down(boost::beast::role_type role, std::function<void(boost::beast::error_code)> handler);

  std::unique_ptr<Layers> layers_;
};

}  // namespace abcal::console
