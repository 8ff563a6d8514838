// Fuzz target of the lines of described stages: forms of replies agree with the patterns that a guard has,
// and the filter of lines loses and adds no byte in whatever pieces the bytes arrive.

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "drivers/described/codec.h"
#include "drivers/wire/reply_match.h"

namespace {

const std::array<abcal::ReplyForm, 14>& forms() {
  static const std::array<abcal::ReplyForm, 14> all{
      abcal::ReplyForm("+ {model} sn={serial} fw={firmware}"),
      abcal::ReplyForm("+ {hex4 some 0102}"),
      abcal::ReplyForm("+ {hex none 0010}"),
      abcal::ReplyForm("- {digits2} {text}"),
      abcal::ReplyForm("@{digits2} {1..9} OK {word} F{word} 0"),
      abcal::ReplyForm("{0..39},{digits}"),
      abcal::ReplyForm("! {text}"),
      abcal::ReplyForm("{{{word}}}"),
      abcal::ReplyForm("{0..39}TS{hex4}{one of 28 33 3C}"),
      abcal::ReplyForm("{decimal some bits 0 3 31}"),
      abcal::ReplyForm("+ {decimal none bits 1} {serial:digits}"),
      abcal::ReplyForm("{before}{one of T V}{after}").at(2),
      abcal::ReplyForm("{before ,}{one of 0 1}{after ,}").at(3),
      abcal::ReplyForm("{before blank}{digits}{after blank}").at(2)};
  return all;
}

void check_forms(std::string_view line) {
  bool is_printable = true;
  for (const char c : line) is_printable = is_printable && c >= 0x20 && c < 0x7F;
  if (!is_printable) return;
  for (const abcal::ReplyForm& form : forms())
    if (form.match(line).has_value() != abcal::wire::matches(form.pattern(), line)) __builtin_trap();
  // Numbers: the guard's pattern accepts more, never less.
  static const abcal::ReplyForm number("@{digits2} {1..9} OK {word} {word} {angle}");
  if (number.match(line) && !abcal::wire::matches(number.pattern(), line)) __builtin_trap();
}

std::string filtered(std::string_view bytes, std::size_t piece) {
  static const abcal::StageDescription description = [] {
    abcal::StageDescription one;
    one.echoes = true;
    one.ignored = {forms()[6]};
    return one;
  }();
  abcal::described::LineFilter filter(description);
  filter.sent("GO O 12.5\r");
  std::string out;
  for (std::size_t at = 0; at < bytes.size(); at += piece) out += filter.pass(bytes.substr(at, piece));
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  std::string_view rest = bytes;
  while (!rest.empty()) {
    const auto verdict = abcal::described::check_line(rest);
    if (verdict.length > rest.size()) __builtin_trap();
    if (verdict.check != abcal::wire::FrameCheck::kComplete) break;
    check_forms(abcal::described::normal_line(rest.substr(0, verdict.length)));
    rest.remove_prefix(verdict.length);
  }
  const std::string whole = filtered(bytes, size + 1);
  if (whole.size() > size || whole != filtered(bytes, 1) || whole != filtered(bytes, 7)) __builtin_trap();
  return 0;
}
