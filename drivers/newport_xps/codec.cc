#include "drivers/newport_xps/codec.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::newport_xps {
namespace {

using Texts = std::pair<int, std::string_view>;

constexpr std::array kErrors = std::to_array<Texts>({
    {-1, "the connection is busy with an earlier command"},
    {-2, "time-out of the connection"},
    {-3, "the command is too long"},
    {-4, "it does not know the command"},
    {-5, "not allowed because of an error of the positioner"},
    {-7, "the command has a wrong format"},
    {-8, "the command is for another kind of object"},
    {-9, "wrong number of parameters"},
    {-17, "a parameter is out of range"},
    {-18, "there is no such positioner"},
    {-19, "there is no such group"},
    {-20, "fatal error during its start; see its error log"},
    {-21, "the controller is still starting"},
    {-22, "not allowed in the state of the group"},
    {-25, "following error: the motor does not follow"},
    {-26, "emergency stop"},
    {-27, "the motion was aborted"},
    {-28, "the home search took too long"},
    {-33, "the motion took too long to settle"},
    {-35, "the target is outside the travel limits"},
    {-44, "a slave positioner has an error"},
    {-45, "an end-of-run switch was reached"},
    {-50, "the motor could not be initialised"},
    {-109, "the group must have been homed once"},
});

constexpr std::array kStates = std::to_array<Texts>({
    {0, "not initialised"},
    {2, "not initialised: emergency stop"},
    {3, "not initialised: following error"},
    {4, "not initialised: following error"},
    {5, "not initialised: the home search took too long"},
    {7, "not initialised: killed"},
    {10, "ready after an abort"},
    {11, "ready after homing"},
    {12, "ready after a motion"},
    {13, "ready: motion enabled"},
    {20, "disabled"},
    {40, "emergency brake"},
    {41, "initialising the motor"},
    {42, "not referenced"},
    {43, "homing"},
    {44, "moving"},
    {45, "on a trajectory"},
    {47, "jogging"},
    {51, "spinning"},
    {64, "referencing"},
});

template <std::size_t N>
std::string_view find_text(const std::array<Texts, N>& texts, int key, std::string_view otherwise) {
  for (const auto& [known, text] : texts) {
    if (known == key) return text;
  }
  return otherwise;
}

}  // namespace

wire::FrameVerdict check_reply(std::string_view bytes) {
  const std::size_t at = bytes.substr(0, kLongestReply).find(kReplyEnd);
  if (at != std::string_view::npos) return {wire::FrameCheck::kComplete, at + kReplyEnd.size()};
  return {bytes.size() < kLongestReply ? wire::FrameCheck::kNeedMore : wire::FrameCheck::kInvalid, 0};
}

std::optional<Reply> parse_reply(std::string_view frame) {
  if (!frame.ends_with(kReplyEnd)) return std::nullopt;
  frame.remove_suffix(kReplyEnd.size());
  if (!std::all_of(frame.begin(), frame.end(), [](char c) { return c >= 0x20 && c < 0x7F; }))
    return std::nullopt;
  const std::size_t comma = frame.find(',');
  const auto code = pieces::number<int>(frame.substr(0, comma));
  constexpr int kLargestCode = 9999;
  if (!code || *code > 1 || *code < -kLargestCode) return std::nullopt;
  return Reply{*code, comma == std::string_view::npos ? std::string() : std::string(frame.substr(comma + 1))};
}

std::optional<double> parse_number(std::string_view text) {
  // No position, speed or acceleration is this large: a larger number is a damaged reply.
  constexpr double kLargestNumber = 1e12;
  const auto value = pieces::number<double>(text);
  return value && std::abs(*value) <= kLargestNumber ? value : std::nullopt;
}

std::optional<std::vector<double>> parse_numbers(std::string_view values, std::size_t count) {
  std::vector<double> numbers;
  for (const std::string_view word : pieces::split(values, ',')) {
    const auto number = parse_number(word);
    if (!number) return std::nullopt;
    numbers.push_back(*number);
  }
  if (numbers.size() != count) return std::nullopt;
  return numbers;
}

std::optional<int> parse_state(std::string_view text) {
  constexpr int kLargestState = 127;
  const auto state = pieces::number<int>(text);
  if (!state || *state < 0 || *state > kLargestState) return std::nullopt;
  return state;
}

std::optional<Identity> parse_identity(std::string_view text) {
  if (!text.starts_with("XPS") && !text.starts_with("HXP")) return std::nullopt;
  const std::vector<std::string_view> words = pieces::words(text);
  Identity identity{std::string(words.front()), {}};
  if (words.size() > 1) identity.firmware = words.back();
  return identity;
}

GroupState meaning_of(int state) {
  if (state <= 9 || state == 50 || state == 63) return GroupState::kNotInitialised;
  if (state <= 19) return GroupState::kReady;
  if (state <= 40) return GroupState::kDisabled;
  if (state == 42) return GroupState::kNotReferenced;
  if (state == 41 || state == 43 || state == 64) return GroupState::kHoming;
  return GroupState::kMoving;
}

std::string_view state_text(int state) {
  if (state > 20 && state < 40) return "disabled by an error";
  return find_text(kStates, state, "a state of unknown meaning");
}

std::string_view error_text(int code) {
  return find_text(kErrors, code, "of unknown meaning; see the Programmer's Manual of the controller");
}

}  // namespace abcal::newport_xps
