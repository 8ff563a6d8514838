#include "protocol/record/table_reader.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "protocol/record/labelled_line.h"

namespace abcal {
namespace {

using pieces::trimmed;

constexpr std::size_t kMostProblemsShown = 50;
constexpr std::size_t kMostComments = 10'000;
constexpr std::size_t kMostLinesOfRow = 100;
constexpr std::size_t kMostLinesBefore = 200, kMostBytesBefore = 64 << 10;
constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

/// "0,5 1,2 -3e1": numbers with decimal commas between blanks.
bool are_numbers_with_commas(std::string_view text) {
  const std::vector<std::string_view> words = pieces::words(text);
  return words.size() > 1 && std::ranges::all_of(words, [](std::string_view word) {
           std::string number(pieces::without_plus(word));
           std::ranges::replace(number, ',', '.');
           return !word.ends_with(',') && pieces::number<double>(number).has_value();
         });
}

/// Whether a line is neither blank nor a comment.
bool has_cells(std::string_view line) {
  const std::string_view whole = trimmed(line);
  return !whole.empty() && whole.front() != '#';
}

char separator_of(std::string_view text) {
  if (text.find(';') != std::string_view::npos) return ';';
  if (text.find('\t') != std::string_view::npos) return '\t';
  return text.find(',') != std::string_view::npos && !are_numbers_with_commas(text) ? ',' : ' ';
}

std::string all_problems(const std::string& source, const std::vector<Problem>& problems, std::size_t count) {
  std::string text;
  for (const Problem& problem : problems)
    text += fmt::format("{}{}: {}", text.empty() ? "" : "\n", source, to_string(problem));
  if (count > problems.size())
    text += fmt::format("\n{}: and {} problems more", source, count - problems.size());
  return text;
}

}  // namespace

TableError::TableError(const std::string& source, std::vector<Problem> problems, std::size_t count)
    : std::runtime_error(all_problems(source, problems, count)), problems_(std::move(problems)) {}

void TableProblems::add(std::string where, std::string found, std::string required) {
  if (++count_ <= kMostProblemsShown)
    kept_.push_back({std::move(where), std::move(found), std::move(required)});
}

void TableProblems::fail() const {
  throw TableError(source_, kept_, count_);
}

std::string as_quoted(std::string_view text) {
  constexpr std::size_t kLongest = 40;
  std::string shown;
  for (const char c : text.substr(0, kLongest)) {
    const auto byte = static_cast<unsigned char>(c);
    shown += byte < 0x20 || byte == 0x7F ? '?' : c;
  }
  return text.size() > kLongest ? fmt::format("\"{}...\"", shown) : fmt::format("\"{}\"", shown);
}

TableReader::TableReader(std::istream& input, TableProblems& problems) : input_(input), problems_(problems) {}

void TableReader::refuse(std::string found, std::string required) {
  problems_.add(fmt::format("line {}", line_), std::move(found), std::move(required));
  problems_.fail();
}

bool TableReader::read_line(std::string& text) {
  if (kept_.empty()) {
    if (!read_new_line(text)) return false;
    line_ = lines_read_;
    return true;
  }
  line_ = kept_.front().number;
  text += kept_.front().text;
  kept_.pop_front();
  return true;
}

bool TableReader::read_new_line(std::string& text) {
  constexpr int kEnd = std::char_traits<char>::eof();
  std::streambuf& bytes = *input_.rdbuf();
  int c = bytes.sbumpc();
  if (c == kEnd) return false;
  line_ = ++lines_read_;
  for (; c != kEnd && c != '\n' && c != '\r'; c = bytes.sbumpc()) {
    if (c == 0)
      refuse("a byte of zero: no text, or text in UTF-16",
             "a table as text in UTF-8 (a spreadsheet: save as CSV)");
    if (text.size() == kLongestRow)
      refuse(fmt::format("more than {} bytes", kLongestRow),
             "a row of a table: lines that end, and quotes that are closed");
    text += static_cast<char>(c);
  }
  if (c == '\r' && bytes.sgetc() == '\n') bytes.sbumpc();
  if (lines_read_ == 1 && text.starts_with(kByteOrderMark)) text.erase(0, kByteOrderMark.size());
  return true;
}

void TableReader::take_comment(std::string_view text) {
  if (width_ == 0) last_comment_ = text;
  const std::size_t colon = text.find(':');
  if (colon == std::string_view::npos) return;
  if (comments_.size() == kMostComments)
    refuse("a comment too many", fmt::format("at most {} comments", kMostComments));
  comments_.push_back(
      {line_, std::string(trimmed(text.substr(0, colon))), std::string(trimmed(text.substr(colon + 1)))});
}

void TableReader::split(std::string_view text, std::vector<std::string>& cells, bool& in_quotes) const {
  std::size_t count = 0;
  std::string* cell = nullptr;
  bool was_quoted = false;
  const auto begin = [&] {
    if (count == cells.size()) cells.emplace_back();
    cell = &cells[count++];
    cell->clear();
    was_quoted = false;
  };
  const auto finish = [&] {
    if (!was_quoted) *cell = trimmed(*cell);
  };
  begin();
  in_quotes = false;
  for (std::size_t at = 0; at < text.size(); ++at) {
    const char c = text[at];
    if (in_quotes) {
      if (c != '"') {
        *cell += c;
      } else if (at + 1 < text.size() && text[at + 1] == '"') {
        *cell += text[++at];
      } else {
        in_quotes = false;
      }
    } else if (c == '"' && !was_quoted && trimmed(*cell).empty()) {
      cell->clear();
      in_quotes = was_quoted = true;
    } else if (c == separator_ || (separator_ == ' ' && c == '\t')) {
      // Any number of blanks separates two cells.
      if (separator_ == ' ' && cell->empty() && !was_quoted) continue;
      finish();
      begin();
    } else if (!was_quoted || trimmed(text.substr(at, 1)).size() == 1) {
      *cell += c;  // Text after a closing quote is left in, so that it is found not to be a number.
    }
  }
  finish();
  cells.resize(count);
}

TableReader::Form TableReader::form_of(const std::string& text) {
  std::vector<std::string> cells;
  bool in_quotes = false;
  split(separator_ == '\t' ? std::string_view(text) : trimmed(text), cells, in_quotes);
  constexpr auto kLeastNumbers = 3;
  const auto numbers =
      std::ranges::count_if(cells, [&](const std::string& cell) { return number(cell).has_value(); });
  return {cells.size(), cells.back().empty() ? 1U : 0U, numbers >= kLeastNumbers};
}

/// A table begins with two rows of numbers, or with one behind its header.
void TableReader::find_beginning() {
  has_begun_ = true;
  std::vector<Line> lines;
  bool was_labelled = false;
  char separator = '\0';
  Form before;
  std::size_t bytes = 0;
  const auto is_row = [&](const Form& now) {
    return now.has_numbers && now.fits(before) &&
           (before.has_numbers ? separator_ == separator : lines.size() > 1);
  };
  Form now;
  for (Line line; lines.size() < kMostLinesBefore && bytes < kMostBytesBefore && read_new_line(line.text);
       line.text.clear()) {
    line.number = lines_read_;
    lines.push_back(line);
    bytes += line.text.size();
    if (!has_cells(line.text)) continue;
    const auto labelled = labelled_numbers(trimmed(line.text));
    if (labelled && was_labelled && labels_.size() == labelled->size())
      return keep_from(std::move(lines), lines.size() - 2);
    labels_.clear();
    was_labelled = labelled.has_value();
    if (labelled)
      for (const auto& [label, number] : *labelled) labels_.push_back(label);
    separator_ = separator_of(trimmed(line.text));
    now = labelled ? Form() : form_of(line.text);
    if (is_row(now)) break;
    before = now;
    separator = separator_;
  }
  labels_.clear();
  decimal_commas_ = false;
  if (!now.has_numbers) {
    separator_ = '\0';
    return keep_from(std::move(lines), 0);
  }
  const std::size_t header = header_above(lines, now);
  const auto passed_over = std::count_if(lines.begin(), lines.begin() + static_cast<std::ptrdiff_t>(header),
                                         [](const Line& line) { return has_cells(line.text); });
  // One line above a row that is the last, and does not fit: a header with a mistake, whose words are
  // reported.
  const bool is_mistake = passed_over == 1 && header + 1 >= lines.size();
  if (is_mistake) separator_ = '\0';
  keep_from(std::move(lines), passed_over == 0 || is_mistake ? 0 : header);
}

/// The first of the lines just above the last one that have as many cells: a header, and a line of units.
std::size_t TableReader::header_above(const std::vector<Line>& lines, const Form& row) {
  constexpr std::size_t kMostLines = 4;
  const std::size_t last = lines.size() - 1;
  std::size_t header = last;
  for (std::size_t i = last; i-- > 0 && last - i <= kMostLines;) {
    if (!has_cells(lines[i].text)) continue;
    // A header may have line breaks in its quotes.
    if (std::ranges::count(lines[i].text, '"') % 2 != 0) return 0;
    if (!form_of(lines[i].text).fits(row)) break;
    header = i;
  }
  return header;
}

/// Reads again from a line on. Comments before it are kept.
void TableReader::keep_from(std::vector<Line> lines, std::size_t first) {
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (i < first) {
      line_ = lines[i].number;
      if (const std::string_view whole = trimmed(lines[i].text); whole.starts_with('#'))
        take_comment(trimmed(whole.substr(1)));
    } else {
      kept_.push_back(std::move(lines[i]));
    }
  }
  if (first > 0 && !kept_.empty()) first_line_ = kept_.front().number;
  line_ = 0;
}

bool TableReader::next_labelled(TableRow& row) {
  if (width_ == 0) {  // The labels make the header.
    width_ = labels_.size();
    row = {first_line_, labels_};
    return true;
  }
  for (text_.clear(); read_line(text_); text_.clear()) {
    if (!has_cells(text_)) continue;
    row = {line_, {}};
    if (const auto labelled = labelled_numbers(trimmed(text_)))
      for (const auto& [label, number] : *labelled) row.cells.push_back(number);
    if (row.cells.size() == width_) return true;
    problems_.add(fmt::format("line {}", line_), fmt::format("{} numbers with labels", row.cells.size()),
                  fmt::format("{}, as in the first row", width_));
  }
  return false;
}

bool TableReader::next(TableRow& row) {
  if (!has_begun_) find_beginning();
  if (!labels_.empty() && !put_back_) return next_labelled(row);
  if (put_back_) {
    row = std::move(*put_back_);
    put_back_.reset();
    return true;
  }
  for (text_.clear(); read_line(text_); text_.clear()) {
    const std::string_view whole = trimmed(text_);
    if (whole.empty()) continue;
    if (whole.front() == '#') {
      take_comment(trimmed(whole.substr(1)));
      continue;
    }
    if (separator_ == '\0') separator_ = separator_of(whole);
    row.line = line_;
    bool in_quotes = false;
    const auto split_row = [&] { split(separator_ == '\t' ? text_ : trimmed(text_), row.cells, in_quotes); };
    for (split_row(); in_quotes; split_row()) {
      text_ += '\n';
      if (line_ - row.line < kMostLinesOfRow && read_line(text_)) continue;
      problems_.add(fmt::format("line {}", row.line), "a quoted field without an end", "a closing quote");
      return false;
    }
    // A separator may end every row.
    if (row.cells.back().empty() && (width_ == 0 || row.cells.size() == width_ + 1)) row.cells.pop_back();
    if (width_ == 0) width_ = row.cells.size();
    if (row.cells.size() == width_) return true;
    problems_.add(fmt::format("line {}", row.line), fmt::format("{} fields", row.cells.size()),
                  fmt::format("{}, as in the first row", width_));
  }
  return false;
}

std::vector<std::string> TableReader::commented_header() const {
  std::vector<std::string> cells;
  bool in_quotes = false;
  split(last_comment_, cells, in_quotes);
  return cells;
}

std::string_view TableReader::separator_words() const {
  if (!labels_.empty()) return "labels";
  if (separator_ == ',') return "commas";
  if (separator_ == ';') return "semicolons";
  return separator_ == '\t' ? "tabs" : "blanks";
}

std::optional<double> TableReader::number(std::string_view cell) {
  cell = pieces::without_plus(trimmed(cell));
  if (separator_ == ',' || cell.find(',') == std::string_view::npos) return pieces::number<double>(cell);
  std::string digits(cell);
  std::ranges::replace(digits, ',', '.');
  const std::optional<double> value = pieces::number<double>(std::string_view(digits));
  decimal_commas_ = decimal_commas_ || value;
  return value;
}

}  // namespace abcal
