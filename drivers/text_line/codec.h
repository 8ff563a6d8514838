#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// Lines of numbers as boards print them. Pure: no port, no clock, no logging.
namespace abcal::text_line {

/// Places of the numbers on a line.
struct LineFormat {
  std::vector<int> columns{1, 2, 3};  ///< Columns that are read, in this order; the first column is 1.
  std::string separator{","};         ///< One character; " ": any run of blanks and tabs.
  std::string comment{"#"};           ///< A line that begins so is skipped; empty: none.
  /// Names in front of the numbers, in place of columns: "ax" finds 0.1 in `"ax": 0.1`, `ax=0.1`, `>ax:0.1g`.
  /// All on one line, or each on a line of its own. Empty: columns.
  std::vector<std::string> names{};
  std::string unit{};       ///< Unit that may directly follow a number, "g" in "0.1g"; empty: none.
  char decimal_mark = '.';  ///< Or ','.
};

/// The numbers of one line.
struct NumberLine {
  std::vector<double> values;  ///< One for each of LineFormat::columns.
  std::size_t words = 0;       ///< How many columns the line has; how many names, where they have names.
  std::size_t size = 0;        ///< Bytes, with its end; of all lines, where each number has one.
  /// It looks like "0,01,0,02,1,00": numbers whose decimal mark is the separator, which shifts the columns.
  bool decimal_commas = false;
};

/// A decimal number: "1", "+1.5", "-.5e-3", "nan", "inf". In any locale the decimal mark is a point. Absent
/// if the text is anything else, or beyond the range of a double.
std::optional<double> parse_number(std::string_view word);

/// Number behind one name on a line (LineFormat::names).
struct NamedNumber {
  int found = 0;                ///< Number of occurrences of the name, followed by ":" or "=".
  std::optional<double> value;  ///< Absent if no number follows it.
};
NamedNumber named_number(std::string_view line, std::string_view name, const LineFormat& format);

/// Finds lines of numbers in a stream of bytes that may begin anywhere and be split anywhere.
///
/// A line ends with CR, LF or both. Bytes before the first end are dropped: they may be the rest of a line.
/// Empty lines and comments are skipped. Quotes around a word (CSV) do not belong to it, and separators
/// between them do not separate. Other lines without numbers in the columns are headers before the first line
/// of numbers, and bad lines from then on; so is a line longer than kLongestLine, and one with another number
/// of columns once that is required. The result does not depend on how the bytes were split.
///
/// With names: lines without any of them are skipped; a name that occurs twice on a line, has no number, or
/// is repeated before the others have arrived makes it a bad line.
///
/// There is no checksum: a digit that was damaged into another digit passes.
class LineReader {
 public:
  static constexpr std::size_t kLongestLine = 1024;

  /// @throws std::invalid_argument for a format that cannot be.
  explicit LineReader(LineFormat format);

  void feed(std::string_view bytes);

  /// The next line of numbers in the bytes fed so far; absent if it needs more bytes.
  std::optional<NumberLine> next();

  /// From now on a line must have this many columns: two lines joined by a lost line end are a bad line.
  void require_words(std::size_t words) { required_words_ = words; }

  /// Called where bytes are missing: bytes before the next end of a line are dropped.
  void lose_track();

  /// True if bytes are held back that may begin a line.
  bool has_partial() const { return begin_ < buffer_.size(); }

  std::uint64_t header_lines() const { return header_lines_; }
  std::uint64_t bad_frames() const { return bad_lines_; }
  /// Bytes of bad lines, and of lines dropped because their beginning is missing.
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  std::vector<std::string_view> split(std::string_view line) const;
  std::optional<NumberLine> decode(std::string_view line);
  std::optional<NumberLine> decode_columns(std::string_view line);
  std::optional<NumberLine> decode_names(std::string_view line);
  std::optional<double> number_in(std::string_view word) const;
  void count_other_line(std::size_t bytes);

  LineFormat format_;
  std::optional<std::size_t> required_words_;
  std::string buffer_;
  std::size_t begin_ = 0;  ///< Bytes before this position are consumed.
  bool dropping_ = true;   ///< Up to the next end of a line.
  bool has_numbers_come_ = false;
  bool all_on_one_line_ = false;               ///< Seen so: from then on required.
  std::vector<std::optional<double>> so_far_;  ///< For each name, where each number has a line of its own.
  std::size_t size_so_far_ = 0;
  std::uint64_t header_lines_ = 0;
  std::uint64_t bad_lines_ = 0;
  std::uint64_t skipped_bytes_ = 0;
};

}  // namespace abcal::text_line
