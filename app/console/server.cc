#include "app/console/server.h"

#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/bind_executor.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <deque>
#include <future>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <thread>
#include <utility>

#include "app/bench/real_clock.h"
#include "app/console/asset.h"
#include "app/console/bench_link.h"
#include "app/console/bench_service.h"
#include "app/console/download.h"
#include "app/console/request.h"
#include "app/console/run_library.h"
#include "app/console/target.h"
#include "app/system/output.h"
#include "app/system/version.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal::console {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using asio::ip::tcp;
using Json = nlohmann::ordered_json;
using Text = std::shared_ptr<const std::string>;

constexpr std::uint32_t kLongestHeader = 8 * 1024;
constexpr std::uint64_t kLongestBody = 1024;
/// Bytes a second at which a large answer must be taken.
constexpr std::size_t kSlowest = 100 * 1024;
constexpr std::size_t kLongestDrain = 64 * 1024;
/// What the system may buffer for one page.
constexpr int kSendBuffer = 128 * 1024;
constexpr std::chrono::seconds kBeat{1};
/// After this time without an answer to a beat nothing is known of the other end.
constexpr std::chrono::seconds kSilent{3};

std::string_view view(beast::string_view text) {
  return {text.data(), text.size()};
}

/// The end of a connection here, as a Host header names it.
std::string host_of(asio::ip::address address) {
  if (address.is_v6() && address.to_v6().is_v4_mapped())
    address = asio::ip::make_address_v4(asio::ip::v4_mapped, address.to_v6());
  return address.is_v6() ? "[" + address.to_string() + "]" : address.to_string();
}

bool is_loopback(const asio::ip::address& address) {
  if (address.is_v6() && address.to_v6().is_v4_mapped())
    return asio::ip::make_address_v4(asio::ip::v4_mapped, address.to_v6()).is_loopback();
  return address.is_loopback();
}

std::string_view content_type(std::string_view path) {
  if (path.ends_with(".html")) return "text/html; charset=utf-8";
  if (path.ends_with(".css")) return "text/css; charset=utf-8";
  if (path.ends_with(".js")) return "text/javascript; charset=utf-8";
  if (path.ends_with(".svg")) return "image/svg+xml";
  return "application/octet-stream";
}

using HttpRequest = http::request<http::string_body>;
using HttpResponse = http::response<http::string_body>;

/// Who speaks, for the log and for the rules of access.
struct Peer {
  std::string remote;   ///< "127.0.0.1:50000"
  std::string address;  ///< As in Caller.
  std::string port;
  bool loopback = false;
};

Caller caller_of(const Peer& peer, const HttpRequest& request) {
  Caller caller;
  // With two it is not known which one counts: neither does.
  if (request.count(http::field::host) == 1) caller.host = view(request[http::field::host]);
  caller.origin = request.count(http::field::origin) > 1 ? "null" : view(request[http::field::origin]);
  caller.cookie = view(request[http::field::cookie]);
  caller.authorization = view(request[http::field::authorization]);
  caller.address = peer.address;
  caller.port = peer.port;
  caller.loopback = peer.loopback;
  return caller;
}

/// Logs refusals with their origin and reason, at a limited rate so that a flood does not hide other lines.
/// For one thread.
class RefusalLog {
 public:
  explicit RefusalLog(const Clock& clock) : clock_(clock) {}

  void operator()(const Peer& peer, std::string_view what, std::string_view why) {
    constexpr int kMost = 50;
    constexpr Clock::Duration kWhile = std::chrono::seconds(10);
    constexpr std::size_t kShown = 200;
    const Clock::Instant now = clock_.now();
    if (now - since_ > kWhile) {
      if (count_ > kMost) print_warning(fmt::format("console: {} more were refused", count_ - kMost));
      since_ = now;
      count_ = 0;
    }
    if (++count_ > kMost) return;
    print_warning(fmt::format("console: refused from {}: {}: {}", peer.remote,
                              wire::bytes_as_text(what.substr(0, kShown)), why));
  }

 private:
  const Clock& clock_;
  Clock::Instant since_{};
  int count_ = 0;
};

HttpResponse respond(const HttpRequest& request, http::status status, std::string_view type,
                     std::string body) {
  HttpResponse response(status, request.version());
  response.set(http::field::server, "abcal");
  response.set(http::field::content_type, {type.data(), type.size()});
  response.set(http::field::cache_control, "no-store");
  response.set("Content-Security-Policy",
               "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
               "form-action 'self'; base-uri 'none'; frame-ancestors 'none'");
  response.set("X-Content-Type-Options", "nosniff");
  response.set("X-Frame-Options", "DENY");
  response.set("Referrer-Policy", "no-referrer");
  response.set("Cross-Origin-Opener-Policy", "same-origin");
  response.set("Cross-Origin-Resource-Policy", "same-origin");
  response.keep_alive(request.keep_alive());
  response.body() = std::move(body);
  response.prepare_payload();
  return response;
}

HttpResponse plain(const HttpRequest& request, http::status status, std::string text) {
  return respond(request, status, "text/plain; charset=utf-8", std::move(text) + "\n");
}

}  // namespace

struct Server::Impl {
  class Page;
  class HttpConnection;

  Impl(ServerOptions the_options, Session::Options bench_options);
  ~Impl();

  void accept();
  void broadcast(Text text);
  void send_snapshot(Page& page);
  void have_snapshot(std::string_view json);
  void bench_is(BenchState state, const std::string& words);
  void answered(const Json& reply);
  void arrived(const std::shared_ptr<Page>& page);
  void left(Page& page);
  void received(Page& page, std::string_view text);
  Session::Refusal take_control(Page& page, const TakeControl& take);
  void give_control(Page* page);
  void look_at_controller();
  std::string control_message() const;
  std::string bench_message() const;
  bool end(bool leave_running);
  HttpResponse answer(const Peer& peer, const HttpRequest& request, std::function<HttpResponse()>& later);
  std::function<HttpResponse()> library_job(const std::vector<std::string>& words,
                                            const HttpRequest& request);

  ServerOptions options;
  RealClock clock;
  RefusalLog log_refusal{clock};
  RunLibrary library;
  std::size_t connections = 0;
  asio::io_context io;
  tcp::acceptor acceptor{io};
  asio::steady_timer accept_again{io};
  asio::steady_timer next_look{io};
  std::unique_ptr<BenchLink> bench;
  BenchState bench_state = BenchState::kStarting;
  std::string bench_words = "The process that holds the bench is being started.";
  /// Requests that were passed on, and who waits for the reply.
  struct Asked {
    std::weak_ptr<Page> page;
    std::int64_t id = 0;
    std::string text;
  };
  std::map<std::uint64_t, Asked> asked;
  std::uint64_t asked_so_far = 0;
  std::promise<bool> bench_closed;
  bool bench_is_closed = false;
  std::set<std::shared_ptr<Page>> pages;
  Page* controller = nullptr;
  bool controller_silent = false;
  std::int64_t pages_so_far = 0;
  asio::thread_pool reader{1};  ///< Reads and analyses runs.
  std::jthread thread;
};

/// A page that watches. Writes one message at a time; what waits is bounded.
class Server::Impl::Page : public std::enable_shared_from_this<Page> {
 public:
  Page(Impl& server, beast::tcp_stream stream, Peer peer)
      : server_(server), socket_(std::move(stream)), peer_(std::move(peer)) {}
  ~Page() { --server_.connections; }
  Page(const Page&) = delete;
  Page& operator=(const Page&) = delete;

  const Peer& peer() const { return peer_; }
  std::string in_words() const { return fmt::format("page {} at {}", number, peer_.remote); }
  std::int64_t number = 0;
  Clock::Instant heard{};           ///< Its last message.
  bool waits_for_snapshot = false;  ///< Nothing else makes sense before.

  void open(const HttpRequest& request) {
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

  /// Sends an event to the page; dropped if the page is too slow.
  void send(const Text& message) {
    if (behind_) return;
    if (queue_.size() >= server_.options.longest_queue) {
      std::erase_if(queue_, [](const Waiting& waiting) { return !waiting.is_reply; });
      behind_ = true;
      return;
    }
    push({message, false});
  }
  /// Answers a request of the page; never dropped.
  void reply(std::string message) {
    ++replies_;
    push({std::make_shared<const std::string>(std::move(message)), true});
  }

 private:
  struct Waiting {
    Text text;
    bool is_reply;
  };

  void push(Waiting message) {
    queue_.push_back(std::move(message));
    if (!writing_) write();
  }

  void read() {
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

  void write() {
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

  Impl& server_;
  websocket::stream<beast::tcp_stream> socket_;
  Peer peer_;
  beast::flat_buffer buffer_{kLongestRequest};
  std::deque<Waiting> queue_;
  Waiting now_{};            ///< Being written.
  std::size_t replies_ = 0;  ///< Not yet written.
  bool paused_ = false;      ///< Nothing is read until replies are sent.
  bool writing_ = false;
  bool behind_ = false;
};

/// One connection that speaks HTTP: request by request, until it asks for the WebSocket.
class Server::Impl::HttpConnection : public std::enable_shared_from_this<HttpConnection> {
 public:
  HttpConnection(Impl& server, tcp::socket socket) : server_(server), stream_(std::move(socket)) {
    ++server_.connections;
  }
  ~HttpConnection() {
    if (!handed_over_) --server_.connections;
  }
  HttpConnection(const HttpConnection&) = delete;
  HttpConnection& operator=(const HttpConnection&) = delete;

  void begin() {
    beast::error_code error;
    tcp::socket& socket = stream_.socket();
    const tcp::endpoint here = socket.local_endpoint(error);
    if (error) return;
    const tcp::endpoint there = socket.remote_endpoint(error);
    if (error) return;
    peer_ = {fmt::format("{}:{}", host_of(there.address()), there.port()), host_of(here.address()),
             here.port() == 80 ? "" : fmt::format(":{}", here.port()), is_loopback(here.address())};
    socket.set_option(tcp::no_delay(true), error);
    socket.set_option(asio::socket_base::send_buffer_size(kSendBuffer), error);
    if (server_.connections > server_.options.most_connections) {
      server_.log_refusal(peer_, "a connection",
                          fmt::format("there are {} already", server_.connections - 1));
      return;
    }
    read();
  }

 private:
  void read() {
    parser_.emplace();
    parser_->header_limit(kLongestHeader);
    parser_->body_limit(kLongestBody);
    stream_.expires_after(server_.options.request_time);
    http::async_read(
        stream_, buffer_, *parser_,
        [self = shared_from_this()](beast::error_code error, std::size_t) { self->have_read(error); });
  }

  void have_read(beast::error_code error) {
    // Silence between two requests is no offence; a request that never ends is.
    if (error == beast::error::timeout && (buffer_.size() > 0 || parser_->got_some()))
      server_.log_refusal(peer_, "a request",
                          fmt::format("not complete after {} s", server_.options.request_time.count()));
    if (error == http::error::end_of_stream || error == beast::error::timeout ||
        error == asio::error::connection_reset || error == asio::error::eof)
      return;
    if (error) {
      server_.log_refusal(peer_, "a request", error.message());
      http::status status = http::status::bad_request;
      if (error == http::error::header_limit || error == http::error::buffer_overflow)
        status = http::status::request_header_fields_too_large;
      if (error == http::error::body_limit) status = http::status::payload_too_large;
      HttpRequest none;
      none.version(11);
      none.keep_alive(false);
      return write(plain(none, status, "The request cannot be read: " + error.message()));
    }
    const HttpRequest& request = parser_->get();
    if (websocket::is_upgrade(request) && view(request.target()) == "/live") {
      if (judge(server_.options.access, caller_of(peer_, request)) == Access::kGranted) {
        handed_over_ = true;
        std::make_shared<Page>(server_, std::move(stream_), peer_)->open(request);
        return;
      }
    }
    std::function<HttpResponse()> later;
    HttpResponse now = server_.answer(peer_, request, later);
    if (!later) return write(std::move(now));
    stream_.expires_never();
    asio::post(server_.reader, [self = shared_from_this(), later = std::move(later)]() mutable {
      HttpResponse response = later();
      // Moved, so that this connection ends in the thread of the connections.
      asio::io_context& of_connections = self->server_.io;
      asio::post(of_connections, [self = std::move(self), response = std::move(response)]() mutable {
        self->write(std::move(response));
      });
    });
  }

  void write(HttpResponse response) {
    response_ = std::move(response);
    if (parser_->get().method() == http::verb::head) response_->body().clear();
    stream_.expires_after(server_.options.request_time +
                          std::chrono::seconds(response_->body().size() / kSlowest));
    http::async_write(stream_, *response_, [self = shared_from_this()](beast::error_code error, std::size_t) {
      if (error == beast::error::timeout)
        self->server_.log_refusal(self->peer_, "a connection", "its answer was not taken in time");
      if (error) return;
      if (!self->response_->need_eof()) return self->read();
      self->stream_.socket().shutdown(tcp::socket::shutdown_send, error);
      self->drain(kLongestDrain);
    });
  }

  /// Reads the remaining bytes, within limits: with unread bytes the answer would be lost at closing.
  void drain(std::size_t most) {
    buffer_.clear();
    stream_.async_read_some(buffer_.prepare(kLongestBody),
                            [self = shared_from_this(), most](beast::error_code error, std::size_t got) {
                              if (!error && got < most) self->drain(most - got);
                            });
  }

  Impl& server_;
  beast::tcp_stream stream_;
  Peer peer_;
  beast::flat_buffer buffer_{kLongestHeader + kLongestBody};
  std::optional<http::request_parser<http::string_body>> parser_;
  std::optional<HttpResponse> response_;
  bool handed_over_ = false;
};

Server::Impl::Impl(ServerOptions the_options, Session::Options bench_options)
    : options(std::move(the_options)), library(bench_options.runs) {
  try {
    const tcp::endpoint endpoint(asio::ip::make_address(options.address), options.port);
    acceptor.open(endpoint.protocol());
    acceptor.set_option(asio::socket_base::reuse_address(true));
    acceptor.bind(endpoint);
    acceptor.listen();
  } catch (const boost::system::system_error& error) {
    throw std::runtime_error(fmt::format("the console cannot listen on {}, port {}: {}", options.address,
                                         options.port, error.code().message()));
  }
  const auto text = [](std::string_view json) { return std::make_shared<const std::string>(json); };
  BenchLink::Listener listener;
  listener.message = [this, text](std::string_view json) { broadcast(text(json)); };
  listener.snapshot = [this](std::string_view json) { have_snapshot(json); };
  listener.reply = [this](const Json& reply) { answered(reply); };
  listener.state = [this](BenchState state, const std::string& words) { bench_is(state, words); };
  listener.end = [this](bool was_on) {
    if (!std::exchange(bench_is_closed, true)) bench_closed.set_value(was_on);
  };
  const bool is_service = !options.bench_socket.empty();
  const std::filesystem::path socket =
      is_service ? options.bench_socket : default_bench_socket(bench_options);
  bench = std::make_unique<BenchLink>(io, BenchLink::Options{std::move(bench_options), socket, !is_service},
                                      std::move(listener));
  options.access.cookie = fmt::format("abcal_token_{}", acceptor.local_endpoint().port());
  asio::post(reader, [] {
    // Reading an old run leaves the processor to the current run.
    constexpr int kLessThanMeasuring = 10;
    ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kLessThanMeasuring);
  });
  accept();
  look_at_controller();
  bench->begin();
  thread = std::jthread([this] { io.run(); });
}

Server::Impl::~Impl() {
  io.stop();
  thread = {};
  reader.stop();
  reader.join();
  controller = nullptr;
  pages.clear();
}

void Server::Impl::accept() {
  acceptor.async_accept([this](beast::error_code error, tcp::socket socket) {
    if (error == asio::error::operation_aborted) return;
    if (error) {
      // No descriptors left, most likely: they come back.
      accept_again.expires_after(std::chrono::milliseconds(100));
      accept_again.async_wait([this](beast::error_code cancelled) {
        if (!cancelled) accept();
      });
      return;
    }
    std::make_shared<HttpConnection>(*this, std::move(socket))->begin();
    accept();
  });
}

/// Each second: whether the page that steers still answers the beats.
void Server::Impl::look_at_controller() {
  next_look.expires_after(kBeat);
  next_look.async_wait([this](beast::error_code cancelled) {
    if (cancelled) return;
    const bool silent = controller != nullptr && clock.now() - controller->heard > kSilent;
    if (std::exchange(controller_silent, silent) != silent)
      broadcast(std::make_shared<const std::string>(control_message()));
    look_at_controller();
  });
}

void Server::Impl::broadcast(Text text) {
  for (const std::shared_ptr<Page>& page : pages)
    if (!page->waits_for_snapshot) page->send(text);
}

void Server::Impl::have_snapshot(std::string_view json) {
  const Text text = std::make_shared<const std::string>(json);
  const Text control = std::make_shared<const std::string>(control_message());
  for (const std::shared_ptr<Page>& page : pages) {
    if (!std::exchange(page->waits_for_snapshot, false)) continue;
    page->send(text);
    page->send(control);
  }
}

std::string Server::Impl::bench_message() const {
  return Json{{"type", "bench"}, {"state", to_string(bench_state)}, {"words", bench_words}}.dump();
}

/// The process that holds the bench has come or gone.
void Server::Impl::bench_is(BenchState state, const std::string& words) {
  bench_state = state;
  bench_words = words;
  const Text text = std::make_shared<const std::string>(bench_message());
  for (const std::shared_ptr<Page>& page : pages) page->send(text);
  if (state == BenchState::kGone) {
    for (const auto& [number, request] : std::exchange(asked, {})) {
      if (const std::shared_ptr<Page> page = request.page.lock())
        page->reply(Json{{"type", "reply"}, {"id", request.id}, {"ok", false}, {"lost", true}, {"why", words}}
                        .dump());
    }
  }
  if (state != BenchState::kOn) return;
  for (const std::shared_ptr<Page>& page : pages) page->waits_for_snapshot = true;
  bench->ask_snapshot();
}

void Server::Impl::arrived(const std::shared_ptr<Page>& page) {
  page->number = ++pages_so_far;
  page->heard = clock.now();
  pages.insert(page);
  page->send(std::make_shared<const std::string>(Json{{"type", "you"}, {"number", page->number}}.dump()));
  if (bench_state != BenchState::kOn) page->send(std::make_shared<const std::string>(bench_message()));
  send_snapshot(*page);
}

/// The whole state, for a page that begins or has missed messages.
void Server::Impl::send_snapshot(Page& page) {
  const bool is_asked =
      std::any_of(pages.begin(), pages.end(), [](const auto& other) { return other->waits_for_snapshot; });
  page.waits_for_snapshot = true;
  if (!is_asked) bench->ask_snapshot();
}

std::string Server::Impl::control_message() const {
  Json message = {{"type", "control"}, {"page", nullptr}};
  if (controller != nullptr) {
    message["page"] = controller->number;
    message["who"] = controller->in_words();
    message["silent"] = controller_silent;
  }
  return message.dump();
}

void Server::Impl::left(Page& page) {
  if (controller == &page) give_control(nullptr);
  pages.erase(page.shared_from_this());
}

void Server::Impl::give_control(Page* page) {
  controller = page;
  controller_silent = false;
  broadcast(std::make_shared<const std::string>(control_message()));
}

void Server::Impl::received(Page& page, std::string_view text) {
  Json reply = {{"type", "reply"}, {"id", 0}, {"ok", false}};
  page.heard = clock.now();
  try {
    const Request request = parse_request(text);
    if (std::holds_alternative<Beat>(request.command)) return;
    reply["id"] = request.id;
    Session::Refusal refusal;
    if (const auto* take = std::get_if<TakeControl>(&request.command)) {
      refusal = take_control(page, *take);
    } else if (controller != &page && !std::holds_alternative<Stop>(request.command)) {
      // Who sees that something goes wrong stops it, with control or without.
      refusal = "this page only watches; take control first";
    } else if (std::holds_alternative<ReleaseControl>(request.command)) {
      give_control(nullptr);
    } else if (!bench->is_on()) {
      refusal = "the process that holds the bench is not there";
    } else {
      asked[++asked_so_far] = {page.weak_from_this(), request.id, std::string(text)};
      return bench->request(asked_so_far, page.in_words(), text);
    }
    if (refusal) throw RequestError(*refusal);
    reply["ok"] = true;
  } catch (const RequestError& error) {
    log_refusal(page.peer(), text, error.what());
    reply["why"] = error.what();
  }
  page.reply(reply.dump(-1, ' ', false, Json::error_handler_t::replace));
}

/// The bench has answered a request that was passed on.
void Server::Impl::answered(const Json& reply) {
  const auto found = asked.find(reply.at("id").get<std::uint64_t>());
  if (found == asked.end()) return;
  const Asked request = std::move(found->second);
  asked.erase(found);
  const std::shared_ptr<Page> page = request.page.lock();
  if (!page) return;
  Json message = {{"type", "reply"}, {"id", request.id}, {"ok", reply.at("ok")}};
  if (!reply.at("ok").get<bool>()) {
    message["why"] = reply.at("why");
    log_refusal(page->peer(), request.text, reply.at("why").get<std::string>());
  }
  page->reply(message.dump(-1, ' ', false, Json::error_handler_t::replace));
}

Session::Refusal Server::Impl::take_control(Page& page, const TakeControl& take) {
  if (controller != nullptr && controller != &page && !take.from_another)
    return fmt::format("{} steers; take control from it first", controller->in_words());
  give_control(&page);
  return std::nullopt;
}

/// In the thread of whoever serves: ends the bench, or leaves it alone. @return whether something was on
bool Server::Impl::end(bool leave_running) {
  asio::post(io, [this, leave_running] {
    if (leave_running) bench->leave();
    const bool waits = !leave_running && bench->close_bench();
    if (!waits && !std::exchange(bench_is_closed, true)) bench_closed.set_value(false);
  });
  // The longest halt that a driver waits for, twice.
  constexpr std::chrono::seconds kLongestEnd{60};
  std::future<bool> closed = bench_closed.get_future();
  if (closed.wait_for(kLongestEnd) == std::future_status::ready) return closed.get();
  print_error(
      "the process that holds the bench does not answer: the stage may be moving, stop it by its own switch");
  return true;
}

/// The answer to a request. `later` is set if the answer takes long: call it in the reading
/// thread.
HttpResponse Server::Impl::answer(const Peer& peer, const HttpRequest& request,
                                  std::function<HttpResponse()>& later) {
  const std::string what = fmt::format("{} {}", view(request.method_string()), view(request.target()));
  const auto refuse = [&](http::status status, const std::string& why) {
    log_refusal(peer, what, why);
    return plain(request, status, why);
  };
  const Access access = judge(options.access, caller_of(peer, request));
  if (access == Access::kWrongHost)
    return refuse(http::status::misdirected_request,
                  "This console is not known by that name; see `abcal serve --host`.");
  if (access == Access::kWrongOrigin)
    return refuse(http::status::forbidden, "Another page may not use this console.");
  const std::optional<Target> target = parse_target(view(request.target()));
  if (!target) return refuse(http::status::bad_request, "The path cannot be read.");
  const std::string& path = target->path;
  const bool reads = request.method() == http::verb::get || request.method() == http::verb::head;

  if (path == "/" && reads && target->token) {
    if (!options.access.token.empty() && same_secret(*target->token, options.access.token)) {
      // From here on as a cookie, and no longer in the address, where others may see it.
      HttpResponse response = plain(request, http::status::see_other, "Welcome.");
      response.set(http::field::location, "/");
      response.set(http::field::set_cookie, fmt::format("{}={}; HttpOnly; SameSite=Strict; Path=/",
                                                        options.access.cookie, options.access.token));
      return response;
    }
    if (access == Access::kNoToken) log_refusal(peer, "GET /?token=", "this is not the token");
  }
  if (access == Access::kNoToken) {
    log_refusal(peer, path, "no token");
    for (const Asset& asset : assets()) {
      if (path == "/" && asset.path == "/token.html")
        return respond(request, http::status::unauthorized, content_type(asset.path),
                       std::string(asset.body));
    }
    return plain(request, http::status::unauthorized, "A token is required.");
  }
  if (!reads) return refuse(http::status::method_not_allowed, "Only GET is answered here.");

  for (const Asset& asset : assets()) {
    if (asset.path == (path == "/" ? "/index.html" : path))
      return respond(request, http::status::ok, content_type(asset.path), std::string(asset.body));
  }
  later = library_job(target->words, request);
  if (!later) return refuse(http::status::not_found, "There is no such page.");
  return {};
}

/// Reads runs: /runs, /runs/NAME/result, /runs/NAME/DOWNLOAD, /compare/NAME/NAME[/shared-stage],
/// /history/SERIAL. Nothing for other paths.
std::function<HttpResponse()> Server::Impl::library_job(const std::vector<std::string>& words,
                                                        const HttpRequest& request) {
  // The parts of the request that an answer needs.
  HttpRequest head;
  head.version(request.version());
  head.keep_alive(request.keep_alive());
  const auto job = [head](auto make) {
    return [head, make = std::move(make)] {
      try {
        return make(head);
      } catch (const std::exception& error) {
        return plain(head, http::status::unprocessable_entity, error.what());
      }
    };
  };
  const auto json = [](const HttpRequest& to, const Json& body) {
    return respond(to, http::status::ok, "application/json",
                   body.dump(-1, ' ', false, Json::error_handler_t::replace));
  };
  if (words == std::vector<std::string>{"runs"})
    return job([this, json](const HttpRequest& to) { return json(to, library.list()); });
  if (words.size() == 2 && words[0] == "history")
    return job(
        [this, json, serial = words[1]](const HttpRequest& to) { return json(to, library.history(serial)); });
  const bool shared_stage = words.size() == 4 && words[3] == "shared-stage";
  if ((words.size() == 3 || shared_stage) && words[0] == "compare") {
    const auto first = library.find(words[1]), second = library.find(words[2]);
    if (!first || !second) return nullptr;
    return job([json, first = *first, second = *second, shared_stage](const HttpRequest& to) {
      return json(to, RunLibrary::compare(first, second, shared_stage));
    });
  }
  if (words.size() != 3 || words[0] != "runs") return nullptr;
  const auto path = library.find(words[1]);
  if (!path) return nullptr;
  if (words[2] == "result")
    return job([this, json, run = *path](const HttpRequest& to) { return json(to, library.result(run)); });
  for (const Download& download : downloads()) {
    if (words[2] == download.name)
      return job([run = *path, download](const HttpRequest& to) {
        HttpResponse response = respond(to, http::status::ok, download.content_type, download.make(run));
        // To be kept, not to be shown: a report has styles of its own, which this page's policy forbids.
        response.set(http::field::content_disposition, "attachment");
        return response;
      });
  }
  return nullptr;
}

Server::Server(ServerOptions options, Session::Options bench)
    : impl_(std::make_unique<Impl>(std::move(options), std::move(bench))) {}

Server::~Server() = default;

std::uint16_t Server::port() const {
  return impl_->acceptor.local_endpoint().port();
}

bool Server::serve(const std::stop_token& stop, const std::function<bool()>& leaves_bench) {
  std::promise<void> stopped;
  {
    const std::stop_callback on_stop(stop, [&stopped] { stopped.set_value(); });
    stopped.get_future().wait();
  }
  // The pages still see how it ends.
  return impl_->end(!impl_->options.bench_socket.empty() || (leaves_bench && leaves_bench()));
}

}  // namespace abcal::console
