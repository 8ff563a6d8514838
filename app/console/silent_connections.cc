#include "app/console/silent_connections.h"

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <utility>

namespace abcal::console {

SilentConnections::Ticket SilentConnections::add(std::string address, std::function<void()> give_way) {
  const auto same = [&](const Waiting& each) { return each.address == address; };
  const auto of_address = static_cast<std::size_t>(std::count_if(waiting_.begin(), waiting_.end(), same));
  auto oldest = waiting_.end();
  if (!address.empty() && of_address >= limits_.most_of_address)
    oldest = std::find_if(waiting_.begin(), waiting_.end(), same);
  else if (waiting_.size() >= limits_.most)
    oldest = waiting_.begin();
  if (oldest != waiting_.end()) {
    const std::function<void()> end = std::move(oldest->give_way);
    waiting_.erase(oldest);
    end();
  }
  waiting_.push_back({++last_, std::move(address), std::move(give_way)});
  return last_;
}

void SilentConnections::remove(Ticket ticket) {
  waiting_.remove_if([ticket](const Waiting& each) { return each.ticket == ticket; });
}

std::string counted_address(const std::string& address) {
  boost::system::error_code error;
  const auto parsed = boost::asio::ip::make_address(address, error);
  if (error || !parsed.is_v6()) return address;
  auto bytes = parsed.to_v6().to_bytes();
  std::fill(bytes.begin() + 8, bytes.end(), std::uint8_t{0});
  return boost::asio::ip::address_v6(bytes).to_string() + "/64";
}

}  // namespace abcal::console
