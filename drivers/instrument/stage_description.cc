#include "drivers/instrument/stage_description.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <bitset>
#include <cmath>
#include <deque>
#include <limits>
#include <map>
#include <set>
#include <span>
#include <stdexcept>
#include <tuple>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal {
namespace {

using Part = ReplyForm::Part;

constexpr std::string_view kNumberBytes = "+-.0123456789eE";
constexpr std::uint32_t kMostHexDigits = 8;

const std::vector<std::string_view>& number_fields() {
  static const std::vector<std::string_view> all{"angle", "speed", "lower", "upper", "units_per_turn"};
  return all;
}
const std::vector<std::string_view>& text_fields() {
  static const std::vector<std::string_view> all{"maker", "model", "serial", "firmware", "text"};
  return all;
}

bool is_one_of(std::string_view word, const std::vector<std::string_view>& words) {
  return std::find(words.begin(), words.end(), word) != words.end();
}

/// All printable characters but the blank.
const std::string& word_bytes() {
  static const std::string all = [] {
    std::string bytes;
    for (char c = '!'; c <= '~'; ++c) bytes += c;
    return bytes;
  }();
  return all;
}

/// The characters of which a reply for all axes may have one for each.
constexpr std::string_view kStateLetters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789?";

std::optional<std::uint32_t> hex_number(std::string_view text) {
  return text.empty() ? std::nullopt : pieces::number<std::uint32_t>(text, 16);
}

[[noreturn]] void refuse_field(std::string_view field, std::string_view required) {
  throw std::invalid_argument(fmt::format("the field {{{}}}; required: {}", field, required));
}

constexpr const char* kReplyFields =
    "{angle}, {speed}, {lower}, {upper} or {units_per_turn} for a number, {model}, {serial}, {firmware}, "
    "{maker} or {text} for a text, {serial:digits}, {word}, {number}, {digits}, {digits2}, {0..39}, {hex}, "
    "{hex4}, {hex4 none 0002}, {hex4 some 0002}, {decimal}, {decimal none bits 0 3}, {decimal some bits 0 "
    "3}, "
    "{number below 0.01}, {number not below 0.01}, {one of A B}, {before ,} or {after ,}";

/// A word in braces with a number behind it: "digits2".
std::optional<std::uint32_t> count_behind(std::string_view field, std::string_view word) {
  if (!field.starts_with(word)) return std::nullopt;
  field.remove_prefix(word.size());
  return field.empty() ? 0U : pieces::number<std::uint32_t>(field);
}

/// {decimal some bits 0 3}: bits by their numbers, so that no mask is taken for decimal or hexadecimal.
Part bits_part(std::string_view field, const std::vector<std::string_view>& words) {
  Part part{.kind = Part::Kind::kBits, .bits = Part::Bits::kNoneSet};
  if (words.size() == 1) return part;
  bool is_good = words.size() > 3 && (words[1] == "none" || words[1] == "some") && words[2] == "bits";
  for (std::size_t k = 3; is_good && k < words.size(); ++k) {
    const auto bit = pieces::number<std::uint32_t>(words[k]);
    is_good = bit && *bit < 32;
    if (is_good) part.mask |= 1U << *bit;
  }
  if (!is_good)
    refuse_field(field,
                 "{decimal some bits 0 3} or {decimal none bits 0 3}, with the numbers of the bits, 0 to 31");
  if (words[1] == "some") part.bits = Part::Bits::kSomeSet;
  return part;
}

/// {number below 0.01} and {number not below 0.01}: the limit is a power of ten, so that the digits decide.
std::optional<Part> limit_part(std::string_view field, const std::vector<std::string_view>& words) {
  if (words.size() < 2 || words[0] != "number") return std::nullopt;
  const bool is_not = words[1] == "not";
  const std::string_view limit = words.back();
  const std::string_view zeros = limit.starts_with("0.") && limit.ends_with('1')
                                     ? limit.substr(2, limit.size() - 3)
                                     : std::string_view("none");
  const bool is_good = words.size() == (is_not ? 4U : 3U) && words[is_not ? 2 : 1] == "below" &&
                       zeros.size() < 9 && zeros.find_first_not_of('0') == std::string_view::npos;
  if (!is_good)
    refuse_field(field, "{number below 0.01} or {number not below 0.01}, with 0.1, 0.01, 0.001 and so on");
  return Part{.kind = is_not ? Part::Kind::kNotBelow : Part::Kind::kBelow,
              .text = std::string(limit),
              .least = static_cast<std::uint32_t>(zeros.size() + 1)};
}

/// {before ,} and {after ,}: the axes in front of this one, and behind it.
std::optional<Part> place_part(std::string_view field, const std::vector<std::string_view>& words) {
  if (words.empty() || (words[0] != "before" && words[0] != "after")) return std::nullopt;
  Part part{.kind = words[0] == "before" ? Part::Kind::kBefore : Part::Kind::kAfter};
  if (words.size() == 1) return part;
  part.text = words[1] == "blank" ? " " : std::string(words[1]);
  if (words.size() > 2 || part.text.size() != 1 || kNumberBytes.find(part.text) != std::string_view::npos)
    refuse_field(field, fmt::format("{{{0}}}: a character for each axis, {{{0} ,}}: commas between them, or "
                                    "{{{0} blank}}",
                                    words[0]));
  return part;
}

Part reply_part(std::string_view field) {
  if (const std::size_t colon = field.find(':');
      colon != std::string_view::npos && !field.starts_with("one of ")) {
    const std::string_view name = field.substr(0, colon);
    if (!is_one_of(name, text_fields()) || name == "text")
      refuse_field(field, "{serial:digits}, or likewise {model:...}, {firmware:...}, {maker:...}");
    Part part = reply_part(field.substr(colon + 1));
    if (!part.field.empty() || part.kind == Part::Kind::kBefore || part.kind == Part::Kind::kAfter)
      refuse_field(field, "{serial:digits}, {serial:digits6}, {serial:hex} or {serial:word}");
    part.field = name;
    return part;
  }
  if (is_one_of(field, number_fields())) return {.kind = Part::Kind::kNumber, .field = std::string(field)};
  if (is_one_of(field, text_fields())) return {.kind = Part::Kind::kText, .field = std::string(field)};
  if (field == "word") return {.kind = Part::Kind::kWord};
  if (field == "number") return {.kind = Part::Kind::kNumber};
  if (const auto digits = count_behind(field, "digits"); digits && *digits <= 20)
    return {.kind = Part::Kind::kDigits, .least = *digits};
  const std::vector<std::string_view> words = pieces::words(field);
  if (const auto part = place_part(field, words)) return *part;
  if (const auto part = limit_part(field, words)) return *part;
  if (!words.empty()) {
    if (words[0] == "decimal") return bits_part(field, words);
    if (words.size() > 2 && words[0] == "one" && words[1] == "of") {
      Part part{.kind = Part::Kind::kOneOf};
      for (const std::string_view choice : std::span(words).subspan(2)) part.choices.emplace_back(choice);
      return part;
    }
    if (const auto digits = count_behind(words[0], "hex"); digits && *digits <= kMostHexDigits) {
      Part part{.kind = Part::Kind::kHex, .least = *digits};
      if (words.size() == 1) return part;
      const auto mask = words.size() == 3 ? hex_number(words[2]) : std::nullopt;
      const bool has_word = words.size() == 3 && (words[1] == "none" || words[1] == "some");
      if (!has_word || !mask || *mask == 0)
        refuse_field(field, "{hex4 none 0002}: none of these bits is 1, or {hex4 some 0002}");
      part.mask = *mask;
      part.bits = words[1] == "none" ? Part::Bits::kNoneSet : Part::Bits::kSomeSet;
      if (*digits > 0 && *digits < kMostHexDigits && (*mask >> (4U * *digits)) != 0)
        refuse_field(field, "a mask with no more digits than the number has");
      return part;
    }
  }
  if (const std::size_t dots = field.find(".."); dots != std::string_view::npos) {
    const auto least = pieces::number<std::uint32_t>(field.substr(0, dots));
    const auto most = pieces::number<std::uint32_t>(field.substr(dots + 2));
    if (least && most && *least <= *most) return {.kind = Part::Kind::kRange, .least = *least, .most = *most};
  }
  refuse_field(field, kReplyFields);
}

/// Calls back for the literals, blanks and fields of a form. "{{" and "}}" are braces.
template <class Literal, class Field>
void read_form(const std::string& text, const Literal& literal, const Field& field) {
  for (std::size_t at = 0; at < text.size(); ++at) {
    const char c = text[at];
    const bool is_double = at + 1 < text.size() && text[at + 1] == c;
    if ((c == '{' || c == '}') && is_double) {
      literal(c);
      ++at;
    } else if (c == '{') {
      const std::size_t end = text.find('}', at);
      if (end == std::string::npos)
        throw std::invalid_argument("a brace { without its }; required: {field}, or {{ for a brace");
      field(std::string_view(text).substr(at + 1, end - at - 1));
      at = end;
    } else if (c == '}') {
      throw std::invalid_argument("a brace } without its {; required: }} for a brace");
    } else {
      literal(c);
    }
  }
}

bool is_decimal_number(std::string_view text) {
  const auto value = pieces::number<double>(pieces::without_plus(text));
  return value && std::isfinite(*value);
}

/// A number as it is sent; no minus before zero.
std::string written(double number, int decimals) {
  std::string text = fmt::format("{:.{}f}", number, decimals);
  const bool is_zero = text.find_first_not_of("-0.") == std::string::npos;
  return is_zero && text.starts_with('-') ? text.substr(1) : text;
}

bool fits_bits(const Part& part, std::string_view digits) {
  const auto value = hex_number(digits);
  if (!value) return false;
  if (part.bits == Part::Bits::kNoneSet) return (*value & part.mask) == 0;
  return part.bits == Part::Bits::kFree || (*value & part.mask) != 0;
}

/// Whether it is a whole number of 32 bits under the mask of a part.
bool fits_decimal_bits(const Part& part, std::string_view text) {
  constexpr std::size_t kMostDigits = 10;
  const std::string_view digits = text.substr(text.starts_with('-') || text.starts_with('+') ? 1 : 0);
  if (digits.empty() || digits.size() > kMostDigits ||
      digits.find_first_not_of(pattern::kDecimalDigits) != std::string_view::npos)
    return false;
  const auto value = pieces::number<std::int64_t>(pieces::without_plus(text));
  if (!value || *value < std::numeric_limits<std::int32_t>::min() ||
      *value > std::numeric_limits<std::uint32_t>::max())
    return false;
  return ((static_cast<std::uint32_t>(*value) & part.mask) != 0) == (part.bits == Part::Bits::kSomeSet);
}

/// The parts of `part.least` axes in front.
std::vector<ReplyPart> parts_before(const Part& part) {
  if (part.text.empty()) return {pattern::run(kStateLetters, part.least, part.least)};
  // An item may have blanks within, unless they are between the items.
  std::string first = part.choices.empty() ? word_bytes() : part.choices[0], other = first + " ";
  for (std::string* bytes : {&first, &other}) std::erase(*bytes, part.text[0]);
  std::vector<ReplyPart> parts;
  for (std::uint32_t n = 0; n < part.least; ++n) {
    parts.push_back(pattern::run(first, 1, 1));
    parts.push_back(pattern::run(other, 0));
    parts.push_back(pattern::literal(part.text));
    parts.push_back(pattern::spaces());
  }
  return parts;
}

/// Whether the text has only characters of other axes' parts, and of what is between them.
bool has_bytes_of_items(const Part& part, std::string_view text) {
  return part.choices.empty() ||
         text.find_first_not_of(part.choices[0] + part.text + " ") == std::string_view::npos;
}

/// Whether the text is the parts of `part.least` axes in front.
bool are_items_before(const Part& part, std::string_view text) {
  if (!has_bytes_of_items(part, text)) return false;
  if (part.text.empty())
    return text.size() == part.least && text.find_first_not_of(kStateLetters) == std::string_view::npos;
  for (std::uint32_t n = 0; n < part.least; ++n) {
    const std::size_t end = text.find(part.text[0]);
    if (end == std::string_view::npos || end == 0 || text[0] == ' ') return false;
    text.remove_prefix(end + 1);
    text.remove_prefix(std::min(text.find_first_not_of(' '), text.size()));
  }
  return text.empty();
}

/// Whether a part can be exactly this text.
bool is_one(const Part& part, std::string_view text) {
  const auto all_of = [&](std::string_view set) {
    return text.find_first_not_of(set) == std::string_view::npos;
  };
  switch (part.kind) {
    case Part::Kind::kLiteral:
      return text == part.text;
    case Part::Kind::kBlanks:
      return !text.empty() && all_of(" ");
    case Part::Kind::kNumber:
      return is_decimal_number(text);
    case Part::Kind::kBelow:
    case Part::Kind::kNotBelow:
      return is_decimal_number(text) && text.find_first_of("eE") == std::string_view::npos &&
             (std::abs(*pieces::number<double>(pieces::without_plus(text))) <
              *pieces::number<double>(part.text)) == (part.kind == Part::Kind::kBelow);
    case Part::Kind::kRange: {
      const auto value = pieces::number<std::uint32_t>(text);
      return value && *value >= part.least && *value <= part.most && (text.size() == 1 || text[0] != '0');
    }
    case Part::Kind::kDigits:
      return !text.empty() && all_of(pattern::kDecimalDigits) &&
             (part.least == 0 || text.size() == part.least);
    case Part::Kind::kHex:
      return !text.empty() && text.size() <= kMostHexDigits && all_of(pattern::kHexadecimalDigits) &&
             (part.least == 0 || text.size() == part.least) && fits_bits(part, text);
    case Part::Kind::kWord:
      return !text.empty() && all_of(word_bytes());
    case Part::Kind::kText:
      return true;
    case Part::Kind::kOneOf:
      return std::find(part.choices.begin(), part.choices.end(), text) != part.choices.end();
    case Part::Kind::kBits:
      return fits_decimal_bits(part, text);
    case Part::Kind::kBefore:
      return are_items_before(part, text);
    case Part::Kind::kAfter: {
      if (part.text.empty()) return all_of(kStateLetters);
      const std::string_view rest = text.substr(std::min(text.find_first_not_of(' '), text.size()));
      if (!has_bytes_of_items(part, text)) return false;
      return text.empty() || (part.text == " " ? text[0] == ' ' : rest.starts_with(part.text));
    }
  }
  return false;
}

/// The texts of the parts from `at` on, the shortest first; false: there is no such division.
bool divide(const std::vector<Part>& parts, std::size_t at, std::string_view rest,
            std::set<std::pair<std::size_t, std::size_t>>& failed, FieldValues& values) {
  if (at == parts.size()) return rest.empty();
  if (failed.contains({at, rest.size()})) return false;
  for (std::size_t length = 0; length <= rest.size(); ++length) {
    const std::string_view text = rest.substr(0, length);
    if (!is_one(parts[at], text)) continue;
    if (!divide(parts, at + 1, rest.substr(length), failed, values)) continue;
    if (!parts[at].field.empty()) values.insert_or_assign(parts[at].field, std::string(text));
    return true;
  }
  failed.insert({at, rest.size()});
  return false;
}

/// The hexadecimal digits in which the bits of `mask` are all 0, or one of them is 1.
std::string digits_with(std::uint32_t mask, bool some) {
  std::string set;
  for (const char c : pattern::kHexadecimalDigits) {
    const std::uint32_t value = *hex_number(std::string_view(&c, 1));
    if (((value & mask) != 0) == some) set += c;
  }
  return set;
}

/// Hexadecimal numbers of so many digits under the mask, as sequences of parts.
void add_hex_alternatives(const Part& part, std::uint32_t count, std::vector<std::vector<ReplyPart>>& out) {
  const auto nibble = [&](std::uint32_t place) { return (part.mask >> (4U * place)) & 0xFU; };
  std::vector<ReplyPart> any;
  for (std::uint32_t place = count; place-- > 0;) {
    const bool is_free = part.bits != Part::Bits::kNoneSet || nibble(place) == 0;
    any.push_back(pattern::run(
        is_free ? std::string(pattern::kHexadecimalDigits) : digits_with(nibble(place), false), 1, 1));
  }
  if (part.bits != Part::Bits::kSomeSet) {
    out.push_back(std::move(any));
    return;
  }
  for (std::uint32_t place = 0; place < count; ++place) {
    if (nibble(place) == 0) continue;
    std::vector<ReplyPart> one = any;
    one[count - 1 - place] = pattern::run(digits_with(nibble(place), true), 1, 1);
    out.push_back(std::move(one));
  }
}

/// A decimal number, so that "4.02.004" is none.
std::vector<std::vector<ReplyPart>> number_alternatives() {
  const ReplyPart sign = pattern::run("+-", 0, 1), point = pattern::run(".", 0, 1),
                  digits = pattern::run(pattern::kDecimalDigits),
                  more_digits = pattern::run(pattern::kDecimalDigits, 0);
  std::vector<std::vector<ReplyPart>> all{{sign, digits, point, more_digits},
                                          {sign, pattern::literal("."), digits}};
  for (std::size_t k = 0; k < 2; ++k) {
    all.push_back(all[k]);
    all.back().insert(all.back().end(), {pattern::run("eE", 1, 1), sign, digits});
  }
  return all;
}

/// A number on one side of a limit, by its digits: the first that is not zero has its place.
std::vector<std::vector<ReplyPart>> limit_alternatives(const Part& part) {
  const ReplyPart sign = pattern::run("+-", 0, 1), point = pattern::literal("."),
                  zeros = pattern::run("0", 0), digits = pattern::run(pattern::kDecimalDigits, 0),
                  first = pattern::run("123456789", 1, 1);
  const auto zeros_behind_point = [](std::uint32_t count) { return pattern::run("0", count, count); };
  if (part.kind == Part::Kind::kBelow)
    return {{sign, pattern::run("0"), pattern::run(".", 0, 1), zeros},
            {sign, zeros, point, zeros_behind_point(part.least), digits}};
  std::vector<std::vector<ReplyPart>> all{{sign, zeros, first, digits, pattern::run(".", 0, 1), digits}};
  for (std::uint32_t count = 0; count < part.least; ++count)
    all.push_back({sign, zeros, point, zeros_behind_point(count), first, digits});
  return all;
}

/// The part as parts of a ReplyPattern: one sequence or several.
std::vector<std::vector<ReplyPart>> alternatives_of(const Part& part) {
  switch (part.kind) {
    case Part::Kind::kLiteral:
      return {{pattern::literal(part.text)}};
    case Part::Kind::kBlanks:
      return {{pattern::run(" ")}};
    case Part::Kind::kNumber:
      return number_alternatives();
    case Part::Kind::kBelow:
    case Part::Kind::kNotBelow:
      return limit_alternatives(part);
    case Part::Kind::kRange:
      return {{pattern::number(part.least, part.most)}};
    case Part::Kind::kDigits:
      return {{part.least == 0 ? pattern::run(pattern::kDecimalDigits)
                               : pattern::run(pattern::kDecimalDigits, part.least, part.least)}};
    case Part::Kind::kHex: {
      std::vector<std::vector<ReplyPart>> all;
      const std::uint32_t first = part.least == 0 ? 1 : part.least;
      const std::uint32_t last = part.least == 0 ? kMostHexDigits : part.least;
      for (std::uint32_t count = first; count <= last; ++count) add_hex_alternatives(part, count, all);
      return all;
    }
    case Part::Kind::kWord:
      return {{pattern::run(word_bytes())}};
    case Part::Kind::kText:
      return {{pattern::text()}};
    case Part::Kind::kOneOf: {
      // Words that differ in their last character are one: a guard receives its patterns in a short packet.
      std::map<std::string, std::string> last_characters;
      for (const std::string& choice : part.choices)
        last_characters[choice.substr(0, choice.size() - 1)] += choice.back();
      std::vector<std::vector<ReplyPart>> all;
      for (const auto& [begin, ends] : last_characters)
        all.push_back({pattern::literal(begin), pattern::run(ends, 1, 1)});
      return all;
    }
    case Part::Kind::kBits:
      return {{part.bits == Part::Bits::kSomeSet ? pattern::some_bit_of(part.mask)
                                                 : pattern::no_bit_of(part.mask)}};
    case Part::Kind::kBefore:
      return {parts_before(part)};
    case Part::Kind::kAfter: {
      if (part.text.empty()) return {{pattern::run(kStateLetters, 0)}};
      const ReplyPart items =
          part.choices.empty() ? pattern::text() : pattern::run(part.choices[0] + part.text + " ", 0);
      if (part.text == " ") return {{}, {pattern::run(" "), items}};
      return {{}, {pattern::spaces(), pattern::literal(part.text), items}};
    }
  }
  return {};
}

/// An automaton of a pattern: states with the bytes that lead on. A number of a range is taken for digits,
/// and one under a mask too, unless both patterns have one at the same place.
struct Automaton {
  using Bytes = std::bitset<256>;
  struct Arc {
    Bytes bytes;
    std::size_t to = 0;
  };
  /// The end of a number under a mask, which leads out of its digits.
  struct Exit {
    ReplyPart bits;
    std::size_t to = 0;
  };
  std::vector<std::vector<Arc>> arcs;
  std::vector<std::vector<std::size_t>> free;  ///< Without a byte.
  std::vector<std::optional<Exit>> exits;
  std::vector<bool> in_bits;  ///< Within a number under a mask.
  std::vector<bool> last;

  std::size_t add_state() {
    arcs.emplace_back();
    free.emplace_back();
    exits.emplace_back();
    in_bits.push_back(false);
    last.push_back(false);
    return arcs.size() - 1;
  }
};

/// The numbers of two places at which both patterns have one under a mask.
std::optional<std::uint32_t> common_bits(const ReplyPart& one, const ReplyPart& other) {
  std::uint32_t zeros = 0, value = 0;
  for (const ReplyPart* part : {&one, &other})
    if (part->least == 0) zeros |= part->most;
  for (const ReplyPart* part : {&one, &other}) {
    if (part->least == 0) continue;
    const std::uint32_t left = part->most & ~zeros;
    if (left == 0) return std::nullopt;
    value |= left & (~left + 1U);  // Its lowest bit.
  }
  return value;
}

Automaton::Bytes bytes_of(std::string_view set) {
  Automaton::Bytes bytes;
  for (const char c : set) bytes.set(static_cast<unsigned char>(c));
  return bytes;
}

/// Adds a part behind a state; returns the state behind it.
std::size_t add_part(Automaton& automaton, std::size_t from, const ReplyPart& part) {
  const auto step = [&](std::size_t at, const Automaton::Bytes& bytes) {
    const std::size_t to = automaton.add_state();
    automaton.arcs[at].push_back({bytes, to});
    return to;
  };
  const auto loop = [&](std::size_t at, const Automaton::Bytes& bytes) {
    automaton.arcs[at].push_back({bytes, at});
    return at;
  };
  switch (part.kind) {
    case ReplyPart::Kind::kBytes:
      for (const char c : part.bytes) from = step(from, bytes_of(std::string_view(&c, 1)));
      return from;
    case ReplyPart::Kind::kRun: {
      const Automaton::Bytes bytes = bytes_of(part.bytes);
      for (std::uint32_t n = 0; n < part.least; ++n) from = step(from, bytes);
      if (part.most == part.least) return from;
      const std::size_t more = automaton.add_state();
      automaton.free[from].push_back(more);
      return loop(more, bytes);
    }
    case ReplyPart::Kind::kNumber: {
      // Written out where it is short, so that 0..9 and 10..39 are found to differ.
      constexpr std::uint32_t kMostWritten = 1000;
      const std::size_t end = automaton.add_state();
      if (part.most - part.least > kMostWritten) {
        const Automaton::Bytes digits = bytes_of(pattern::kDecimalDigits);
        const std::size_t more = step(from, digits);
        loop(more, digits);
        automaton.free[more].push_back(end);
        return end;
      }
      for (std::uint32_t value = part.least; value <= part.most; ++value) {
        std::size_t at = from;
        for (const char c : std::to_string(value)) at = step(at, bytes_of(std::string_view(&c, 1)));
        automaton.free[at].push_back(end);
      }
      return end;
    }
    case ReplyPart::Kind::kBits: {
      const Automaton::Bytes digits = bytes_of(pattern::kDecimalDigits);
      const std::size_t inside = step(from, digits), sign = step(from, bytes_of("+-"));
      automaton.arcs[sign].push_back({digits, inside});
      loop(inside, digits);
      const std::size_t end = automaton.add_state();
      automaton.exits[inside] = Automaton::Exit{part, end};
      automaton.in_bits[inside] = automaton.in_bits[sign] = true;
      return end;
    }
    case ReplyPart::Kind::kText: {
      const std::size_t more = automaton.add_state();
      automaton.free[from].push_back(more);
      Automaton::Bytes bytes;
      for (unsigned c = 0x20; c < 0x7F; ++c) bytes.set(c);
      return loop(more, bytes);
    }
  }
  return from;
}

Automaton automaton_of(const ReplyPattern& pattern) {
  Automaton automaton;
  const std::size_t begin = automaton.add_state();
  for (const std::vector<ReplyPart>& parts : pattern.alternatives) {
    std::size_t at = automaton.add_state();
    automaton.free[begin].push_back(at);
    for (const ReplyPart& part : parts) at = add_part(automaton, at, part);
    automaton.last[at] = true;
  }
  return automaton;
}

bool matches_glob(std::string_view glob, std::string_view text) {
  if (glob.empty()) return text.empty();
  if (glob.front() == '*') {
    for (std::size_t n = 0; n <= text.size(); ++n)
      if (matches_glob(glob.substr(1), text.substr(n))) return true;
    return false;
  }
  return !text.empty() && glob.front() == text.front() && matches_glob(glob.substr(1), text.substr(1));
}

}  // namespace

ReplyForm::ReplyForm(std::string text) : text_(std::move(text)) {
  read_form(
      text_,
      [&](char c) {
        const bool is_blank = c == ' ';
        const Part::Kind kind = is_blank ? Part::Kind::kBlanks : Part::Kind::kLiteral;
        if (parts_.empty() || parts_.back().kind != kind) parts_.push_back({.kind = kind});
        if (!is_blank) parts_.back().text += c;
      },
      [&](std::string_view field) { parts_.push_back(reply_part(field)); });
  const auto place_of = [&](Part::Kind kind) {
    return std::find_if(parts_.begin(), parts_.end(), [&](const Part& part) { return part.kind == kind; });
  };
  const auto count_of = [&](Part::Kind kind) {
    return std::count_if(parts_.begin(), parts_.end(), [&](const Part& part) { return part.kind == kind; });
  };
  if (const auto before = place_of(Part::Kind::kBefore), after = place_of(Part::Kind::kAfter);
      before != parts_.end() || after != parts_.end()) {
    if (before >= after || after == parts_.end() || before->text != after->text ||
        count_of(Part::Kind::kBefore) != 1 || count_of(Part::Kind::kAfter) != 1)
      throw std::invalid_argument(
          "{before} and {after} that are no pair; required: one of each, in this order, both with the same "
          "character between the axes, as {before ,}{angle}{after ,}");
  }
  // The other axes have numbers where this one has.
  for (std::size_t k = 0; k + 2 < parts_.size(); ++k)
    if (parts_[k].kind == Part::Kind::kBefore && !parts_[k].text.empty() &&
        parts_[k + 1].kind == Part::Kind::kNumber && parts_[k + 2].kind == Part::Kind::kAfter)
      parts_[k].choices = parts_[k + 2].choices = {std::string(kNumberBytes)};
  for (std::size_t k = 1; k < parts_.size(); ++k) {
    const auto is_open = [](const Part& part) {
      return part.kind == Part::Kind::kText || part.kind == Part::Kind::kWord ||
             part.kind == Part::Kind::kNumber || part.kind == Part::Kind::kBelow ||
             part.kind == Part::Kind::kNotBelow;
    };
    const auto swallows = [&](const Part& part, const Part& next) {
      const bool takes_all = part.kind == Part::Kind::kText || part.kind == Part::Kind::kWord;
      return next.kind == Part::Kind::kAfter && (next.text.empty() ? is_open(part) : takes_all);
    };
    if ((is_open(parts_[k - 1]) && is_open(parts_[k])) || swallows(parts_[k - 1], parts_[k]))
      throw std::invalid_argument(
          "two fields with nothing between them, so that nobody knows where one ends; "
          "required: a blank or text between them");
  }
}

bool ReplyForm::has(std::string_view field) const {
  return std::any_of(parts_.begin(), parts_.end(), [&](const Part& part) { return part.field == field; });
}

bool ReplyForm::has_places() const {
  return std::any_of(parts_.begin(), parts_.end(),
                     [](const Part& part) { return part.kind == Part::Kind::kBefore; });
}

ReplyForm ReplyForm::at(std::size_t place) const {
  ReplyForm form = *this;
  for (Part& part : form.parts_)
    if (part.kind == Part::Kind::kBefore) part.least = static_cast<std::uint32_t>(place - 1);
  return form;
}

ReplyForm ReplyForm::item() const {
  ReplyForm form = *this;
  const auto before = std::find_if(form.parts_.begin(), form.parts_.end(),
                                   [](const Part& part) { return part.kind == Part::Kind::kBefore; });
  if (before != form.parts_.end()) form.parts_.erase(form.parts_.begin(), before + 1);
  const auto after = std::find_if(form.parts_.begin(), form.parts_.end(),
                                  [](const Part& part) { return part.kind == Part::Kind::kAfter; });
  form.parts_.erase(after, form.parts_.end());
  return form;
}

std::string ReplyForm::reply_of(const std::vector<std::string>& items) const {
  ReplyForm around = *this;
  std::erase_if(around.parts_, [within = false](const Part& part) mutable {
    const bool is_item = within && part.kind != Part::Kind::kAfter;
    if (part.kind == Part::Kind::kBefore || part.kind == Part::Kind::kAfter)
      within = part.kind == Part::Kind::kBefore;
    return is_item || part.kind == Part::Kind::kAfter;
  });
  for (Part& part : around.parts_)
    if (part.kind == Part::Kind::kBefore)
      part = {.kind = Part::Kind::kLiteral, .text = fmt::format("{}", fmt::join(items, part.text))};
  return around.reply({});
}

std::optional<FieldValues> ReplyForm::match(std::string_view reply) const {
  if (reply.size() > kLongestHaltReply) return std::nullopt;
  const auto is_printable = [](char c) { return c >= 0x20 && c < 0x7F; };
  if (!std::all_of(reply.begin(), reply.end(), is_printable)) return std::nullopt;
  FieldValues values;
  std::set<std::pair<std::size_t, std::size_t>> failed;
  return divide(parts_, 0, reply, failed, values) ? std::optional(std::move(values)) : std::nullopt;
}

ReplyPattern ReplyForm::pattern() const {
  ReplyPattern pattern;
  pattern.alternatives.emplace_back();
  for (const Part& part : parts_) {
    std::vector<std::vector<ReplyPart>> longer;
    for (const std::vector<ReplyPart>& so_far : pattern.alternatives) {
      for (const std::vector<ReplyPart>& more : alternatives_of(part)) {
        longer.push_back(so_far);
        longer.back().insert(longer.back().end(), more.begin(), more.end());
      }
    }
    pattern.alternatives = std::move(longer);
  }
  return pattern;
}

std::string ReplyForm::reply(const FieldValues& values) const {
  std::string out;
  for (const Part& part : parts_) {
    const auto value = part.field.empty() ? values.end() : values.find(part.field);
    if (value != values.end() && is_one(part, value->second)) {
      out += value->second;
      continue;
    }
    switch (part.kind) {
      case Part::Kind::kLiteral:
        out += part.text;
        break;
      case Part::Kind::kBlanks:
        out += ' ';
        break;
      case Part::Kind::kNumber:
      case Part::Kind::kBelow:
        out += '0';
        break;
      case Part::Kind::kNotBelow:
        out += part.text;
        break;
      case Part::Kind::kRange:
        out += std::to_string(part.least);
        break;
      case Part::Kind::kDigits:
        out += std::string(std::max(part.least, 1U) - 1, '0') + "1";
        break;
      case Part::Kind::kHex:
        out += fmt::format("{:0{}X}", part.bits == Part::Bits::kSomeSet ? part.mask : 0U,
                           part.least == 0 ? 1U : part.least);
        break;
      case Part::Kind::kWord:
        out += "--";
        break;
      case Part::Kind::kText:
        out += "0";
        break;
      case Part::Kind::kOneOf:
        out += part.choices.front();
        break;
      case Part::Kind::kBits:
        out += std::to_string(part.bits == Part::Bits::kSomeSet ? part.mask : 0U);
        break;
      case Part::Kind::kBefore:
        for (std::uint32_t n = 0; n < part.least; ++n) out += "0" + part.text;
        break;
      case Part::Kind::kAfter:
        break;
    }
  }
  return out;
}

namespace {

/// A search for a reply that two automata accept: a state of each at a time, breadth first.
class CommonReply {
 public:
  CommonReply(const ReplyPattern& one, const ReplyPattern& other)
      : a_(automaton_of(one)), b_(automaton_of(other)) {}

  std::optional<std::string> find() {
    add({});
    while (!open_.empty()) {
      const Place at = std::move(open_.front());
      open_.pop_front();
      if (a_.last[at.a] && b_.last[at.b]) return at.so_far;
      go_on_free(at);
      end_numbers(at);
      if (at.so_far.size() < kLongestHaltReply) read_a_byte(at);
    }
    return std::nullopt;
  }

 private:
  /// Where both are in numbers under a mask: whether these began at the same byte.
  enum class Numbers : std::uint8_t {
    kApart,
    kTogether,  ///< They did.
    kOneEnded,  ///< They did, and one has ended: the other goes on, as else both would end together.
  };
  struct Place {
    std::size_t a = 0, b = 0;
    Numbers numbers = Numbers::kApart;
    std::string so_far{};
    std::size_t begin = 0;  ///< Where the numbers that began together do so.
  };

  void add(Place place) {
    if (seen_.insert({place.a, place.b, place.numbers}).second) open_.push_back(std::move(place));
  }

  void go_on_free(const Place& at) {
    for (const std::size_t to : a_.free[at.a]) add({to, at.b, at.numbers, at.so_far, at.begin});
    for (const std::size_t to : b_.free[at.b]) add({at.a, to, at.numbers, at.so_far, at.begin});
  }

  void end_numbers(const Place& at) {
    if (at.numbers == Numbers::kOneEnded) return;
    const bool together = at.numbers == Numbers::kTogether;
    const auto &one = a_.exits[at.a], &other = b_.exits[at.b];
    const Numbers then = together ? Numbers::kOneEnded : Numbers::kApart;
    if (one) add({one->to, at.b, then, at.so_far, at.begin});
    if (other) add({at.a, other->to, then, at.so_far, at.begin});
    if (!together || !one || !other) return;
    if (const auto number = common_bits(one->bits, other->bits))
      add({one->to, other->to, Numbers::kApart, at.so_far.substr(0, at.begin) + std::to_string(*number), 0});
  }

  void read_a_byte(const Place& at) {
    for (const Automaton::Arc& one : a_.arcs[at.a]) {
      for (const Automaton::Arc& other : b_.arcs[at.b]) {
        const Automaton::Bytes both = one.bytes & other.bytes;
        unsigned char byte = 0x20;
        while (byte < 0x7F && !both.test(byte)) ++byte;
        if (byte == 0x7F) continue;
        Place to{one.to, other.to, Numbers::kApart, at.so_far + static_cast<char>(byte), at.begin};
        if (a_.in_bits[one.to] && b_.in_bits[other.to]) {
          const bool begins = !a_.in_bits[at.a] && !b_.in_bits[at.b];
          if (begins) to.begin = at.so_far.size();
          if (begins || at.numbers == Numbers::kTogether) to.numbers = Numbers::kTogether;
        }
        add(std::move(to));
      }
    }
  }

  const Automaton a_, b_;
  std::deque<Place> open_;
  std::set<std::tuple<std::size_t, std::size_t, Numbers>> seen_;
};

}  // namespace

std::optional<std::string> common_reply(const ReplyPattern& one, const ReplyPattern& other) {
  return CommonReply(one, other).find();
}

CommandForm::CommandForm(std::string text) : text_(std::move(text)) {
  const auto add = [&](std::string_view field) {
    const std::size_t colon = field.find(':');
    const std::string_view name = field.substr(0, colon);
    if (colon == std::string_view::npos && (name == "axis" || name == "address")) {
      parts_.push_back({.field = std::string(name)});
      return;
    }
    const std::string_view spec =
        colon == std::string_view::npos ? std::string_view() : field.substr(colon + 1);
    const bool is_number = name == "angle" || name == "angles" || name == "increment" || name == "speed";
    if (!is_number)
      refuse_field(field, "{axis}, {address}, {angle:.4f}, {angles:.4f}, {increment:.4f} or {speed:.3f}");
    const auto decimals = spec.size() == 3 && spec[0] == '.' && spec[2] == 'f'
                              ? pieces::number<int>(spec.substr(1, 1))
                              : std::nullopt;
    if (!decimals) refuse_field(field, fmt::format("the decimals that are sent, as {{{}:.4f}}", name));
    parts_.push_back({.field = std::string(name), .decimals = *decimals});
  };
  read_form(
      text_,
      [&](char c) {
        if (parts_.empty() || !parts_.back().field.empty()) parts_.emplace_back();
        parts_.back().text += c;
      },
      add);
}

bool CommandForm::has(std::string_view field) const {
  return std::any_of(parts_.begin(), parts_.end(), [&](const Part& part) { return part.field == field; });
}

double CommandForm::half_place(std::string_view field) const {
  for (const Part& part : parts_)
    if (part.field == field) return 0.5 * std::pow(10.0, -part.decimals);
  return 0.0;
}

std::string CommandForm::with(const FieldValues& texts,
                              const std::map<std::string, double, std::less<>>& numbers) const {
  std::string out;
  for (const Part& part : parts_) {
    if (part.field.empty()) {
      out += part.text;
    } else if (const auto text = texts.find(part.field); text != texts.end()) {
      out += text->second;
    } else if (part.field == "angles") {
      for (int n = 1; numbers.contains(fmt::format("angle{}", n)); ++n)
        out += (n > 1 ? " " : "") + written(numbers.at(fmt::format("angle{}", n)), part.decimals);
    } else if (const auto number = numbers.find(part.field); number != numbers.end()) {
      out += written(number->second, part.decimals);
    }
  }
  return out;
}

std::optional<FieldValues> CommandForm::match(
    std::string_view command, const std::map<std::string, std::vector<std::string>>& texts) const {
  FieldValues values;
  const auto rest_of = [&](const auto& self, std::size_t at, std::string_view rest) -> bool {
    if (at == parts_.size()) return rest.empty();
    const Part& part = parts_[at];
    if (part.field.empty())
      return rest.starts_with(part.text) && self(self, at + 1, rest.substr(part.text.size()));
    if (const auto known = texts.find(part.field); known != texts.end()) {
      for (const std::string& text : known->second) {
        if (!rest.starts_with(text) || !self(self, at + 1, rest.substr(text.size()))) continue;
        values.insert_or_assign(part.field, text);
        return true;
      }
      return false;
    }
    for (std::size_t length = rest.size(); length > 0; --length) {
      const std::string_view found = rest.substr(0, length);
      const bool is_number = part.field == "angles"
                                 ? std::ranges::all_of(pieces::words(found), is_decimal_number)
                                 : is_decimal_number(found);
      if (!is_number || found.ends_with(' ') || !self(self, at + 1, rest.substr(length))) continue;
      values.insert_or_assign(part.field, std::string(rest.substr(0, length)));
      return true;
    }
    return false;
  };
  return rest_of(rest_of, 0, command) ? std::optional(std::move(values)) : std::nullopt;
}

std::vector<std::string> StageDescription::stops(const std::array<std::string, 2>& names,
                                                 const std::string& address_of_stage) const {
  const CommandForm form(halt);
  FieldValues texts{{"address", address_of_stage.empty() ? address : address_of_stage}};
  if (!form.has("axis")) return {form.with(texts, {})};
  std::vector<std::string> all;
  for (const std::string& name : names) {
    if (name.empty()) continue;
    texts["axis"] = name;
    all.push_back(form.with(texts, {}));
  }
  return all;
}

StageDescription StageDescription::for_axis(const std::string& name) const {
  const auto named = std::find(axis_names.begin(), axis_names.end(), name);
  const std::size_t place =
      named == axis_names.end() ? 1 : static_cast<std::size_t>(named - axis_names.begin()) + 1;
  StageDescription one = *this;
  for (auto* exchanges : {&one.travel, &one.scale})
    for (DescribedExchange& each : *exchanges) each.expect = each.expect.at(place);
  one.position.expect = one.position.expect.at(place);
  one.moving = one.moving.at(place);
  one.stopped = one.stopped.at(place);
  if (one.speed) one.speed->expect = one.speed->expect.at(place);
  for (DescribedFault& fault : one.status_faults) fault.expect = fault.expect.at(place);
  for (auto* forms : {&one.is_referenced, &one.is_not_referenced})
    for (ReplyForm& form : *forms) form = form.at(place);
  return one;
}

bool StageDescription::accepts_model(std::string_view model) const {
  return std::any_of(models.begin(), models.end(),
                     [&](const std::string& glob) { return matches_glob(glob, model); });
}

}  // namespace abcal
