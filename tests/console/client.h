#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace abcal::test {

/// Deadline for every action of a client of the console.
constexpr std::chrono::seconds kPatience{60};

using Headers = std::map<std::string, std::string>;

namespace client_detail {

/// Runs `io` until `done`, or throws.
inline void wait(boost::asio::io_context& io, const bool& done, const char* what) {
  const auto deadline = std::chrono::steady_clock::now() + kPatience;
  io.restart();
  while (!done) {
    if (std::chrono::steady_clock::now() > deadline)
      throw std::runtime_error(std::string("nothing came in time: ") + what);
    io.run_one_for(std::chrono::milliseconds(100));
    if (io.stopped()) io.restart();
  }
}

}  // namespace client_detail

struct Answer {
  unsigned status = 0;  ///< 0: the connection ended without an answer.
  Headers headers;
  std::string body;
};

/// A connection for sending arbitrary bytes.
class RawConnection {
 public:
  /// @param receive_buffer  bytes the system keeps for it; 0: as many as it likes
  explicit RawConnection(std::uint16_t port, int receive_buffer = 0) {
    socket_.open(boost::asio::ip::tcp::v4());
    if (receive_buffer > 0) socket_.set_option(boost::asio::socket_base::receive_buffer_size(receive_buffer));
    socket_.connect({boost::asio::ip::address_v4::loopback(), port});
  }

  void send(const std::string& bytes) {
    boost::system::error_code error;
    boost::asio::write(socket_, boost::asio::buffer(bytes), error);
  }

  Answer answer() {
    namespace http = boost::beast::http;
    http::response_parser<http::string_body> parser;
    parser.body_limit(64 * 1024 * 1024);
    bool done = false;
    boost::system::error_code result;
    http::async_read(socket_, buffer_, parser, [&](boost::system::error_code error, std::size_t) {
      result = error;
      done = true;
    });
    client_detail::wait(io_, done, "an answer");
    Answer answer;
    if (result) return answer;
    answer.status = parser.get().result_int();
    for (const auto& field : parser.get())
      answer.headers[std::string(field.name_string())] = std::string(field.value());
    answer.body = parser.get().body();
    return answer;
  }

  /// Waits for the other end to close.
  bool closed() {
    char byte = 0;
    bool done = false, end = false;
    socket_.async_read_some(boost::asio::buffer(&byte, 1), [&](boost::system::error_code error, std::size_t) {
      end = static_cast<bool>(error);
      done = true;
    });
    client_detail::wait(io_, done, "the end of the connection");
    return end;
  }

 private:
  boost::asio::io_context io_;
  boost::asio::ip::tcp::socket socket_{io_};
  boost::beast::flat_buffer buffer_;
};

/// One request and its answer. Host is set unless `headers` has one.
inline Answer http_get(std::uint16_t port, const std::string& target, Headers headers = {},
                       const std::string& method = "GET") {
  headers.emplace("Host", "127.0.0.1:" + std::to_string(port));
  std::string text = method + " " + target + " HTTP/1.1\r\n";
  for (const auto& [name, value] : headers) text += name + ": " + value + "\r\n";
  RawConnection connection(port);
  connection.send(text + "\r\n");
  return connection.answer();
}

/// A form that is posted, and its answer.
inline Answer http_post(std::uint16_t port, const std::string& target, const std::string& form,
                        Headers headers = {}) {
  headers.emplace("Host", "127.0.0.1:" + std::to_string(port));
  headers.emplace("Content-Type", "application/x-www-form-urlencoded");
  std::string text = "POST " + target + " HTTP/1.1\r\n";
  for (const auto& [name, value] : headers) text += name + ": " + value + "\r\n";
  RawConnection connection(port);
  connection.send(text + "Content-Length: " + std::to_string(form.size()) + "\r\n\r\n" + form);
  return connection.answer();
}

/// Forms that are posted at the same time, and the status of each answer.
inline std::vector<unsigned> post_at_once(std::uint16_t port, const std::string& target,
                                          const std::vector<std::string>& forms, Headers headers = {}) {
  headers.emplace("Host", "127.0.0.1:" + std::to_string(port));
  std::string head = "POST " + target + " HTTP/1.1\r\nContent-Type: application/x-www-form-urlencoded\r\n";
  for (const auto& [name, value] : headers) head += name + ": " + value + "\r\n";
  std::vector<std::unique_ptr<RawConnection>> connections;
  for (std::size_t k = 0; k < forms.size(); ++k) connections.push_back(std::make_unique<RawConnection>(port));
  for (std::size_t k = 0; k < forms.size(); ++k)
    connections[k]->send(head + "Content-Length: " + std::to_string(forms[k].size()) + "\r\n\r\n" + forms[k]);
  std::vector<unsigned> statuses;
  for (const auto& connection : connections) statuses.push_back(connection->answer().status);
  return statuses;
}

/// A page: a WebSocket of the console.
class PageClient {
 public:
  using Json = nlohmann::json;

  /// @throws boost::system::system_error if the handshake is declined
  explicit PageClient(std::uint16_t port, const Headers& headers = {}, const std::string& target = "/live",
                      std::size_t receive_buffer = 0) {
    auto& socket = socket_.next_layer().socket();
    socket.open(boost::asio::ip::tcp::v4());
    if (receive_buffer > 0)
      socket.set_option(boost::asio::socket_base::receive_buffer_size(static_cast<int>(receive_buffer)));
    socket.connect({boost::asio::ip::address_v4::loopback(), port});
    socket_.read_message_max(64 * 1024 * 1024);
    socket_.set_option(
        boost::beast::websocket::stream_base::decorator([&](boost::beast::websocket::request_type& request) {
          for (const auto& [name, value] : headers) request.set(name, value);
        }));
    const auto host = headers.find("Host");
    socket_.handshake(host == headers.end() ? "127.0.0.1:" + std::to_string(port) : host->second, target);
    read();
  }

  void send(const std::string& text) { socket_.write(boost::asio::buffer(text)); }

  /// The answer to a request. Messages before it are kept for next().
  Json ask(Json request) {
    request["id"] = ++last_id_;
    send(request.dump());
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    std::deque<Json> before;
    while (std::optional<Json> message = next(deadline)) {
      if ((*message)["type"] == "reply" && (*message)["id"] == last_id_) {
        messages_.insert(messages_.begin(), before.begin(), before.end());
        return *message;
      }
      before.push_back(std::move(*message));
    }
    throw std::runtime_error("no reply came in time to " + request.dump());
  }
  bool ok(const Json& request) { return ask(request)["ok"].get<bool>(); }

  /// The next message for which `wanted` holds; messages before it are dropped.
  Json wait_for(const std::function<bool(const Json&)>& wanted, const char* what) {
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    while (true) {
      const std::optional<Json> message = next(deadline);
      if (!message) throw std::runtime_error(std::string("it did not come in time: ") + what);
      if (wanted(*message)) return *message;
    }
  }
  Json wait_for_type(const std::string& type) {
    return wait_for([&](const Json& m) { return m["type"] == type; }, type.c_str());
  }
  Json wait_for_activity(const std::string& activity) {
    return wait_for([&](const Json& m) { return m["type"] == "activity" && m["activity"] == activity; },
                    activity.c_str());
  }

  /// Whether the connection has ended.
  bool ended() const { return ended_; }
  /// Waits for its end.
  bool wait_for_end() {
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    while (!ended_ && next(deadline)) {
    }
    return ended_;
  }

  /// The next message, or nothing at the deadline or the end.
  std::optional<Json> next(std::chrono::steady_clock::time_point deadline) {
    io_.restart();
    io_.poll();
    while (messages_.empty() && !ended_ && std::chrono::steady_clock::now() < deadline) {
      io_.restart();
      io_.run_one_until(
          std::min(deadline, std::chrono::steady_clock::now() + std::chrono::milliseconds(100)));
    }
    if (messages_.empty()) return std::nullopt;
    Json message = std::move(messages_.front());
    messages_.pop_front();
    if (!message.contains("type")) message["type"] = message["event"];  // One of a run.
    return message;
  }

 private:
  void read() {
    socket_.async_read(buffer_, [this](boost::system::error_code error, std::size_t) {
      if (error) {
        ended_ = true;
        return;
      }
      messages_.push_back(Json::parse(boost::beast::buffers_to_string(buffer_.cdata())));
      buffer_.consume(buffer_.size());
      read();
    });
  }

  boost::asio::io_context io_;
  boost::beast::websocket::stream<boost::beast::tcp_stream> socket_{io_};
  boost::beast::flat_buffer buffer_;
  std::deque<Json> messages_;
  std::int64_t last_id_ = 0;
  bool ended_ = false;
};

}  // namespace abcal::test
