#include "drivers/described/codec.h"

#include <algorithm>
#include <utility>

#include "drivers/text/text.h"

namespace abcal::described {
namespace {

constexpr std::size_t kMostEchoes = 64;

}  // namespace

wire::FrameVerdict check_line(std::string_view bytes) {
  const std::string_view shown = bytes.substr(0, kLongestLine);
  const std::size_t end = shown.find_first_of("\r\n");
  if (end == std::string_view::npos)
    return {bytes.size() < kLongestLine ? wire::FrameCheck::kNeedMore : wire::FrameCheck::kInvalid, 0};
  const bool both = shown[end] == '\r' && end + 1 < bytes.size() && bytes[end + 1] == '\n';
  return {wire::FrameCheck::kComplete, end + (both ? 2U : 1U)};
}

std::string normal_line(std::string_view line) {
  return std::string(pieces::trimmed(line));
}

void LineFilter::sent(std::string_view command) {
  if (!echoes_) return;
  while (!command.empty()) {
    const std::size_t end = command.find_first_of("\r\n");
    if (std::string line = normal_line(command.substr(0, end)); !line.empty())
      echo_.push_back(std::move(line));
    if (end == std::string_view::npos) break;
    command.remove_prefix(end + 1);
  }
  while (echo_.size() > kMostEchoes) echo_.pop_front();
}

bool LineFilter::is_removed(const std::string& line) {
  if (line.empty()) return false;
  if (const auto echo = std::find(echo_.begin(), echo_.end(), line); echo != echo_.end()) {
    echo_.erase(echo_.begin(), echo + 1);
    return true;
  }
  return std::any_of(ignored_.begin(), ignored_.end(),
                     [&](const ReplyForm& form) { return form.match(line).has_value(); });
}

std::string LineFilter::pass(std::string_view bytes) {
  std::string out;
  for (const char c : bytes) {
    begun_ += c;
    const bool is_end = c == '\r' || c == '\n';
    if (!is_end && begun_.size() <= kLongestLine) continue;
    if (!is_removed(normal_line(begun_))) out += begun_;
    begun_.clear();
  }
  return out;
}

}  // namespace abcal::described
