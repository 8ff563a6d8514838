#include "app/system/text_layout.h"

#include <algorithm>
#include <clocale>
#include <cwchar>
#include <memory>
#include <type_traits>

namespace abcal {
namespace {

struct FreeLocale {
  void operator()(std::remove_pointer_t<locale_t>* locale) const { freelocale(locale); }
};

/// The characters of UTF-8, independent of the user's locale, on which widths must not depend.
locale_t utf8() {
  static const std::unique_ptr<std::remove_pointer_t<locale_t>, FreeLocale> kLocale(
      newlocale(LC_CTYPE_MASK, "C.UTF-8", nullptr));
  return kLocale.get();
}

/// The first character of a text.
struct Character {
  std::size_t bytes = 1;
  std::size_t columns = 1;
};

/// Bytes that are not UTF-8 count as one column each. The locale of the thread must be utf8().
Character first_character(std::string_view text) {
  std::mbstate_t state{};
  wchar_t wide = 0;
  const std::size_t bytes = std::mbrtowc(&wide, text.data(), text.size(), &state);
  if (bytes == 0 || bytes > text.size()) return {};
  const int columns = wcwidth(wide);
  return {bytes, columns < 0 ? 1 : static_cast<std::size_t>(columns)};
}

/// Makes utf8() the locale of this thread for as long as it lives.
class Utf8Scope {
 public:
  Utf8Scope() : before_(utf8() == nullptr ? nullptr : uselocale(utf8())) {}
  ~Utf8Scope() {
    if (before_ != nullptr) uselocale(before_);
  }
  Utf8Scope(const Utf8Scope&) = delete;
  Utf8Scope& operator=(const Utf8Scope&) = delete;

 private:
  locale_t before_;
};

/// Bytes of the longest beginning of a word that fits into `width`, at least one character.
std::size_t fitting_bytes(std::string_view word, std::size_t width) {
  const Utf8Scope scope;
  std::size_t bytes = 0, columns = 0;
  while (bytes < word.size()) {
    const Character next = first_character(word.substr(bytes));
    if (bytes > 0 && columns + next.columns > width) break;
    bytes += next.bytes;
    columns += next.columns;
  }
  return bytes;
}

}  // namespace

std::size_t display_width(std::string_view text) {
  const Utf8Scope scope;
  std::size_t columns = 0;
  while (!text.empty()) {
    const Character next = first_character(text);
    columns += next.columns;
    text.remove_prefix(next.bytes);
  }
  return columns;
}

std::string padded(std::string_view text, std::size_t width, bool to_the_right) {
  const std::size_t columns = display_width(text);
  const std::string blank(width > columns ? width - columns : 0, ' ');
  return to_the_right ? blank + std::string(text) : std::string(text) + blank;
}

std::vector<std::string> lines_of(std::string_view text, std::size_t width, LongWords long_words) {
  std::vector<std::string> lines(1);
  std::size_t columns = 0;  // of the last line
  while (!text.empty()) {
    const std::size_t end = std::min(text.find(' '), text.size());
    std::string_view word = text.substr(0, end);
    std::size_t of_word = display_width(word);
    if (!lines.back().empty() && columns + 1 + of_word > width) {
      lines.emplace_back();
      columns = 0;
    }
    while (long_words == LongWords::kBreak && of_word > width) {
      const std::size_t bytes = fitting_bytes(word, width);
      lines.back() = word.substr(0, bytes);
      lines.emplace_back();
      word.remove_prefix(bytes);
      of_word = display_width(word);
    }
    if (!lines.back().empty()) {
      lines.back() += ' ';
      ++columns;
    }
    lines.back() += word;
    columns += of_word;
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

std::string wrapped(std::string_view text, const std::string& first, const std::string& next,
                    std::size_t width, LongWords long_words) {
  std::string out;
  for (const std::string& line : lines_of(text, width - display_width(next), long_words))
    out += (out.empty() ? first : next) + line + "\n";
  return out;
}

}  // namespace abcal
