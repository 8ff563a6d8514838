#pragma once

#include <boost/asio/buffer.hpp>
#include <boost/asio/connect.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/write.hpp>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

namespace abcal::test {

/// A client of an emulator's control port, which gives the true state of the simulated stage.
class EmulatorControlClient {
 public:
  explicit EmulatorControlClient(std::uint16_t port) {
    socket_.connect({boost::asio::ip::address_v4::loopback(), port});
  }

  nlohmann::json ask(const nlohmann::json& request) {
    boost::asio::write(socket_, boost::asio::buffer(request.dump() + "\n"));
    const std::size_t length = boost::asio::read_until(socket_, boost::asio::dynamic_buffer(input_), '\n');
    nlohmann::json reply = nlohmann::json::parse(input_.substr(0, length));
    input_.erase(0, length);
    return reply;
  }
  bool anything_moves() {
    const nlohmann::json status = ask({{"do", "status"}});
    return status.at("x").at("moving").get<bool>() || status.at("z").at("moving").get<bool>();
  }

 private:
  boost::asio::io_context io_;
  boost::asio::ip::tcp::socket socket_{io_};
  std::string input_;
};

}  // namespace abcal::test
