#pragma once

#include <chrono>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "app/system/descriptor.h"

namespace abcal {

// Connections between processes of this computer (Unix sockets). All are closed at exec.

enum class ChannelKind {
  kPackets,  ///< Each packet arrives whole (SOCK_SEQPACKET).
  kBytes,    ///< Bytes arrive in their order, without bounds (SOCK_STREAM).
};

/// Two connected ends, which block.
/// @param whose  for the message of a failure
/// @throws std::system_error
std::pair<Descriptor, Descriptor> channel_pair(ChannelKind kind, const std::string& whose);

// Who may connect to a listener, as the mode of its file.
inline constexpr unsigned kForThisUser = 0600, kForEverybody = 0666;

/// Listens at a path that does not exist. The listener does not block. The path may exceed the system's limit
/// of length, but not the name of the file.
/// @param mode  kForThisUser or kForEverybody
/// @throws std::system_error that names the path
Descriptor listen_at(const std::filesystem::path& path, ChannelKind kind, unsigned mode);

/// The next connection, whose end does not block. @return nullopt if there is none
std::optional<Descriptor> accept_from(const Descriptor& listener);

/// Connects without waiting; the end does not block. The length of the path is limited as for listen_at().
/// @throws std::system_error that names the path
Descriptor connect_to(const std::filesystem::path& path, ChannelKind kind);

/// Sends a packet, and duplicates of at most two descriptors with it. Never waits.
/// @return false: the other end is gone, or its queue is full (errno)
bool send_packet(int socket, std::string_view bytes, const std::vector<Descriptor>& descriptors = {});

struct Packet {
  std::string bytes;       ///< Its first bytes, at most as many as the receiver takes.
  std::size_t length = 0;  ///< Bytes of the whole packet.
};

/// Receives a packet; waits for it if the end blocks.
/// @param most  bytes of a packet that are kept
/// @param descriptors  get those that came with it; without this the system drops them
/// @return nullopt: the connection has ended, or no packet is there and the end does not block
std::optional<Packet> receive_packet(int socket, std::size_t most,
                                     std::vector<Descriptor>* descriptors = nullptr);

/// Waits until a descriptor (-1: none) can be read or has ended. @return false: not within that time
bool wait_until_readable(int descriptor, std::chrono::steady_clock::duration longest);

/// User ID of the process at the other end. @throws std::system_error
unsigned peer_user(int socket);

}  // namespace abcal
