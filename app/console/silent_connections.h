#pragma once

#include <cstdint>
#include <functional>
#include <list>
#include <string>

namespace abcal::console {

/// Connections whose visitor is not identified yet. If there are too many, the oldest one is ended: that of
/// the address that has too many, so that nobody is locked out by others. For one thread.
class SilentConnections {
 public:
  struct Limits {
    std::size_t most = 400;
    std::size_t most_of_address = 20;
  };
  using Ticket = std::uint64_t;

  explicit SilentConnections(Limits limits) : limits_(limits) {}

  /// Adds a new connection.
  /// @param address  empty: that of a proxy, which is not limited by itself
  /// @param give_way  ends the connection; called at most once
  Ticket add(std::string address, std::function<void()> give_way);
  /// The visitor is identified, or the connection has ended.
  void remove(Ticket ticket);
  std::size_t size() const { return waiting_.size(); }

 private:
  struct Waiting {
    Ticket ticket = 0;
    std::string address;
    std::function<void()> give_way;
  };

  Limits limits_;
  Ticket last_ = 0;
  std::list<Waiting> waiting_;  ///< Oldest first.
};

/// The address under which a connection is counted: for IPv6 the network of a subscriber, /64.
std::string counted_address(const std::string& address);

}  // namespace abcal::console
