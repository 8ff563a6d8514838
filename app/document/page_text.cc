#include "app/document/page_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstring>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "app/document/number_text.h"

namespace abcal {
namespace {

std::string with_signs(std::string_view text) {
  std::string result(text);
  for (const auto& [word, sign] :
       {std::pair{"phi", "φ"}, {"degree", "°"}, {"m/s2", "m/s²"}, {"g2", "g²"}, {"^2", "²"}, {"^3", "³"}}) {
    if (const std::size_t at = result.find(word); at != std::string::npos)
      result.replace(at, std::strlen(word), sign);
  }
  return result;
}

}  // namespace

std::vector<TextRun> cell_runs(const std::string& text, CellKind kind) {
  if (kind == CellKind::kNumber) return {{typeset_numbers(text)}};
  if (kind == CellKind::kText) return {{text}};
  std::vector<TextRun> runs;
  std::string_view rest = text;
  while (!rest.empty()) {
    const std::size_t at = std::min(rest.find('_'), rest.size());
    runs.push_back({with_signs(rest.substr(0, at))});
    rest.remove_prefix(std::min(at + 1, rest.size()));
    if (rest.empty()) break;
    const auto end =
        std::find_if(rest.begin(), rest.end(), [](unsigned char c) { return std::isalnum(c) == 0; });
    const auto length = static_cast<std::size_t>(end - rest.begin());
    runs.push_back({with_signs(rest.substr(0, length)), true});
    rest.remove_prefix(length);
  }
  return runs;
}

CellKind heading_kind(const Column& column) {
  const bool is_symbol =
      column.heading.find('_') != std::string::npos && column.heading.find(' ') == std::string::npos;
  return is_symbol ? CellKind::kSymbol : CellKind::kText;
}

std::string caption_text(const DocumentTable& table) {
  return table.caption_kind == CellKind::kText ? typeset_numbers(table.caption) : table.caption;
}

bool has_long_word(const std::string& text) {
  constexpr std::size_t kLong = 24;
  std::size_t length = 0;
  for (const char c : text) {
    length = c == ' ' ? 0 : length + 1;
    if (length > kLong) return true;
  }
  return false;
}

std::string margin_cautions(const Document& document) {
  // The text before the colon of each caution: "Not complete".
  std::string cautions = document.page_mark;
  for (const std::string& caution : document.cautions) {
    const std::string word = caution.substr(0, caution.find(':'));
    if (word != document.page_mark) cautions += (cautions.empty() ? "" : " · ") + word;
  }
  std::transform(cautions.begin(), cautions.end(), cautions.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return cautions;
}

bool stays_whole(const DocumentTable& table) {
  constexpr std::size_t kFitsOnAPage = 30;
  return !table.may_break && table.rows.size() <= kFitsOnAPage;
}

void require_columns(const DocumentTable& table, const std::vector<std::string>& row) {
  if (row.size() > table.columns.size())
    throw std::logic_error(fmt::format("a row of {} cells, \"{}\", stands below a heading of {}", row.size(),
                                       row.front(), table.columns.size()));
}

}  // namespace abcal
