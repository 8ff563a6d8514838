#include "tests/app/tutorial_page.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <regex>
#include <sstream>
#include <string_view>

namespace abcal::test {
namespace {

constexpr std::string_view kGap = "...";
constexpr std::string_view kPrompt = "$ ";

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

bool is_command(const std::string& line) {
  static const std::regex command("(abcal|cp|export|mkdir|sed|unset) .*");
  return std::regex_match(line, command);
}

std::vector<std::string> words_of(const std::string& text) {
  std::vector<std::string> words;
  std::istringstream stream(text);
  for (std::string word; stream >> word;) words.push_back(word);
  return words;
}

/// The words of a block of a page; "..." is a word of its own, and stays at a word that it cuts off.
std::vector<std::string> page_words(const std::string& block) {
  std::vector<std::string> words;
  for (const std::string& line : lines_of(block)) {
    for (std::string& word : words_of(line)) words.push_back(std::move(word));
    if (line.ends_with(kGap) && words.back() != kGap) words.emplace_back(kGap);
  }
  return words;
}

std::string without_punctuation(const std::string& word) {
  const std::size_t end = word.find_last_not_of(",;:.)");
  const std::size_t begin = word.find_first_not_of('(');
  return end == std::string::npos || begin > end ? word : word.substr(begin, end + 1 - begin);
}

std::optional<double> number_of(const std::string& word) {
  const std::string text = without_punctuation(word);
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  if (text.empty() || end != text.c_str() + text.size()) return std::nullopt;
  return value;
}

/// Words that stand for a class of words: a date, a year within a number, a hash.
std::string of_its_kind(const std::string& word) {
  static const std::array<std::pair<std::regex, const char*>, 3> kinds{
      {{std::regex("[0-9]{4}-[0-9]{2}-[0-9]{2}"), "DATE"},
       {std::regex("T-[0-9]{4}-"), "T-YEAR-"},
       {std::regex("[0-9a-f]{64}"), "SHA-256"}}};
  std::string text = word;
  for (const auto& [pattern, kind] : kinds) text = std::regex_replace(text, pattern, kind);
  return text;
}

/// Compares words of a page with words of an output.
class WordComparison {
 public:
  WordComparison(std::vector<std::string> page, std::vector<std::string> shown, Figures figures)
      : page_(std::move(page)), shown_(std::move(shown)), figures_(figures) {}

  std::string difference() {
    std::size_t at = 0, next = 0;
    bool anywhere = false;
    while (next < page_.size()) {
      if (page_[next] == kGap) {
        anywhere = true;
        ++next;
        continue;
      }
      const std::size_t end = static_cast<std::size_t>(
          std::find(page_.begin() + static_cast<std::ptrdiff_t>(next), page_.end(), kGap) - page_.begin());
      const bool to_the_end = end == page_.size();
      const auto found = find(next, end, at, anywhere, to_the_end);
      if (!found && closest_ == end) return left_out(closest_shown_);
      if (!found)
        return "not in the output: \"" + sentence(page_, closest_, end) + "\", after \"" +
               sentence(page_, next, closest_) + "\"; the output goes on with \"" +
               sentence(shown_, closest_shown_, closest_shown_ + 20) + "\"";
      at = *found;
      next = end;
      anywhere = false;
    }
    if (!anywhere && at != shown_.size()) return left_out(at);
    return {};
  }

 private:
  std::string left_out(std::size_t from) const {
    return "the page leaves out \"" + sentence(shown_, from, from + 20) + "\" and does not say so by \"...\"";
  }

  /// The place behind the words [first, last) of the page in the output.
  std::optional<std::size_t> find(std::size_t first, std::size_t last, std::size_t from, bool anywhere,
                                  bool to_the_end) {
    const std::size_t count = last - first;
    closest_ = first;
    closest_shown_ = from;
    for (std::size_t at = from; at + count <= shown_.size(); ++at) {
      std::size_t same = 0;
      while (same < count && agrees(first + same, at + same)) ++same;
      if (first + same > closest_) {
        closest_ = first + same;
        closest_shown_ = at + same;
      }
      if (same == count && (!to_the_end || at + count == shown_.size())) return at + count;
      if (!anywhere) break;
    }
    return std::nullopt;
  }

  bool agrees(std::size_t page, std::size_t shown) const {
    const std::string &stated = page_[page], &found = shown_[shown];
    if (stated == found || of_its_kind(stated) == of_its_kind(found)) return true;
    if (stated.ends_with(kGap)) return found.starts_with(stated.substr(0, stated.size() - kGap.size()));
    const auto stated_number = number_of(stated), found_number = number_of(found);
    if (!stated_number || !found_number) return false;
    if (figures_ == Figures::kAny) return true;
    if (word(page, -1) == "+-") {
      constexpr double kLargestRatio = 1.5;
      const double ratio = *found_number / *stated_number;
      return ratio < kLargestRatio && ratio > 1.0 / kLargestRatio;
    }
    if (word(page, 1) == "+-") {
      const auto u = number_of(word(page, 2));
      return u && std::abs(*found_number - *stated_number) <= *u;
    }
    const std::string before = word(page, -1), pair = word(page, -2) + " " + before;
    return before == "chi2" || pair == "P =" || pair == "|E_n| is";
  }

  std::string word(std::size_t at, int further) const {
    const auto place = static_cast<std::ptrdiff_t>(at) + further;
    return place < 0 || place >= static_cast<std::ptrdiff_t>(page_.size())
               ? std::string()
               : page_[static_cast<std::size_t>(place)];
  }
  static std::string sentence(const std::vector<std::string>& words, std::size_t from, std::size_t to) {
    std::string text;
    for (std::size_t i = from; i < std::min(to, words.size()); ++i)
      text += (text.empty() ? "" : " ") + words[i];
    return text;
  }

  std::vector<std::string> page_, shown_;
  Figures figures_;
  std::size_t closest_ = 0, closest_shown_ = 0;  ///< How far the words of a page were found.
};

}  // namespace

std::vector<PageStep> steps_of_page(const std::string& page) {
  std::vector<PageStep> steps;
  std::string prose;
  const std::vector<std::string> lines = lines_of(page);
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (lines[i] == "## Your own instruments" || lines[i] == "## Where to go from here") break;
    if (lines[i].starts_with("<!--")) continue;
    if (lines[i] != "```" && lines[i] != "```text") {
      prose += lines[i] + "\n";
      if (!steps.empty() && !lines[i].starts_with('#')) steps.back().prose_after += lines[i] + "\n";
      continue;
    }
    std::vector<std::string> block;
    while (++i < lines.size() && lines[i] != "```") block.push_back(lines[i]);
    if (!block.empty() && block.front().starts_with(kPrompt)) {
      steps.push_back({std::move(prose), {}, {}, {}});
      for (const std::string& line : block) {
        if (line.starts_with(kPrompt)) {
          steps.back().commands.push_back(line.substr(kPrompt.size()));
        } else {
          steps.back().output += line + "\n";
        }
      }
    } else if (std::all_of(block.begin(), block.end(), is_command)) {
      steps.push_back({std::move(prose), std::move(block), {}, {}});
    } else if (!steps.empty()) {
      for (const std::string& line : block) steps.back().output += line + "\n";
    }
    prose.clear();
  }
  return steps;
}

std::string difference_from_page(const std::string& page, const std::string& output, Figures figures) {
  return WordComparison(page_words(page), words_of(output), figures).difference();
}

std::string as_shown(const std::string& written) {
  static const std::regex colours("\x1b\\[[0-9;?]*[a-ln-zA-JL-Z]|\x1b\\[[0-9;]*m");
  const std::string text = std::regex_replace(written, colours, "");
  std::string shown, line;
  std::size_t column = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '\n') {
      shown += line + "\n";
      line.clear();
      column = 0;
    } else if (text[i] == '\r') {
      column = 0;
    } else if (text.compare(i, 3, "\x1b[K") == 0) {
      line.resize(std::min(line.size(), column));
      i += 2;
    } else {
      line.resize(std::max(line.size(), column + 1), ' ');
      line[column++] = text[i];
    }
  }
  return shown + line;
}

}  // namespace abcal::test
