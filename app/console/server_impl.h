#pragma once

// The parts of a Server, for its own sources only.

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <cstdint>
#include <deque>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "app/bench/real_clock.h"
#include "app/console/bench_link.h"
#include "app/console/download.h"
#include "app/console/login_throttle.h"
#include "app/console/persons.h"
#include "app/console/request.h"
#include "app/console/run_library.h"
#include "app/console/server.h"
#include "app/console/signature_desk.h"
#include "app/console/silent_connections.h"
#include "app/console/stream.h"
#include "app/console/target.h"
#include "app/console/workshop.h"

namespace abcal::console {

using HttpRequest = boost::beast::http::request<boost::beast::http::string_body>;
using HttpResponse = boost::beast::http::response<boost::beast::http::string_body>;
using SharedText = std::shared_ptr<const std::string>;

/// What was made of runs and is kept for who asks again: some hundred results, some PDFs.
inline constexpr std::size_t kMostKept = 16 * 1024 * 1024;
/// As many analyses at a time; two processors are the least on which a bench is run.
inline constexpr std::size_t kAnalysts = 2;

/// Who speaks, for the log and for the rules of access.
struct Peer {
  std::string remote;      ///< For people: "127.0.0.1:50000".
  std::string client;      ///< "127.0.0.1": behind a proxy that of the client.
  std::string proxy;       ///< The proxy between; empty: none that is known.
  std::string connected;   ///< "127.0.0.1:50000": the other end of the connection.
  std::string here, port;  ///< As Caller has them.
  bool loopback = false;
  bool secure = false;  ///< TLS.
};

/// A request that has been read.
struct Asked {
  const Peer& peer;
  const HttpRequest& request;
  Access access = Access::kNoToken;
  Visitor visitor;  ///< Where access is granted.
};

/// What takes its time: `job` is carried out in `where`, and what it returns in the thread of the
/// connections. Or what is made in a workshop, and is not made to its end if the client goes.
struct Slow {
  using Finish = std::function<HttpResponse()>;
  boost::asio::thread_pool* where = nullptr;
  std::function<Finish()> job;

  Workshop* workshop = nullptr;
  std::string name;  ///< Of the order.
  Workshop::Make make;
  HttpRequest head;  ///< Of whoever asks.

  explicit operator bool() const { return where != nullptr || workshop != nullptr; }
};

/// Logs refusals with their origin and reason, at a limited rate so that a flood does not hide other lines.
/// For one thread.
class RefusalLog {
 public:
  explicit RefusalLog(const Clock& clock) : clock_(clock) {}
  void operator()(const Peer& peer, std::string_view what, std::string_view why);

 private:
  const Clock& clock_;
  Clock::Instant since_{};
  int count_ = 0;
};

inline std::string_view view(boost::beast::string_view text) {
  return {text.data(), text.size()};
}
HttpResponse respond(const HttpRequest& request, boost::beast::http::status status, std::string_view type,
                     std::string body);
HttpResponse plain(const HttpRequest& request, boost::beast::http::status status, std::string text);
HttpResponse json_answer(const HttpRequest& to, const nlohmann::ordered_json& body);
std::shared_ptr<const Product> made_of_json(const nlohmann::ordered_json& body);
/// POST /runs/NAME/signed-certificate, which alone may be long.
bool is_signed_certificate(const HttpRequest& request);
/// The parts of a request that its answer needs.
HttpRequest head_of(const HttpRequest& request);
/// "192.0.2.1"; an IPv4 address in IPv6 is IPv4.
boost::asio::ip::address plain_ip(boost::asio::ip::address address);
/// The end of a connection, as a Host header names it.
std::string host_of(const boost::asio::ip::address& address);

struct Server::Impl {
  class Page;
  class HttpConnection;
  using Json = nlohmann::ordered_json;

  Impl(ServerOptions the_options, Session::Options bench_options);
  ~Impl();

  void listen();
  void accept();
  void make_bench_link(Session::Options bench_options);
  void broadcast(const SharedText& text);
  void send_snapshot(Page& page);
  void have_snapshot(std::string_view json);
  void bench_is(BenchState state, const std::string& words);
  void answered(const Json& reply);
  void arrived(const std::shared_ptr<Page>& page);
  void left(Page& page);
  void received(Page& page, std::string_view text);
  Session::Refusal take_control(Page& page, const TakeControl& take);
  void give_control(Page* page);
  void look_around();
  std::string control_message() const;
  std::string bench_message() const;
  bool end(bool leave_running);

  // ---- Persons
  /// Everybody may use it who reaches it.
  bool is_open() const { return options.access.token.empty() && !options.access.persons; }
  /// A proxy has passed it on that nobody named, to a console that asks nobody who they are.
  bool is_proxied_unknown(const HttpRequest& request) const;
  /// What a request shows to prove that it is a person of the register; empty: nothing.
  std::string login_of(const HttpRequest& request) const;
  void end_logins(const std::vector<std::string>& logins);
  void look_at_logins();
  /// A place among those who have said who they are; null: there is none.
  std::shared_ptr<void> take_seat(const std::string& address);

  // ---- Answers
  HttpResponse answer(const Asked& asked, Slow& later);
  HttpResponse refuse(const Asked& asked, boost::beast::http::status status, const std::string& why);
  HttpResponse ask_who(const Asked& asked, const std::string& path);
  HttpResponse log_in(const Asked& asked, Slow& later);
  HttpResponse log_in_by_token(const Asked& asked, const std::string& token);
  HttpResponse log_out(const Asked& asked);
  HttpResponse approve_certificate(const Asked& asked, Slow& later);
  HttpResponse prepare_certificate(const Asked& asked, const ApprovalForm& form, Slow& later);
  HttpResponse take_signed_certificate(const Asked& asked, const std::vector<std::string>& words,
                                       Slow& later);
  /// A run, and which of its items, as a form or a path names them: item "" is 0, of a run that has one.
  std::optional<ItemOfRun> find_item(const std::string& run, const std::string& item) const;
  /// Of /runs/NAME/WHAT and /runs/NAME/items/K/WHAT. Nothing for other paths, and where there is no such run.
  std::optional<ItemOfRun> find_item(const std::vector<std::string>& words) const;
  ApprovalPlace approval_place() const { return {options.register_location, options.laboratory_file}; }
  HttpResponse too_many_failures(const Asked& asked, Clock::Duration wait);
  void set_cookie(const Asked& asked, HttpResponse& response, const std::string& name,
                  const std::string& value, std::chrono::seconds life) const;
  /// Reads runs and makes something of them. Nothing for other paths.
  bool order_of_library(const std::vector<std::string>& words, Slow& later);
  bool order_of_run(const ItemOfRun& of, const std::string& what, Slow& later);
  bool order_approval(const std::vector<std::string>& words, const Visitor& visitor, Slow& later);
  bool order_start_form(const Asked& asked, Slow& later);
  /// What is made of files, and kept.
  Workshop::Make kept(const std::string& what, std::vector<std::filesystem::path> files,
                      std::function<Product(const std::stop_token&)> make);

  ServerOptions options;
  const std::filesystem::path bench_file, runs;
  RealClock clock;
  RefusalLog log_refusal{clock};
  RunLibrary library;
  Persons persons;
  LoginThrottle throttle;
  SilentConnections silent;
  std::map<std::string, std::size_t> seats_of;  ///< Connections that have said who they are, by address.
  std::size_t seats = 0;
  std::string login_cookie;
  boost::asio::io_context io;
  std::optional<boost::asio::ssl::context> tls;
  boost::asio::ip::tcp::acceptor acceptor{io};
  boost::asio::steady_timer accept_again{io};
  boost::asio::steady_timer next_look{io};
  Clock::Instant looked_at_logins{};
  bool looks_at_logins = false;
  std::unique_ptr<BenchLink> bench;
  BenchState bench_state = BenchState::kStarting;
  std::string bench_words = "The process that holds the bench is being started.";
  /// Requests that were passed on, and who waits for the reply.
  struct PassedOn {
    std::weak_ptr<Page> page;
    std::int64_t id = 0;
    std::string text;
  };
  std::map<std::uint64_t, PassedOn> passed_on;
  std::uint64_t passed_on_so_far = 0;
  std::promise<bool> bench_closed;
  bool bench_is_closed = false;
  std::set<std::shared_ptr<Page>> pages;
  Page* controller = nullptr;
  bool controller_silent = false;
  std::int64_t pages_so_far = 0;
  boost::asio::thread_pool door{1};            ///< Asks the register.
  SignatureDesk signatures{approval_place()};  ///< For the thread of `seal`.
  boost::asio::thread_pool seal{1};            ///< Issues certificates, one after another.
  // What takes seconds has threads of its own: nothing else waits for them.
  ProductCache products{kMostKept};
  Workshop lists{io, 1};
  Workshop analyses{io, kAnalysts};
  Workshop prints{io, 1};
  std::jthread thread;
};

/// A page that watches. Writes one message at a time; what waits is bounded.
class Server::Impl::Page : public std::enable_shared_from_this<Page> {
 public:
  Page(Impl& server, Stream stream, Peer peer, Visitor visitor, std::shared_ptr<void> seat);
  Page(const Page&) = delete;
  Page& operator=(const Page&) = delete;

  const Peer& peer() const { return peer_; }
  const Visitor& visitor() const { return visitor_; }
  Asker asker() const;
  std::int64_t number = 0;
  Clock::Instant heard{};           ///< Its last message.
  bool waits_for_snapshot = false;  ///< Nothing else makes sense before.

  void open(const HttpRequest& request);
  /// Sends an event to the page; dropped if the page is too slow.
  void send(const SharedText& message);
  /// Answers a request of the page; never dropped.
  void reply(std::string message);
  void close();

 private:
  struct Waiting {
    SharedText text;
    bool is_reply;
  };
  void push(Waiting message);
  void read();
  void write();

  Impl& server_;
  boost::beast::websocket::stream<Stream> socket_;
  Peer peer_;
  Visitor visitor_;
  std::shared_ptr<void> seat_;
  boost::beast::flat_buffer buffer_{kLongestRequest};
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
  HttpConnection(Impl& server, boost::asio::ip::tcp::socket socket);
  ~HttpConnection();
  HttpConnection(const HttpConnection&) = delete;
  HttpConnection& operator=(const HttpConnection&) = delete;

  void begin();

 private:
  bool know_peer();
  void read();
  /// Of somebody who is logged in more is read than of others, for a signed certificate alone.
  void have_header(boost::beast::error_code error);
  void have_read(boost::beast::error_code error);
  void refuse_unreadable(boost::beast::error_code error);
  /// Behind a proxy each request may come from another client.
  void know_client(const HttpRequest& request);
  void ask_register(const std::string& login);
  /// @param person  null: nobody who is logged in
  void admit(const Persons::Known& person);
  void carry_out(Slow slow);
  void carry_out_order(Slow slow);
  /// Whether the client is still there; what it waits for is given up if not.
  void watch_client();
  void write(HttpResponse response);
  void drain(std::size_t most);

  Impl& server_;
  Stream stream_;
  Peer peer_;
  boost::beast::flat_buffer buffer_;
  std::optional<boost::beast::http::request_parser<boost::beast::http::string_body>> parser_;
  std::optional<HttpResponse> response_;
  std::optional<SilentConnections::Ticket> ticket_;
  std::shared_ptr<void> seat_;
  Workshop::Ticket order_;  ///< What it waits for.
  std::optional<boost::asio::steady_timer> look_;
};

}  // namespace abcal::console
