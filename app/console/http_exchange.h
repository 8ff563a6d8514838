#pragma once

// A request over HTTP, its answer, and who asks: shared by the parts of a Server.

#include <boost/asio/ip/address.hpp>
#include <boost/asio/thread_pool.hpp>
#include <boost/beast/http.hpp>
#include <functional>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "app/console/access.h"
#include "app/console/persons.h"
#include "app/console/workshop.h"
#include "drivers/instrument/clock.h"

namespace abcal::console {

using HttpRequest = boost::beast::http::request<boost::beast::http::string_body>;
using HttpResponse = boost::beast::http::response<boost::beast::http::string_body>;
using SharedText = std::shared_ptr<const std::string>;

/// The other end of a connection, for the log and for the rules of access.
struct Peer {
  std::string remote;      ///< For people: "127.0.0.1:50000".
  std::string client;      ///< "127.0.0.1"; behind a proxy, the client's address.
  std::string proxy;       ///< Address of the trusted proxy; empty: none.
  std::string connected;   ///< "127.0.0.1:50000": the other end of the connection.
  std::string here, port;  ///< As in Caller.
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

/// The part of an answer that takes time: `job` is carried out in `where`, and the function that it returns
/// in the thread of the connections. Or an order to a workshop, cancelled if the client disconnects.
struct Slow {
  using Finish = std::function<HttpResponse()>;
  boost::asio::thread_pool* where = nullptr;
  std::function<Finish()> job;

  Workshop* workshop = nullptr;
  std::string name;  ///< Name of the order.
  Workshop::Make make;
  Turn turn;
  HttpRequest head;  ///< Head of the request that is answered.

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
/// Refuses a request and logs it, without the part of its target behind "?", which may be a secret.
HttpResponse refuse(RefusalLog& log, const Asked& asked, boost::beast::http::status status,
                    const Message& why);
HttpResponse json_answer(const HttpRequest& to, const nlohmann::ordered_json& body);
std::shared_ptr<const Product> made_of_json(const nlohmann::ordered_json& body);
/// The answer with a file of the page; absent: no file has this path.
std::optional<HttpResponse> answer_with_asset(
    const HttpRequest& request, std::string_view path,
    boost::beast::http::status status = boost::beast::http::status::ok);
/// The parts of a request that its answer needs.
HttpRequest head_of(const HttpRequest& request);
/// "192.0.2.1"; an IPv4 address in IPv6 is IPv4.
boost::asio::ip::address plain_ip(boost::asio::ip::address address);
/// The end of a connection, as a Host header names it.
std::string host_of(const boost::asio::ip::address& address);

}  // namespace abcal::console
