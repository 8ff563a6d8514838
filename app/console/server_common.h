#pragma once

#include <boost/asio/io_context.hpp>
#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "app/console/http_exchange.h"
#include "app/console/server.h"
#include "app/console/silent_connections.h"
#include "app/system/real_clock.h"

namespace abcal::console {

/// The places of identified connections. For one thread.
class Seats {
 public:
  explicit Seats(const ServerOptions& options)
      : most_(options.most_connections), most_of_address_(options.most_of_address) {}

  /// Takes a place until the last copy of the pointer is gone; null: none is free. Must outlive its places.
  std::shared_ptr<void> take(const std::string& address) {
    if (taken_ >= most_) return nullptr;
    std::size_t& of_address = taken_of_[address];
    if (of_address >= most_of_address_) return nullptr;
    ++taken_;
    ++of_address;
    return {this, [address](Seats* seats) {
              --seats->taken_;
              if (--seats->taken_of_[address] == 0) seats->taken_of_.erase(address);
            }};
  }
  std::size_t taken() const { return taken_; }

 private:
  const std::size_t most_, most_of_address_;
  std::size_t taken_ = 0;
  std::map<std::string, std::size_t> taken_of_;  ///< By address.
};

/// The objects that all parts of a Server use. For the thread of `io`, except `options` and `clock`.
struct ServerCommon {
  explicit ServerCommon(ServerOptions the_options) : options(std::move(the_options)) {}

  ServerOptions options;
  RealClock clock;
  RefusalLog log_refusal{clock};
  SilentConnections silent{options.silent};
  Seats seats{options};
  /// Destroyed first: the connections in its queue give back what they hold of the others.
  boost::asio::io_context io;
};

}  // namespace abcal::console
