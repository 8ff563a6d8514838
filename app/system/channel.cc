#include "app/system/channel.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

namespace abcal {
namespace {

constexpr std::size_t kMostDescriptors = 2;

/// Room for the descriptors of a packet.
struct Ancillary {
  alignas(cmsghdr) std::array<char, CMSG_SPACE(kMostDescriptors * sizeof(int))> bytes{};
};

[[noreturn]] void fail(const std::string& whose) {
  throw std::system_error(errno, std::generic_category(), whose);
}

int type_of(ChannelKind kind) {
  return (kind == ChannelKind::kPackets ? SOCK_SEQPACKET : SOCK_STREAM) | SOCK_CLOEXEC;
}

/// A new socket, and what bind() or connect() does with it and an address.
template <class Use>
Descriptor socket_at(const std::filesystem::path& path, ChannelKind kind, const Use& use) {
  const std::filesystem::path parent = path.has_parent_path() ? path.parent_path() : ".";
  // A long path is addressed through a descriptor of its folder.
  const Descriptor folder(::open(parent.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
  Descriptor socket(::socket(AF_UNIX, type_of(kind) | SOCK_NONBLOCK, 0));
  if (folder.number() < 0 || socket.number() < 0) fail(path.string());
  const std::string name = fmt::format("/proc/self/fd/{}/{}", folder.number(), path.filename().string());
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (name.size() >= sizeof address.sun_path) {
    errno = ENAMETOOLONG;
    fail(path.string());
  }
  std::memcpy(address.sun_path, name.c_str(), name.size());
  if (use(socket.number(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    fail(path.string());
  return socket;
}

}  // namespace

std::pair<Descriptor, Descriptor> channel_pair(ChannelKind kind, const std::string& whose) {
  std::array<int, 2> ends{};
  if (::socketpair(AF_UNIX, type_of(kind), 0, ends.data()) != 0) fail(whose);
  return {Descriptor(ends[0]), Descriptor(ends[1])};
}

Descriptor listen_at(const std::filesystem::path& path, ChannelKind kind, unsigned mode) {
  return socket_at(path, kind, [&](int socket, const sockaddr* address, socklen_t size) {
    const mode_t before = ::umask(0777 & ~mode);
    const int error = ::bind(socket, address, size);
    ::umask(before);
    return error != 0 ? error : ::listen(socket, SOMAXCONN);
  });
}

std::optional<Descriptor> accept_from(const Descriptor& listener) {
  Descriptor end(::accept4(listener.number(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
  if (end.number() < 0) return std::nullopt;
  return end;
}

Descriptor connect_to(const std::filesystem::path& path, ChannelKind kind) {
  return socket_at(path, kind, ::connect);
}

bool send_packet(int socket, std::string_view bytes, const std::vector<Descriptor>& descriptors) {
  iovec data{const_cast<char*>(bytes.data()), bytes.size()};
  Ancillary ancillary;
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  if (!descriptors.empty()) {
    std::array<int, kMostDescriptors> numbers{};
    std::ranges::transform(descriptors, numbers.begin(), &Descriptor::number);
    const std::size_t size = descriptors.size() * sizeof(int);
    message.msg_control = ancillary.bytes.data();
    message.msg_controllen = CMSG_SPACE(size);
    cmsghdr* header = CMSG_FIRSTHDR(&message);
    header->cmsg_level = SOL_SOCKET;
    header->cmsg_type = SCM_RIGHTS;
    header->cmsg_len = CMSG_LEN(size);
    std::memcpy(CMSG_DATA(header), numbers.data(), size);
  }
  return ::sendmsg(socket, &message, MSG_NOSIGNAL | MSG_DONTWAIT) == static_cast<ssize_t>(bytes.size());
}

std::optional<Packet> receive_packet(int socket, std::size_t most, std::vector<Descriptor>* descriptors) {
  Packet packet{std::string(most, '\0')};
  iovec data{packet.bytes.data(), packet.bytes.size()};
  Ancillary ancillary;
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  if (descriptors != nullptr) {
    message.msg_control = ancillary.bytes.data();
    message.msg_controllen = ancillary.bytes.size();
  }
  ssize_t count = 0;
  // MSG_TRUNC: the length of the whole packet is returned.
  do count = ::recvmsg(socket, &message, MSG_CMSG_CLOEXEC | MSG_TRUNC);
  while (count < 0 && errno == EINTR);
  if (count <= 0) return std::nullopt;
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr; header = CMSG_NXTHDR(&message, header)) {
    if (header->cmsg_level != SOL_SOCKET || header->cmsg_type != SCM_RIGHTS) continue;
    std::array<int, kMostDescriptors> numbers{};
    const std::size_t size = header->cmsg_len - CMSG_LEN(0);
    std::memcpy(numbers.data(), CMSG_DATA(header), size);
    for (std::size_t k = 0; k < size / sizeof(int); ++k) descriptors->emplace_back(numbers[k]);
  }
  packet.length = static_cast<std::size_t>(count);
  packet.bytes.resize(std::min(packet.length, most));
  return packet;
}

bool wait_until_readable(int descriptor, std::chrono::steady_clock::duration longest) {
  const auto deadline = std::chrono::steady_clock::now() + longest;
  pollfd waiting{.fd = descriptor, .events = POLLIN, .revents = 0};
  for (;;) {
    const auto left =
        std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    const int found = ::poll(&waiting, 1, std::max(0, static_cast<int>(left.count())));
    if (found >= 0 || errno != EINTR) return found == 1;
  }
}

unsigned peer_user(int socket) {
  ucred peer{};
  socklen_t size = sizeof peer;
  if (::getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0)
    fail("the user of a connection is unknown");
  return peer.uid;
}

}  // namespace abcal
