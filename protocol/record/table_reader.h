#pragma once

#include <cstddef>
#include <deque>
#include <istream>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/plan/run_config.h"

namespace abcal {

/// Every problem of a table at once. what() lists them, one a line: "FILE: line 12, r_u: found ...; required:
/// ...".
class TableError : public std::runtime_error {
 public:
  /// @param count  all problems, of which `problems` are the first
  TableError(const std::string& source, std::vector<Problem> problems, std::size_t count);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// Collects the problems of a table. The first are kept, the others counted: a table of any size needs no
/// more memory.
class TableProblems {
 public:
  explicit TableProblems(std::string source) : source_(std::move(source)) {}
  const std::string& source() const { return source_; }
  std::size_t count() const { return count_; }
  void add(std::string where, std::string found, std::string required);
  /// @throws TableError
  [[noreturn]] void fail() const;

 private:
  std::string source_;
  std::vector<Problem> kept_;
  std::size_t count_ = 0;
};

/// A text of an arbitrary file in quotes, shortened for a message.
std::string as_quoted(std::string_view text);

struct TableRow {
  std::size_t line = 0;  ///< From 1.
  std::vector<std::string> cells;
};

/// Comment "# key: value".
struct TableComment {
  std::size_t line = 0;
  std::string key, value;
};

/// Reads a table row by row, in memory for one row. Lines before the table are passed over: it begins with
/// the first two lines of as many cells that have numbers, and with the lines just before them that have as
/// many cells. Semicolons, tabs, commas or blanks separate the cells, as these rows show; or each number has
/// its label (labelled_numbers()), which makes the header. Numbers may have a decimal comma unless commas
/// separate cells. `#` begins a comment line; a byte order mark is skipped; cells may be quoted (RFC 4180);
/// lines end with LF, CRLF or CR.
class TableReader {
 public:
  /// A row with more bytes is refused: it is not one of a table.
  static constexpr std::size_t kLongestRow = 1 << 20;

  /// @param input, problems  must outlive this
  TableReader(std::istream& input, TableProblems& problems);

  /// The next row. A row with another number of cells than the first is a problem, and passed over.
  /// @throws TableError  a line that is too long, or is no text
  bool next(TableRow& row);
  /// Lets next() give this row again; once.
  void put_back(TableRow row) { put_back_ = std::move(row); }

  bool is_empty() const { return line_ == 0; }  ///< No line was there to be read.
  /// Comments so far that have a key.
  const std::vector<TableComment>& comments() const { return comments_; }
  /// Cells of the last comment before the first row, which some programs write as a header.
  std::vector<std::string> commented_header() const;
  /// "commas", "semicolons", "tabs", "blanks", "labels".
  std::string_view separator_words() const;
  bool has_decimal_commas() const { return decimal_commas_; }
  /// The line on which the table begins, from 1.
  std::size_t first_line() const { return first_line_; }
  /// The number that all of a cell is; a plus sign is allowed.
  std::optional<double> number(std::string_view cell);

 private:
  /// Cells of a line; a separator at its end makes an empty one, which need not count.
  struct Form {
    std::size_t cells = 0, empty_at_end = 0;
    bool has_numbers = false;  ///< Three cells or more are numbers.
    bool fits(const Form& other) const {
      return cells == other.cells || cells - empty_at_end == other.cells - other.empty_at_end;
    }
  };
  struct Line {
    std::size_t number = 0;
    std::string text;
  };
  bool read_line(std::string& text);
  bool read_new_line(std::string& text);
  void find_beginning();
  std::size_t header_above(const std::vector<Line>& lines, const Form& row);
  Form form_of(const std::string& text);
  void keep_from(std::vector<Line> lines, std::size_t first);
  bool next_labelled(TableRow& row);
  void split(std::string_view text, std::vector<std::string>& cells, bool& in_quotes) const;
  void take_comment(std::string_view text);
  [[noreturn]] void refuse(std::string found, std::string required);

  std::istream& input_;
  TableProblems& problems_;
  std::size_t line_ = 0, width_ = 0, lines_read_ = 0, first_line_ = 1;
  bool has_begun_ = false;
  std::deque<Line> kept_;            ///< Lines that were read to find the beginning.
  std::vector<std::string> labels_;  ///< Labels of the numbers; empty: cells.
  char separator_ = '\0';
  bool decimal_commas_ = false;
  std::string text_, last_comment_;
  std::vector<TableComment> comments_;
  std::optional<TableRow> put_back_;
};

}  // namespace abcal
