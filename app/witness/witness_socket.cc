#include "app/witness/witness_socket.h"

#include <fmt/format.h>

#include <stdexcept>
#include <system_error>
#include <utility>

#include "app/system/channel.h"

namespace abcal {
namespace {

/// Why a connection to a path fails; no error: it does not.
std::error_code found_at(const std::filesystem::path& path) {
  try {
    (void)connect_to(path, ChannelKind::kPackets);
    return {};
  } catch (const std::system_error& error) {
    return error.code();
  }
}

}  // namespace

Descriptor listen_as_witness(const std::filesystem::path& path) {
  const std::error_code found = found_at(path);
  if (!found || found == std::errc::resource_unavailable_try_again)
    throw std::runtime_error(fmt::format(
        "{}: another process serves this socket; required: one witness, or another path", path.string()));
  std::error_code ignored;
  // A file that is not a socket refuses connections, too.
  if (found == std::errc::connection_refused && std::filesystem::is_socket(path, ignored))
    std::filesystem::remove(path, ignored);
  return listen_at(path, ChannelKind::kPackets, kForEverybody);
}

std::optional<std::string> receive_witness_packet(int socket) {
  std::optional<Packet> packet = receive_packet(socket, kLongestWitnessPacket);
  if (!packet) return std::nullopt;
  if (packet->length > kLongestWitnessPacket)
    throw std::invalid_argument(fmt::format("found a packet of {} bytes; required: at most {}",
                                            packet->length, kLongestWitnessPacket));
  return std::move(packet->bytes);
}

}  // namespace abcal
