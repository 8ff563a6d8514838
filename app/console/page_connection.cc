#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/error.hpp>
#include <utility>

#include "app/console/forwarded.h"
#include "app/console/server_impl.h"
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
/// Bytes a second at which a large answer must be taken.
constexpr std::size_t kSlowest = 100 * 1024;
constexpr std::size_t kLongestDrain = 64 * 1024;
/// What the system may buffer for one page.
constexpr int kSendBuffer = 128 * 1024;

Caller caller_of(const Peer& peer, const HttpRequest& request) {
  Caller caller;
  // With two it is not known which one counts: neither does.
  if (request.count(http::field::host) == 1) caller.host = view(request[http::field::host]);
  caller.origin = request.count(http::field::origin) > 1 ? "null" : view(request[http::field::origin]);
  caller.cookie = view(request[http::field::cookie]);
  caller.authorization = view(request[http::field::authorization]);
  caller.address = peer.here;
  caller.port = peer.port;
  caller.loopback = peer.loopback;
  return caller;
}

/// The value of a header that stands there once; else nothing that can be relied on.
std::string_view only(const HttpRequest& request, std::string_view name) {
  return request.count({name.data(), name.size()}) == 1 ? view(request[{name.data(), name.size()}])
                                                        : std::string_view();
}

}  // namespace

// ---- A page

Server::Impl::Page::Page(Impl& server, Stream stream, Peer peer, Visitor visitor, std::shared_ptr<void> seat)
    : server_(server),
      socket_(std::move(stream)),
      peer_(std::move(peer)),
      visitor_(std::move(visitor)),
      seat_(std::move(seat)) {}

Asker Server::Impl::Page::asker() const {
  return {fmt::format("page {} at {}", number, peer_.remote), visitor_.who, visitor_.login};
}

void Server::Impl::Page::open(const HttpRequest& request) {
  websocket::stream_base::timeout limits{};
  limits.handshake_timeout = server_.options.request_time;
  limits.idle_timeout = server_.options.silent_time;
  limits.keep_alive_pings = true;
  beast::get_lowest_layer(socket_).expires_never();  // The WebSocket has its own.
  socket_.set_option(limits);
  socket_.read_message_max(kLongestRequest);
  socket_.text(true);
  socket_.async_accept(request, [self = shared_from_this()](beast::error_code error) {
    if (error) return;
    self->server_.arrived(self);
    self->read();
  });
}

void Server::Impl::Page::send(const SharedText& message) {
  if (behind_) return;
  if (queue_.size() >= server_.options.longest_queue) {
    std::erase_if(queue_, [](const Waiting& waiting) { return !waiting.is_reply; });
    behind_ = true;
    return;
  }
  push({message, false});
}

void Server::Impl::Page::reply(std::string message) {
  ++replies_;
  push({std::make_shared<const std::string>(std::move(message)), true});
}

void Server::Impl::Page::close() {
  beast::get_lowest_layer(socket_).close();  // Whatever is under way ends with an error.
}

void Server::Impl::Page::push(Waiting message) {
  queue_.push_back(std::move(message));
  if (!writing_) write();
}

void Server::Impl::Page::read() {
  socket_.async_read(buffer_, [self = shared_from_this()](beast::error_code error, std::size_t) {
    if (error) {
      // One of the two: the frame states its length, or the bytes go on to the end.
      if (error == websocket::error::message_too_big || error == websocket::error::buffer_overflow)
        self->server_.log_refusal(self->peer_, "a message",
                                  fmt::format("longer than {} bytes", kLongestRequest));
      self->server_.left(*self);
      return;
    }
    const auto data = self->buffer_.cdata();
    self->server_.received(*self, {static_cast<const char*>(data.data()), data.size()});
    self->buffer_.consume(self->buffer_.size());
    self->paused_ = self->replies_ >= self->server_.options.longest_queue;
    if (!self->paused_) self->read();
  });
}

void Server::Impl::Page::write() {
  writing_ = true;
  now_ = std::move(queue_.front());
  queue_.pop_front();
  socket_.async_write(asio::buffer(*now_.text),
                      [self = shared_from_this()](beast::error_code error, std::size_t) {
                        self->writing_ = false;
                        if (error) {
                          self->server_.left(*self);
                          return;
                        }
                        if (self->now_.is_reply) --self->replies_;
                        if (self->paused_ && self->replies_ < self->server_.options.longest_queue) {
                          self->paused_ = false;
                          self->read();
                        }
                        if (std::exchange(self->behind_, false)) self->server_.send_snapshot(*self);
                        if (!self->writing_ && !self->queue_.empty()) self->write();
                      });
}

// ---- A connection

Server::Impl::HttpConnection::HttpConnection(Impl& server, tcp::socket socket)
    : server_(server),
      stream_(std::move(socket), server.tls ? &*server.tls : nullptr),
      buffer_(kLongestHeader + kLongestBody) {}

Server::Impl::HttpConnection::~HttpConnection() {
  if (ticket_) server_.silent.left(*ticket_);
}

/// @return false: it has gone already
bool Server::Impl::HttpConnection::know_peer() {
  beast::error_code error;
  tcp::socket& socket = stream_.next_layer().socket();
  const tcp::endpoint here = socket.local_endpoint(error);
  if (error) return false;
  const tcp::endpoint there = socket.remote_endpoint(error);
  if (error) return false;
  const asio::ip::address address = plain_ip(here.address());
  peer_.client = plain_ip(there.address()).to_string();
  peer_.remote = peer_.connected = fmt::format("{}:{}", host_of(plain_ip(there.address())), there.port());
  peer_.here = host_of(address);
  peer_.port = here.port() == (server_.tls ? 443 : 80) ? "" : fmt::format(":{}", here.port());
  peer_.loopback = address.is_loopback();
  peer_.secure = server_.tls.has_value();
  const std::vector<std::string>& proxies = server_.options.trusted_proxies;
  if (std::find(proxies.begin(), proxies.end(), peer_.client) != proxies.end()) peer_.proxy = peer_.client;
  socket.set_option(tcp::no_delay(true), error);
  socket.set_option(asio::socket_base::send_buffer_size(kSendBuffer), error);
  return true;
}

void Server::Impl::HttpConnection::begin() {
  if (!know_peer()) return;
  const std::weak_ptr<HttpConnection> weak = weak_from_this();
  ticket_ = server_.silent.arrived(peer_.proxy.empty() ? counted_address(peer_.client) : "", [weak] {
    const std::shared_ptr<HttpConnection> self = weak.lock();
    if (!self) return;
    self->ticket_.reset();
    self->server_.log_refusal(self->peer_, "a connection",
                              "there are too many that do not say who they are; the oldest was ended");
    self->stream_.next_layer().close();
  });
  stream_.next_layer().expires_after(server_.options.request_time);
  stream_.async_handshake([self = shared_from_this()](beast::error_code error) {
    if (!error) return self->read();
    if (error != asio::error::operation_aborted && error != asio::error::eof &&
        error != asio::ssl::error::stream_truncated && error != asio::error::connection_reset)
      self->server_.log_refusal(self->peer_, "a connection", "TLS: " + error.message());
  });
}

void Server::Impl::HttpConnection::read() {
  parser_.emplace();
  parser_->header_limit(kLongestHeader);
  parser_->body_limit(kLongestCertificate);  // A length beyond it ends the header with an error.
  stream_.next_layer().expires_after(server_.options.request_time);
  http::async_read_header(
      stream_, buffer_, *parser_,
      [self = shared_from_this()](beast::error_code error, std::size_t) { self->have_header(error); });
}

void Server::Impl::HttpConnection::have_header(beast::error_code error) {
  if (error) return have_read(error);
  const HttpRequest& request = parser_->get();
  const bool is_long = is_signed_certificate(request) &&
                       server_.persons.find(server_.login_of(request), server_.clock.utc_now()) != nullptr;
  if (!is_long) {
    if (parser_->content_length().value_or(0) > kLongestBody)
      return refuse_unreadable(make_error_code(http::error::body_limit));
    parser_->body_limit(kLongestBody);
  }
  http::async_read(
      stream_, buffer_, *parser_,
      [self = shared_from_this()](beast::error_code failed, std::size_t) { self->have_read(failed); });
}

void Server::Impl::HttpConnection::refuse_unreadable(beast::error_code error) {
  server_.log_refusal(peer_, "a request", error.message());
  http::status status = http::status::bad_request;
  if (error == http::error::header_limit || error == http::error::buffer_overflow)
    status = http::status::request_header_fields_too_large;
  if (error == http::error::body_limit) status = http::status::payload_too_large;
  HttpRequest none;
  none.version(11);
  none.keep_alive(false);
  write(plain(none, status, "The request cannot be read: " + error.message()));
}

void Server::Impl::HttpConnection::have_read(beast::error_code error) {
  // Silence between two requests is no offence; a request that never ends is.
  if (error == beast::error::timeout && (buffer_.size() > 0 || parser_->got_some()))
    server_.log_refusal(peer_, "a request",
                        fmt::format("not complete after {} s", server_.options.request_time.count()));
  if (error == http::error::end_of_stream || error == beast::error::timeout ||
      error == asio::error::connection_reset || error == asio::error::eof ||
      error == asio::error::operation_aborted || error == asio::ssl::error::stream_truncated)
    return;
  if (error) return refuse_unreadable(error);
  HttpRequest& request = parser_->get();
  request.target(in_origin_form(view(request.target()), only(request, "Host")));
  know_client(request);
  const std::string login = server_.login_of(request);
  if (login.empty()) return admit(nullptr);
  if (const Persons::Known person = server_.persons.find(login, server_.clock.utc_now()))
    return admit(person);
  ask_register(login);
}

void Server::Impl::HttpConnection::know_client(const HttpRequest& request) {
  if (peer_.proxy.empty()) return;
  const auto client = forwarded_client({only(request, "Forwarded"), only(request, "X-Forwarded-For")},
                                       server_.options.trusted_proxies);
  peer_.client = client.value_or(peer_.proxy);
  peer_.remote = client ? fmt::format("{} by {}", *client, peer_.connected) : peer_.connected;
}

/// A login that is not known here: of a console before this one, or of nobody.
void Server::Impl::HttpConnection::ask_register(const std::string& login) {
  stream_.next_layer().expires_never();
  asio::post(server_.door, [self = shared_from_this(), login]() mutable {
    Impl& server = self->server_;
    std::optional<Visitor> person;
    std::string problem;
    try {
      person = register_of_persons::look_up(server.options.register_location, login, server.clock.utc_now());
    } catch (const std::exception& error) {
      problem = error.what();
    }
    // Moved, so that this connection ends in the thread of the connections.
    asio::post(server.io, [self = std::move(self), person = std::move(person), problem]() mutable {
      if (!person) self->server_.log_refusal(self->peer_, "a login", problem);
      self->admit(person ? self->server_.persons.remember(*std::move(person)) : nullptr);
    });
  });
}

void Server::Impl::HttpConnection::admit(const Persons::Known& person) {
  const HttpRequest& request = parser_->get();
  Access access = judge(server_.options.access, caller_of(peer_, request));
  Visitor visitor;
  visitor.may_steer = !server_.options.access.persons;  // Where there are persons, the token lets watch.
  if (person && (access == Access::kGranted || access == Access::kNoToken)) {
    access = Access::kGranted;
    visitor = *person;
  }
  if (access == Access::kGranted && !seat_) {
    seat_ = server_.take_seat(counted_address(peer_.client));
    if (!seat_) {
      const std::string why = fmt::format("there are {} connections already", server_.seats);
      server_.log_refusal(peer_, "a connection", why);
      return write(plain(request, http::status::service_unavailable, why));
    }
    if (ticket_) server_.silent.left(*ticket_);
    ticket_.reset();
  }
  const Asked asked{peer_, request, access, visitor};
  if (access == Access::kGranted && websocket::is_upgrade(request) && view(request.target()) == "/live" &&
      !server_.is_proxied_unknown(request)) {
    std::make_shared<Page>(server_, std::move(stream_), peer_, visitor, std::move(seat_))->open(request);
    return;
  }
  Slow later;
  HttpResponse now = server_.answer(asked, later);
  if (later) return carry_out(std::move(later));
  write(std::move(now));
}

void Server::Impl::HttpConnection::carry_out(Slow slow) {
  stream_.next_layer().expires_never();
  if (slow.workshop != nullptr) return carry_out_order(std::move(slow));
  asio::post(*slow.where, [self = shared_from_this(), job = std::move(slow.job)]() mutable {
    Slow::Finish finish = job();
    // Moved, so that this connection ends in the thread of the connections.
    asio::io_context& connections = self->server_.io;
    asio::post(connections,
               [self = std::move(self), finish = std::move(finish)]() mutable { self->write(finish()); });
  });
}

void Server::Impl::HttpConnection::carry_out_order(Slow slow) {
  look_.emplace(server_.io);
  order_ = slow.workshop->order(slow.name, std::move(slow.make),
                                [self = shared_from_this(),
                                 head = std::move(slow.head)](const std::shared_ptr<const Product>& product) {
                                  self->order_.reset();
                                  self->look_->cancel();
                                  HttpResponse response = respond(head, http::status(product->status),
                                                                  product->content_type, product->body);
                                  // A report has styles of its own, which this page's policy forbids.
                                  if (product->is_file)
                                    response.set(http::field::content_disposition, "attachment");
                                  self->write(std::move(response));
                                });
  watch_client();
}

void Server::Impl::HttpConnection::watch_client() {
  constexpr std::chrono::milliseconds kLook{200};
  look_->expires_after(kLook);
  look_->async_wait([self = shared_from_this()](beast::error_code cancelled) {
    if (cancelled || !self->order_) return;
    pollfd end{self->stream_.next_layer().socket().native_handle(), POLLRDHUP, 0};
    if (::poll(&end, 1, 0) <= 0 || (end.revents & (POLLRDHUP | POLLHUP | POLLERR)) == 0)
      return self->watch_client();
    self->order_.reset();
    self->stream_.next_layer().close();
  });
}

void Server::Impl::HttpConnection::write(HttpResponse response) {
  response_ = std::move(response);
  if (parser_->get().method() == http::verb::head) response_->body().clear();
  stream_.next_layer().expires_after(server_.options.request_time +
                                     std::chrono::seconds(response_->body().size() / kSlowest));
  http::async_write(stream_, *response_, [self = shared_from_this()](beast::error_code error, std::size_t) {
    if (error == beast::error::timeout)
      self->server_.log_refusal(self->peer_, "a connection", "its answer was not taken in time");
    if (error) return;
    if (!self->response_->need_eof()) return self->read();
    self->stream_.next_layer().socket().shutdown(tcp::socket::shutdown_send, error);
    self->drain(kLongestDrain);
  });
}

/// Reads the remaining bytes, within limits: with unread bytes the answer would be lost at closing.
void Server::Impl::HttpConnection::drain(std::size_t most) {
  buffer_.clear();
  stream_.next_layer().async_read_some(
      buffer_.prepare(kLongestBody),
      [self = shared_from_this(), most](beast::error_code error, std::size_t got) {
        if (!error && got < most) self->drain(most - got);
      });
}

}  // namespace abcal::console
