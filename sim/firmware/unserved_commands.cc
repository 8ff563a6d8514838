#include "sim/firmware/unserved_commands.h"

#include <algorithm>
#include <utility>

#include "drivers/wire/readable_bytes.h"

namespace abcal::sim {
namespace {

constexpr std::size_t kLongestText = 60;
constexpr std::size_t kBytesKept = 300;

}  // namespace

void UnservedCommands::note(std::string_view command, std::string_view reaction, std::string_view bytes) {
  UnservedCommand noted;
  Listener listener;
  {
    const std::lock_guard lock(mutex_);
    std::string text = wire::printable(command.substr(0, kLongestText));
    auto found = std::find_if(commands_.begin(), commands_.end(),
                              [&](const UnservedCommand& known) { return known.command == text; });
    if (found == commands_.end() && commands_.size() >= kCapacity) {
      found = commands_.end() - 1;
      found->command = "others";
    }
    if (found == commands_.end()) {
      if (bytes.empty()) bytes = command;
      found = commands_.insert(
          found, {std::move(text), std::string(bytes.substr(0, kBytesKept)), std::string(reaction), 0});
    }
    ++found->count;
    noted = *found;
    listener = listener_;
  }
  if (listener) listener(noted);
}

std::vector<UnservedCommand> UnservedCommands::all() const {
  const std::lock_guard lock(mutex_);
  return commands_;
}

void UnservedCommands::on_note(Listener listener) {
  const std::lock_guard lock(mutex_);
  listener_ = std::move(listener);
}

}  // namespace abcal::sim
