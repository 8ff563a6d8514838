#include "drivers/instrument/stage_description.h"

#include <fmt/format.h>

#include <algorithm>
#include <bitset>
#include <cmath>
#include <deque>
#include <set>
#include <stdexcept>
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

std::optional<std::uint32_t> hex_number(std::string_view text) {
  return text.empty() ? std::nullopt : pieces::number<std::uint32_t>(text, 16);
}

[[noreturn]] void refuse_field(std::string_view field, std::string_view required) {
  throw std::invalid_argument(fmt::format("the field {{{}}}; required: {}", field, required));
}

constexpr const char* kReplyFields =
    "{angle}, {speed}, {lower}, {upper} or {units_per_turn} for a number, {model}, {serial}, {firmware}, "
    "{maker} or {text} for a text, {word}, {number}, {digits}, {digits2}, {0..39}, {hex}, {hex4}, {hex4 none "
    "0002}, {hex4 some 0002}";

/// A word in braces with a number behind it: "digits2".
std::optional<std::uint32_t> count_behind(std::string_view field, std::string_view word) {
  if (!field.starts_with(word)) return std::nullopt;
  field.remove_prefix(word.size());
  return field.empty() ? 0U : pieces::number<std::uint32_t>(field);
}

Part reply_part(std::string_view field) {
  if (is_one_of(field, number_fields())) return {.kind = Part::Kind::kNumber, .field = std::string(field)};
  if (is_one_of(field, text_fields())) return {.kind = Part::Kind::kText, .field = std::string(field)};
  if (field == "word") return {.kind = Part::Kind::kWord};
  if (field == "number") return {.kind = Part::Kind::kNumber};
  if (const auto digits = count_behind(field, "digits"); digits && *digits <= 20)
    return {.kind = Part::Kind::kDigits, .least = *digits};
  const std::vector<std::string_view> words = pieces::words(field);
  if (!words.empty()) {
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

bool fits_bits(const Part& part, std::string_view digits) {
  const auto value = hex_number(digits);
  if (!value) return false;
  if (part.bits == Part::Bits::kNoneSet) return (*value & part.mask) == 0;
  return part.bits == Part::Bits::kFree || (*value & part.mask) != 0;
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

/// The part as parts of a ReplyPattern: one sequence or several.
std::vector<std::vector<ReplyPart>> alternatives_of(const Part& part) {
  switch (part.kind) {
    case Part::Kind::kLiteral:
      return {{pattern::literal(part.text)}};
    case Part::Kind::kBlanks:
      return {{pattern::run(" ")}};
    case Part::Kind::kNumber:
      return {{pattern::run(kNumberBytes)}};
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
  }
  return {};
}

/// An automaton of a pattern: states with the bytes that lead on. A number of a range is taken for digits.
struct Automaton {
  using Bytes = std::bitset<256>;
  struct Arc {
    Bytes bytes;
    std::size_t to = 0;
  };
  std::vector<std::vector<Arc>> arcs;
  std::vector<std::vector<std::size_t>> free;  ///< Without a byte.
  std::vector<bool> last;

  std::size_t add_state() {
    arcs.emplace_back();
    free.emplace_back();
    last.push_back(false);
    return arcs.size() - 1;
  }

  std::set<std::size_t> closed(std::set<std::size_t> states) const {
    std::vector<std::size_t> open(states.begin(), states.end());
    while (!open.empty()) {
      const std::size_t state = open.back();
      open.pop_back();
      for (const std::size_t to : free[state])
        if (states.insert(to).second) open.push_back(to);
    }
    return states;
  }
  std::set<std::size_t> after(const std::set<std::size_t>& states, unsigned char byte) const {
    std::set<std::size_t> to;
    for (const std::size_t state : states)
      for (const Arc& arc : arcs[state])
        if (arc.bytes.test(byte)) to.insert(arc.to);
    return closed(std::move(to));
  }
  bool accepts(const std::set<std::size_t>& states) const {
    return std::any_of(states.begin(), states.end(), [&](std::size_t state) { return last[state]; });
  }
};

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
  for (std::size_t k = 1; k < parts_.size(); ++k) {
    const auto is_open = [](const Part& part) {
      return part.kind == Part::Kind::kText || part.kind == Part::Kind::kWord ||
             part.kind == Part::Kind::kNumber;
    };
    if (is_open(parts_[k - 1]) && is_open(parts_[k]))
      throw std::invalid_argument(
          "two fields with nothing between them, so that nobody knows where one ends; "
          "required: a blank or text between them");
  }
}

bool ReplyForm::has(std::string_view field) const {
  return std::any_of(parts_.begin(), parts_.end(), [&](const Part& part) { return part.field == field; });
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
    if (value != values.end()) {
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
        out += '0';
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
    }
  }
  return out;
}

std::optional<std::string> common_reply(const ReplyPattern& one, const ReplyPattern& other) {
  const Automaton a = automaton_of(one), b = automaton_of(other);
  using States = std::pair<std::set<std::size_t>, std::set<std::size_t>>;
  std::deque<std::pair<States, std::string>> open{{{a.closed({0}), b.closed({0})}, ""}};
  std::set<States> seen{open.front().first};
  while (!open.empty()) {
    const auto [states, so_far] = std::move(open.front());
    open.pop_front();
    if (a.accepts(states.first) && b.accepts(states.second)) return so_far;
    if (so_far.size() >= kLongestHaltReply) continue;
    for (unsigned char byte = 0x20; byte < 0x7F; ++byte) {
      States next{a.after(states.first, byte), b.after(states.second, byte)};
      if (next.first.empty() || next.second.empty() || !seen.insert(next).second) continue;
      open.emplace_back(std::move(next), so_far + static_cast<char>(byte));
    }
  }
  return std::nullopt;
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
    const bool is_number = name == "angle" || name == "increment" || name == "speed";
    if (!is_number) refuse_field(field, "{axis}, {address}, {angle:.4f}, {increment:.4f} or {speed:.3f}");
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
    } else if (const auto number = numbers.find(part.field); number != numbers.end()) {
      const std::string written = fmt::format("{:.{}f}", number->second, part.decimals);
      const bool is_zero = written.find_first_not_of("-0.") == std::string::npos;
      out += is_zero && written.starts_with('-') ? written.substr(1) : written;
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
      if (!is_decimal_number(rest.substr(0, length)) || !self(self, at + 1, rest.substr(length))) continue;
      values.insert_or_assign(part.field, std::string(rest.substr(0, length)));
      return true;
    }
    return false;
  };
  return rest_of(rest_of, 0, command) ? std::optional(std::move(values)) : std::nullopt;
}

std::string StageDescription::stop_bytes(const std::array<std::string, 2>& names,
                                         const std::string& address_of_stage) const {
  const CommandForm form(halt);
  FieldValues texts{{"address", address_of_stage.empty() ? address : address_of_stage}};
  if (!form.has("axis")) return form.with(texts, {});
  std::string all;
  for (const std::string& name : names) {
    if (name.empty()) continue;
    texts["axis"] = name;
    all += form.with(texts, {});
  }
  return all;
}

bool StageDescription::accepts_model(std::string_view model) const {
  return std::any_of(models.begin(), models.end(),
                     [&](const std::string& glob) { return matches_glob(glob, model); });
}

}  // namespace abcal
