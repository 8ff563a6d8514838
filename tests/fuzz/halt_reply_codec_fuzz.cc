// Fuzz target of the halt recipes: whatever bytes a controller sends and however they are split, a recipe is
// acknowledged exactly if a slow reference finds the replies for it; and a reply fits a pattern, whatever its
// parts are, exactly if the reference finds a way to divide it among them.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// halt_reply_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/wire/halt_recipe.h"
#include "drivers/wire/reply_match.h"
#include "tests/support/fake_clock.h"

namespace {

using namespace std::chrono_literals;
using namespace std::string_literals;
using abcal::Clock;
using abcal::HaltRecipe;
using abcal::ReplyPart;
using abcal::ReplyPattern;
namespace pattern = abcal::pattern;
namespace wire = abcal::wire;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "halt recipe and reference differ: %s\n", what);
  std::abort();
}

// ---- The reference: a part either is a piece of a reply or not, and every division into pieces is looked
// at.

constexpr std::size_t kLongest = 256;

bool is_number(std::string_view piece, std::uint32_t least, std::uint32_t most) {
  if (piece.empty() || piece.size() > 10) return false;
  for (const char c : piece)
    if (c < '0' || c > '9') return false;
  const unsigned long long value = std::stoull(std::string(piece));
  return std::to_string(value) == piece && value >= least && value <= most;
}

bool is_bits(std::string_view piece, std::uint32_t mask, bool some) {
  const std::size_t sign = !piece.empty() && (piece[0] == '-' || piece[0] == '+') ? 1 : 0;
  if (piece.size() == sign || piece.size() > sign + 10) return false;
  for (const char c : piece.substr(sign))
    if (c < '0' || c > '9') return false;
  const long long value = std::stoll(std::string(piece));
  if (value < -2147483648LL || value > 4294967295LL) return false;
  return ((static_cast<std::uint32_t>(value) & mask) != 0) == some;
}

bool is_part(const ReplyPart& part, std::string_view piece) {
  switch (part.kind) {
    case ReplyPart::Kind::kBytes: {
      if (piece.size() != part.bytes.size()) return false;
      std::string mask = part.mask;
      mask.resize(piece.size(), '\xff');
      for (std::size_t i = 0; i < piece.size(); ++i)
        if ((piece[i] & mask[i]) != (part.bytes[i] & mask[i])) return false;
      return true;
    }
    case ReplyPart::Kind::kRun:
      return piece.size() >= part.least && piece.size() <= part.most &&
             piece.find_first_not_of(part.bytes) == std::string_view::npos;
    case ReplyPart::Kind::kNumber:
      return is_number(piece, part.least, part.most);
    case ReplyPart::Kind::kBits:
      return is_bits(piece, part.most, part.least != 0);
    case ReplyPart::Kind::kText:
      return piece.find_first_of("\r\n") == std::string_view::npos;
  }
  return false;
}

/// Whether the reply, from its begin on, is the parts from number `first` on. `ends_anywhere`: bytes may
/// follow. `failed` notes the places where the answer is no.
bool is_parts(const std::vector<ReplyPart>& parts, std::size_t first, std::string_view reply,
              bool ends_anywhere, std::vector<std::vector<bool>>& failed) {
  if (first == parts.size()) return ends_anywhere || reply.empty();
  if (failed[first][reply.size()]) return false;
  for (std::size_t length = 0; length <= reply.size(); ++length)
    if (is_part(parts[first], reply.substr(0, length)) &&
        is_parts(parts, first + 1, reply.substr(length), ends_anywhere, failed))
      return true;
  failed[first][reply.size()] = true;
  return false;
}

bool reference_matches(const ReplyPattern& pattern, std::string_view reply, bool anywhere = false) {
  for (const std::vector<ReplyPart>& parts : pattern.alternatives) {
    std::vector<std::vector<bool>> failed(parts.size(), std::vector<bool>(reply.size() + 1));
    for (std::size_t begin = 0; begin <= (anywhere ? reply.size() : 0); ++begin)
      if (is_parts(parts, 0, reply.substr(begin), anywhere, failed)) return true;
  }
  return false;
}

std::string_view newest(std::string_view bytes) {
  return bytes.size() <= kLongest ? bytes : bytes.substr(bytes.size() - kLongest);
}

/// The replies in the order in which they are complete. Of a binary protocol: the newest bytes after each
/// piece.
std::vector<std::string_view> reference_replies(std::string_view bytes, std::size_t piece,
                                                const HaltRecipe& recipe) {
  std::vector<std::string_view> replies;
  if (recipe.binary) {
    for (std::size_t end = 0; end < bytes.size();) {
      end = std::min(bytes.size(), end + piece);
      replies.push_back(newest(bytes.substr(0, end)));
    }
    return replies;
  }
  for (;;) {
    const std::size_t end =
        recipe.reply_end.empty() ? bytes.find_first_of("\r\n") : bytes.find(recipe.reply_end);
    if (end == std::string_view::npos) return replies;
    if (end > 0 && end <= kLongest) replies.push_back(bytes.substr(0, end));
    bytes.remove_prefix(end + std::max<std::size_t>(1, recipe.reply_end.size()));
  }
}

bool reference_acknowledges(const HaltRecipe& recipe, const std::vector<std::string_view>& replies) {
  const HaltRecipe::Question& question = recipe.questions.front();
  bool answered = false;
  for (const std::string_view reply : replies) {
    if (!reference_matches(question.reply, reply, recipe.binary)) continue;
    if (!reference_matches(question.standing, reply, recipe.binary)) return false;
    answered = true;
    if (question.listen == 0ms) return true;
  }
  return answered;
}

// ---- A recipe with every kind of part, and a port

ReplyPattern status(const ReplyPart& number, const ReplyPart& letters) {
  return ReplyPattern{pattern::literal("0,"), number} |
         ReplyPattern{pattern::spaces(), letters, pattern::spaces()} |
         ReplyPattern{pattern::literal("@"),    pattern::run(pattern::kDecimalDigits, 2, 2),
                      pattern::text(),          letters,
                      pattern::literal(" OK "), pattern::text()};
}

ReplyPattern message(const ReplyPart& bits) {
  return {pattern::literal("\x2a\x04"s), pattern::run("\x21\x50", 1, 1), pattern::any_bytes(1), bits};
}

HaltRecipe recipe_of(std::uint8_t choice) {
  HaltRecipe recipe{
      .driver = "fuzz", .axes = {true, true}, .end_partial = {}, .stop = "stop", .questions = {}};
  const ReplyPart any_digits = pattern::run(pattern::kHexadecimalDigits);
  recipe.questions = {{.bytes = "?",
                       .reply = status(pattern::number(7, 263), any_digits) | message(pattern::any_bytes(2)),
                       .standing = status(pattern::number(7, 39), pattern::run("0")) |
                                   message(pattern::zero_bits("\xf0\x02"s))}};
  if (choice % 4 == 1) recipe.reply_end = ",EndOfAPI";
  if (choice % 4 == 2) recipe.reply_end = "aab";
  recipe.binary = choice % 4 == 3;
  if ((choice & 4U) != 0) recipe.questions.front().listen = 100ms;
  return recipe;
}

/// Says its bytes once, in pieces, after the first question, and then nothing.
class Controller final : public wire::ByteStream {
 public:
  Controller(abcal::test::FakeClock& clock, std::string_view bytes, std::size_t piece)
      : clock_(clock), bytes_(bytes), piece_(piece) {}

  void write(std::string_view bytes) override { asked_ = asked_ || bytes == "?"; }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    if (!asked_ || bytes_.empty()) {
      clock_.sleep_until(deadline);
      return {{}, clock_.now()};
    }
    const std::string given(bytes_.substr(0, piece_));
    bytes_.remove_prefix(given.size());
    return {given, clock_.now()};
  }
  /// Called after the first round only if the recipe has refused what came.
  void discard_input() override {
    if (asked_) bytes_ = {};
  }
  std::string name() const override { return "fuzz"; }

 private:
  abcal::test::FakeClock& clock_;
  std::string_view bytes_;
  const std::size_t piece_;
  bool asked_ = false;
};

void carry_out_recipe(std::uint8_t choice, std::size_t piece, std::string_view bytes) {
  const HaltRecipe recipe = recipe_of(choice);
  abcal::test::FakeClock clock;
  Controller controller(clock, bytes, piece);
  const Clock::Instant deadline = clock.now() + 2s;
  const bool found = wire::carry_out(recipe, controller, clock, deadline);
  require(found == reference_acknowledges(recipe, reference_replies(bytes, piece, recipe)),
          "acknowledgement");
  require(clock.now() <= deadline, "the deadline has passed");
  require(found || clock.now() == deadline, "it gave up early");
}

// ---- Any pattern

/// Takes bytes off the front of an input; zeros at its end.
class Input {
 public:
  explicit Input(std::string_view bytes) : bytes_(bytes) {}
  std::uint8_t byte() {
    if (bytes_.empty()) return 0;
    const auto value = static_cast<std::uint8_t>(bytes_.front());
    bytes_.remove_prefix(1);
    return value;
  }
  std::string take(std::size_t count) {
    const std::string taken(bytes_.substr(0, count));
    bytes_.remove_prefix(taken.size());
    return taken;
  }
  std::string_view rest() const { return bytes_; }

 private:
  std::string_view bytes_;
};

ReplyPart part_from(Input& input) {
  ReplyPart part;
  const std::uint8_t choice = input.byte();
  part.kind = static_cast<ReplyPart::Kind>(choice % 5);
  if (part.kind == ReplyPart::Kind::kText) return part;
  if (part.kind == ReplyPart::Kind::kNumber) {
    part.least = input.byte();
    part.most = part.least + input.byte() * (choice >= 128 ? 10'000'000U : 1U);
    return part;
  }
  if (part.kind == ReplyPart::Kind::kBits) {
    part.least = choice / 128;
    for (int bytes = 0; bytes < 4; ++bytes) part.most = part.most << 8U | input.byte();
    return part;
  }
  part.bytes = input.take(choice / 4 % 4);
  if (part.kind == ReplyPart::Kind::kBytes) {
    part.mask = input.take(choice / 16 % 4);
  } else {
    part.least = choice / 16 % 4;
    part.most = choice / 64 % 2 == 0 ? pattern::kAnyCount : part.least + choice / 128;
  }
  return part;
}

void match_any_pattern(std::string_view bytes) {
  Input input(bytes);
  const std::uint8_t sizes = input.byte();
  ReplyPattern any;
  for (unsigned alternative = 0; alternative < sizes % 4U; ++alternative) {
    std::vector<ReplyPart>& parts = any.alternatives.emplace_back();
    for (unsigned part = 0; part < sizes / 4U % 8U; ++part) parts.push_back(part_from(input));
  }
  const std::string_view reply = input.rest();
  require(wire::matches(any, reply) == (reply.size() <= kLongest && reference_matches(any, reply)),
          "whether a reply fits");
  require(wire::occurs_in(any, reply) == reference_matches(any, newest(reply), true),
          "whether it is anywhere in the bytes");
}

}  // namespace

// The first byte says what is done, the second how the rest is split.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const std::string_view rest(reinterpret_cast<const char*>(data) + 2, size - 2);
  if (data[0] >= 128) {
    match_any_pattern(rest);
  } else {
    carry_out_recipe(data[0], 1 + 3 * std::size_t{data[1]}, rest);
  }
  return 0;
}
