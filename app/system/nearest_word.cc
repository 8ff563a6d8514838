#include "app/system/nearest_word.h"

#include <algorithm>
#include <cstddef>

namespace abcal {
namespace {

char lower(char c) {
  return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, diagonal + (a[i - 1] == b[j - 1] ? 0 : 1)});
      diagonal = above;
    }
  }
  return row[b.size()];
}

}  // namespace

std::string nearest_word(std::string_view written, const std::vector<std::string>& words) {
  // The beginning of one word, such as a maker for its driver.
  const auto begins = [&](const std::string& word) {
    return written.size() > 1 && word.size() > written.size() &&
           std::ranges::equal(written, std::string_view(word).substr(0, written.size()), {}, lower, lower);
  };
  if (std::ranges::count_if(words, begins) == 1) return *std::ranges::find_if(words, begins);
  const auto distance = [&](const std::string& word) { return edit_distance(written, word); };
  const auto nearest = std::ranges::min_element(words, {}, distance);
  const bool is_near = nearest != words.end() && distance(*nearest) <= 2 + written.size() / 5 &&
                       distance(*nearest) < written.size();
  return is_near ? *nearest : std::string();
}

}  // namespace abcal
