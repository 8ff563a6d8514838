#include "app/console/connections.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/error.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <chrono>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "app/console/forwarded.h"
#include "app/console/target.h"

namespace abcal::console {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using asio::ip::tcp;

constexpr std::uint32_t kLongestHeader = 8 * 1024;
constexpr std::uint64_t kLongestBody = 1024;
constexpr std::uint64_t kLongestCertificate = 8 * 1024 * 1024;
/// Lowest rate at which a client must take a large answer, in bytes per second.
constexpr std::size_t kSlowest = 100 * 1024;
constexpr std::size_t kLongestDrain = 64 * 1024;
/// Bytes that the system may buffer for one page.
constexpr int kSendBuffer = 128 * 1024;

Caller caller_of(const Peer& peer, const HttpRequest& request) {
  Caller caller;
  // A header that occurs twice is ambiguous: Host then counts as absent, Origin as foreign.
  if (request.count(http::field::host) == 1) caller.host = view(request[http::field::host]);
  caller.origin = request.count(http::field::origin) > 1 ? "null" : view(request[http::field::origin]);
  caller.cookie = view(request[http::field::cookie]);
  caller.authorization = view(request[http::field::authorization]);
  caller.address = peer.here;
  caller.port = peer.port;
  caller.loopback = peer.loopback;
  return caller;
}

/// The value of a header that occurs once; empty if it is absent or ambiguous.
std::string_view only(const HttpRequest& request, std::string_view name) {
  return request.count({name.data(), name.size()}) == 1 ? view(request[{name.data(), name.size()}])
                                                        : std::string_view();
}

/// One connection that speaks HTTP: request by request, until it asks for the WebSocket.
class HttpConnection : public std::enable_shared_from_this<HttpConnection> {
 public:
  HttpConnection(const ServerParts& parts, Stream stream);
  ~HttpConnection();
  HttpConnection(const HttpConnection&) = delete;
  HttpConnection& operator=(const HttpConnection&) = delete;

  void begin();

 private:
  bool identify_peer();
  void read();
  /// Only a signed certificate from a person logged in may exceed kLongestBody.
  void receive_header(beast::error_code error);
  void receive_request(beast::error_code error);
  void refuse_unreadable(beast::error_code error);
  /// Behind a proxy each request may come from another client.
  void identify_client(const HttpRequest& request);
  void ask_register(const std::string& login);
  /// @param person  null if nobody is logged in
  void admit(const Persons::Known& person);
  void carry_out(Slow slow);
  void carry_out_order(Slow slow);
  /// Cancels the order of a client that has disconnected.
  void watch_client();
  void write(HttpResponse response);
  void drain(std::size_t most);

  ServerCommon& common_;
  const ServerParts& parts_;
  Stream stream_;
  Peer peer_;
  beast::flat_buffer buffer_;
  std::optional<http::request_parser<http::string_body>> parser_;
  std::optional<HttpResponse> response_;
  std::optional<SilentConnections::Ticket> ticket_;
  std::shared_ptr<void> seat_;
  Workshop::Ticket order_;  ///< The order that the client waits for.
  std::optional<asio::steady_timer> client_timer_;
};

HttpConnection::HttpConnection(const ServerParts& parts, Stream stream)
    : common_(parts.common),
      parts_(parts),
      stream_(std::move(stream)),
      buffer_(kLongestHeader + kLongestBody) {}

HttpConnection::~HttpConnection() {
  if (ticket_) common_.silent.remove(*ticket_);
}

/// @return false: the peer has already disconnected
bool HttpConnection::identify_peer() {
  beast::error_code error;
  tcp::socket& socket = stream_.next_layer().socket();
  const tcp::endpoint here = socket.local_endpoint(error);
  if (error) return false;
  const tcp::endpoint remote = socket.remote_endpoint(error);
  if (error) return false;
  const asio::ip::address address = plain_ip(here.address());
  peer_.client = plain_ip(remote.address()).to_string();
  peer_.remote = peer_.connected = fmt::format("{}:{}", host_of(plain_ip(remote.address())), remote.port());
  peer_.here = host_of(address);
  peer_.port = here.port() == (common_.options.tls ? 443 : 80) ? "" : fmt::format(":{}", here.port());
  peer_.loopback = address.is_loopback();
  peer_.secure = common_.options.tls.has_value();
  const std::vector<std::string>& proxies = common_.options.trusted_proxies;
  if (std::find(proxies.begin(), proxies.end(), peer_.client) != proxies.end()) peer_.proxy = peer_.client;
  socket.set_option(tcp::no_delay(true), error);
  socket.set_option(asio::socket_base::send_buffer_size(kSendBuffer), error);
  return true;
}

void HttpConnection::begin() {
  if (!identify_peer()) return;
  const std::weak_ptr<HttpConnection> weak = weak_from_this();
  ticket_ = common_.silent.add(peer_.proxy.empty() ? counted_address(peer_.client) : "", [weak] {
    const std::shared_ptr<HttpConnection> self = weak.lock();
    if (!self) return;
    self->ticket_.reset();
    self->common_.log_refusal(self->peer_, "a connection",
                              "there are too many that do not say who they are; the oldest was ended");
    self->stream_.next_layer().close();
  });
  stream_.next_layer().expires_after(common_.options.request_time);
  stream_.async_handshake([self = shared_from_this()](beast::error_code error) {
    if (!error) return self->read();
    if (error != asio::error::operation_aborted && error != asio::error::eof &&
        error != asio::ssl::error::stream_truncated && error != asio::error::connection_reset)
      self->common_.log_refusal(self->peer_, "a connection", "TLS: " + error.message());
  });
}

void HttpConnection::read() {
  parser_.emplace();
  parser_->header_limit(kLongestHeader);
  parser_->body_limit(kLongestCertificate);  // A longer Content-Length is an error of the header.
  stream_.next_layer().expires_after(common_.options.request_time);
  http::async_read_header(
      stream_, buffer_, *parser_,
      [self = shared_from_this()](beast::error_code error, std::size_t) { self->receive_header(error); });
}

void HttpConnection::receive_header(beast::error_code error) {
  if (error) return receive_request(error);
  const HttpRequest& request = parser_->get();
  const bool is_long = Answers::is_signed_certificate(request) &&
                       parts_.logins.find(parts_.logins.login_of(request)) != nullptr;
  if (!is_long) {
    if (parser_->content_length().value_or(0) > kLongestBody)
      return refuse_unreadable(make_error_code(http::error::body_limit));
    parser_->body_limit(kLongestBody);
  }
  http::async_read(
      stream_, buffer_, *parser_,
      [self = shared_from_this()](beast::error_code failed, std::size_t) { self->receive_request(failed); });
}

void HttpConnection::refuse_unreadable(beast::error_code error) {
  common_.log_refusal(peer_, "a request", error.message());
  http::status status = http::status::bad_request;
  if (error == http::error::header_limit || error == http::error::buffer_overflow)
    status = http::status::request_header_fields_too_large;
  if (error == http::error::body_limit) status = http::status::payload_too_large;
  HttpRequest none;
  none.version(11);
  none.keep_alive(false);
  write(plain(none, status, "The request cannot be read: " + error.message()));
}

void HttpConnection::receive_request(beast::error_code error) {
  // Silence between two requests is not logged; a request that is never completed is.
  if (error == beast::error::timeout && (buffer_.size() > 0 || parser_->got_some()))
    common_.log_refusal(peer_, "a request",
                        fmt::format("not complete after {} s", common_.options.request_time.count()));
  if (error == http::error::end_of_stream || error == beast::error::timeout ||
      error == asio::error::connection_reset || error == asio::error::eof ||
      error == asio::error::operation_aborted || error == asio::ssl::error::stream_truncated)
    return;
  if (error) return refuse_unreadable(error);
  HttpRequest& request = parser_->get();
  request.target(in_origin_form(view(request.target()), only(request, "Host")));
  identify_client(request);
  const std::string login = parts_.logins.login_of(request);
  if (login.empty()) return admit(nullptr);
  if (const Persons::Known person = parts_.logins.find(login)) return admit(person);
  ask_register(login);
}

void HttpConnection::identify_client(const HttpRequest& request) {
  if (peer_.proxy.empty()) return;
  const auto client = forwarded_client({only(request, "Forwarded"), only(request, "X-Forwarded-For")},
                                       common_.options.trusted_proxies);
  peer_.client = client.value_or(peer_.proxy);
  peer_.remote = client ? fmt::format("{} by {}", *client, peer_.connected) : peer_.connected;
}

/// Asks about a login that is not known here: made by an earlier console, or invalid.
void HttpConnection::ask_register(const std::string& login) {
  stream_.next_layer().expires_never();
  parts_.logins.look_up(login, peer_,
                        [self = shared_from_this()](const Persons::Known& person) { self->admit(person); });
}

void HttpConnection::admit(const Persons::Known& person) {
  const HttpRequest& request = parser_->get();
  Access access = judge(common_.options.access, caller_of(peer_, request));
  Visitor visitor;
  visitor.may_steer = !common_.options.access.persons;  // With a register, the token only permits watching.
  if (person && (access == Access::kGranted || access == Access::kNoToken)) {
    access = Access::kGranted;
    visitor = *person;
  }
  if (access == Access::kGranted && !seat_) {
    seat_ = common_.seats.take(counted_address(peer_.client));
    if (!seat_) {
      const std::string why = fmt::format("there are {} connections already", common_.seats.taken());
      common_.log_refusal(peer_, "a connection", why);
      return write(plain(request, http::status::service_unavailable, why));
    }
    if (ticket_) common_.silent.remove(*ticket_);
    ticket_.reset();
  }
  const Asked asked{peer_, request, access, visitor};
  if (access == Access::kGranted && websocket::is_upgrade(request) && view(request.target()) == "/live" &&
      !parts_.logins.is_proxied_unknown(request)) {
    std::make_shared<Page>(parts_.control, common_, std::move(stream_),
                           Page::Owner{peer_, visitor, std::move(seat_)})
        ->open(request);
    return;
  }
  Slow later;
  HttpResponse now = parts_.answers.answer(asked, later);
  if (later) return carry_out(std::move(later));
  write(std::move(now));
}

void HttpConnection::carry_out(Slow slow) {
  stream_.next_layer().expires_never();
  if (slow.workshop != nullptr) return carry_out_order(std::move(slow));
  asio::post(*slow.where, [self = shared_from_this(), job = std::move(slow.job)]() mutable {
    Slow::Finish finish = job();
    // Moved, so that this object is destroyed in the thread of the connections.
    asio::io_context& connections = self->common_.io;
    asio::post(connections,
               [self = std::move(self), finish = std::move(finish)]() mutable { self->write(finish()); });
  });
}

void HttpConnection::carry_out_order(Slow slow) {
  client_timer_.emplace(common_.io);
  order_ = slow.workshop->order(
      slow.name, std::move(slow.make),
      [self = shared_from_this(),
       head = std::move(slow.head)](const std::shared_ptr<const Product>& product) {
        self->order_.reset();
        self->client_timer_->cancel();
        HttpResponse response =
            respond(head, http::status(product->status), product->content_type, product->body);
        // A report has its own styles, which the security policy of the page
        // forbids.
        if (product->is_file) response.set(http::field::content_disposition, "attachment");
        self->write(std::move(response));
      },
      std::move(slow.turn));
  watch_client();
}

void HttpConnection::watch_client() {
  constexpr std::chrono::milliseconds kInterval{200};
  client_timer_->expires_after(kInterval);
  client_timer_->async_wait([self = shared_from_this()](beast::error_code cancelled) {
    if (cancelled || !self->order_) return;
    pollfd end{self->stream_.next_layer().socket().native_handle(), POLLRDHUP, 0};
    if (::poll(&end, 1, 0) <= 0 || (end.revents & (POLLRDHUP | POLLHUP | POLLERR)) == 0)
      return self->watch_client();
    self->order_.reset();
    self->stream_.next_layer().close();
  });
}

void HttpConnection::write(HttpResponse response) {
  response_ = std::move(response);
  // For a year the browser asks for this host over TLS only.
  if (peer_.secure) response_->set(http::field::strict_transport_security, "max-age=31536000");
  if (parser_->get().method() == http::verb::head) response_->body().clear();
  stream_.next_layer().expires_after(common_.options.request_time +
                                     std::chrono::seconds(response_->body().size() / kSlowest));
  http::async_write(stream_, *response_, [self = shared_from_this()](beast::error_code error, std::size_t) {
    if (error == beast::error::timeout)
      self->common_.log_refusal(self->peer_, "a connection", "its answer was not taken in time");
    if (error) return;
    if (!self->response_->need_eof()) return self->read();
    self->stream_.next_layer().socket().shutdown(tcp::socket::shutdown_send, error);
    self->drain(kLongestDrain);
  });
}

/// Reads the remaining bytes, within limits: with unread bytes the answer would be lost at closing.
void HttpConnection::drain(std::size_t most) {
  buffer_.clear();
  stream_.next_layer().async_read_some(
      buffer_.prepare(kLongestBody),
      [self = shared_from_this(), most](beast::error_code error, std::size_t got) {
        if (!error && got < most) self->drain(most - got);
      });
}

asio::ssl::context tls_context(const TlsIdentity& identity) {
  asio::ssl::context context(asio::ssl::context::tls_server);
  context.set_options(asio::ssl::context::default_workarounds | asio::ssl::context::no_tlsv1 |
                      asio::ssl::context::no_tlsv1_1);
  context.use_certificate_chain(asio::buffer(identity.certificate_pem));
  context.use_private_key(asio::buffer(identity.key_pem), asio::ssl::context::pem);
  return context;
}

}  // namespace

Connections::Connections(const ServerParts& parts)
    : parts_(parts), acceptor_(parts.common.io), accept_again_(parts.common.io) {
  const ServerOptions& options = parts.common.options;
  if (options.tls) tls_.emplace(tls_context(*options.tls));
  try {
    const tcp::endpoint endpoint(asio::ip::make_address(options.address), options.port);
    acceptor_.open(endpoint.protocol());
    acceptor_.set_option(asio::socket_base::reuse_address(true));
    acceptor_.bind(endpoint);
    acceptor_.listen();
  } catch (const boost::system::system_error& error) {
    throw std::runtime_error(fmt::format("the console cannot listen on {}, port {}: {}", options.address,
                                         options.port, error.code().message()));
  }
}

void Connections::accept() {
  acceptor_.async_accept([this](beast::error_code error, tcp::socket socket) {
    if (error == asio::error::operation_aborted) return;
    if (error) {
      // Probably no descriptors are left; some become free later.
      accept_again_.expires_after(std::chrono::milliseconds(100));
      accept_again_.async_wait([this](beast::error_code cancelled) {
        if (!cancelled) accept();
      });
      return;
    }
    std::make_shared<HttpConnection>(parts_, Stream(std::move(socket), tls_ ? &*tls_ : nullptr))->begin();
    accept();
  });
}

}  // namespace abcal::console
