#include "app/witness/witness_socket.h"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <cerrno>
#include <cstring>
#include <stdexcept>

namespace abcal {
namespace {

[[noreturn]] void fail(const std::filesystem::path& path, int error) {
  throw std::runtime_error(fmt::format("{}: {}", path.string(), std::strerror(error)));
}

sockaddr_un address_of(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string text = path.string();
  if (text.size() >= sizeof address.sun_path)
    throw std::runtime_error(fmt::format("{}: found {} bytes; required: the path of a socket, at most {}",
                                         text, text.size(), sizeof address.sun_path - 1));
  std::memcpy(address.sun_path, text.c_str(), text.size() + 1);
  return address;
}

Descriptor new_socket(const std::filesystem::path& path) {
  Descriptor socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (socket.number() < 0) fail(path, errno);
  return socket;
}

/// 0, or the reason why there is no connection.
int connect(const Descriptor& socket, const std::filesystem::path& path) {
  const sockaddr_un address = address_of(path);
  return ::connect(socket.number(), reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 ? 0
                                                                                                      : errno;
}

}  // namespace

Descriptor listen_as_witness(const std::filesystem::path& path) {
  const int found = connect(new_socket(path), path);
  if (found == 0 || found == EAGAIN)
    throw std::runtime_error(fmt::format(
        "{}: another process serves this socket; required: one witness, or another path", path.string()));
  std::error_code ignored;
  // A file that is not a socket refuses connections, too.
  if (found == ECONNREFUSED && std::filesystem::is_socket(path, ignored))
    std::filesystem::remove(path, ignored);
  Descriptor listener = new_socket(path);
  const sockaddr_un address = address_of(path);
  if (::bind(listener.number(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      ::chmod(path.c_str(), 0666) != 0 || ::listen(listener.number(), SOMAXCONN) != 0)
    fail(path, errno);
  return listener;
}

Descriptor connect_to_witness(const std::filesystem::path& path) {
  Descriptor socket = new_socket(path);
  if (const int error = connect(socket, path); error != 0) fail(path, error);
  return socket;
}

bool send_witness_packet(int socket, const std::string& packet) {
  return ::send(socket, packet.data(), packet.size(), MSG_NOSIGNAL | MSG_DONTWAIT) ==
         static_cast<ssize_t>(packet.size());
}

std::optional<std::string> receive_witness_packet(int socket) {
  std::string packet(kLongestWitnessPacket, '\0');
  // MSG_TRUNC: the length of the whole packet is returned.
  ssize_t count = 0;
  do count = ::recv(socket, packet.data(), packet.size(), MSG_DONTWAIT | MSG_TRUNC);
  while (count < 0 && errno == EINTR);
  if (count <= 0) return std::nullopt;
  const auto length = static_cast<std::size_t>(count);
  if (length > kLongestWitnessPacket)
    throw std::invalid_argument(
        fmt::format("found a packet of {} bytes; required: at most {}", length, kLongestWitnessPacket));
  packet.resize(length);
  return packet;
}

unsigned peer_user(int socket) {
  ucred peer{};
  socklen_t size = sizeof peer;
  if (::getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0)
    throw std::runtime_error(fmt::format("the user of a connection is unknown: {}", std::strerror(errno)));
  return peer.uid;
}

}  // namespace abcal
