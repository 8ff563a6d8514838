#pragma once

#include <cstdint>
#include <functional>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::sim {

/// A command that a host sent and that the simulated instrument does not carry out.
struct UnservedCommand {
  std::string command;   ///< Printable; cut after 60 characters.
  std::string bytes;     ///< Bytes of the first occurrence; cut after 300.
  std::string reaction;  ///< Reaction of the instrument instead: "error 2, no answer".
  std::uint64_t count = 0;
};

/// Requests of hosts that an instrument did not fulfil, each command once with its count, in the order of
/// their first appearance. Safe to use from several threads.
class UnservedCommands {
 public:
  using Listener = std::function<void(const UnservedCommand&)>;

  /// At most this many different commands are kept; the others are counted in the last entry.
  static constexpr std::size_t kCapacity = 200;

  /// `command` consists of any received bytes. `bytes` are the received ones if it names them in another way.
  void note(std::string_view command, std::string_view reaction, std::string_view bytes = {});

  std::vector<UnservedCommand> all() const;

  /// `listener` is called at each occurrence, in the thread that notes it: with the text and the bytes of the
  /// first occurrence of that command, and the count so far.
  void on_note(Listener listener);

 private:
  mutable std::mutex mutex_;
  std::vector<UnservedCommand> commands_;
  Listener listener_;
};

}  // namespace abcal::sim
