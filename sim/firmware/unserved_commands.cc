#include "sim/firmware/unserved_commands.h"

#include <algorithm>
#include <utility>

#include "drivers/wire/readable_bytes.h"

namespace abcal::sim {
namespace {

constexpr std::size_t kLongestText = 60;

}  // namespace

void UnservedCommands::note(std::string_view command, std::string_view reaction) {
  UnservedCommand first;
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
    if (found != commands_.end()) {
      ++found->count;
      return;
    }
    commands_.push_back({std::move(text), std::string(reaction), 1});
    first = commands_.back();
    listener = listener_;
  }
  if (listener) listener(first);
}

std::vector<UnservedCommand> UnservedCommands::all() const {
  const std::lock_guard lock(mutex_);
  return commands_;
}

void UnservedCommands::on_first(Listener listener) {
  const std::lock_guard lock(mutex_);
  listener_ = std::move(listener);
}

}  // namespace abcal::sim
