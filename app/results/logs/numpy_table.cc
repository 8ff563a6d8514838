#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "app/results/logs/byte_reader.h"
#include "app/results/logs/log_table.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal {
namespace {

/// Type of an element: 'f', 'i' or 'u', and its bytes.
struct Element {
  char kind = 'f';
  std::size_t bytes = 8;
  std::endian order = std::endian::little;
};

/// The header of an array, which is a literal of Python (NEP 1).
class NumpyHeader {
 public:
  NumpyHeader(std::string_view text, const std::string& source) : text_(text), source_(source) {
    read_types();
    fortran = value_of("fortran_order").starts_with("True");
    std::string_view dimensions = value_of("shape");
    if (dimensions.empty() || dimensions.front() != '(') refuse("a header without a shape");
    dimensions = dimensions.substr(1, dimensions.find(')') - 1);
    for (std::string_view part : pieces::split(dimensions, ',')) {
      part = pieces::trimmed(part);
      if (part.empty()) continue;  // After the comma of one dimension.
      const auto size = pieces::number<std::size_t>(part);
      if (!size) refuse(fmt::format("the dimension {}", part));
      shape.push_back(*size);
    }
  }

  std::vector<std::string> names;  ///< Names of the columns; none: a plain array.
  std::vector<Element> elements;   ///< One for each name, or one.
  std::vector<std::size_t> shape;
  bool fortran = false;

  [[noreturn]] void refuse(const std::string& found) const {
    throw std::runtime_error(fmt::format(
        "{}: found {}; required: a NumPy array of numbers with the columns x, y, z, or t, x, y, z, "
        "or with names of columns",
        source_, found));
  }

 private:
  /// The text behind 'key':, up to the end of the header.
  std::string_view value_of(std::string_view key) const {
    const std::size_t at = text_.find(fmt::format("'{}':", key));
    if (at == std::string_view::npos) return {};
    return pieces::trimmed(text_.substr(at + key.size() + 3));
  }
  Element element_of(std::string_view descr) const {
    const auto bytes = descr.size() == 3 ? pieces::number<std::size_t>(descr.substr(2)) : std::nullopt;
    const bool is_known = bytes && ((descr[1] == 'f' && (*bytes == 4 || *bytes == 8)) ||
                                    ((descr[1] == 'i' || descr[1] == 'u') &&
                                     (*bytes == 1 || *bytes == 2 || *bytes == 4 || *bytes == 8)));
    if (!is_known) refuse(fmt::format("elements of the type {}", descr));
    return {descr[1], *bytes, descr[0] == '>' ? std::endian::big : std::endian::little};
  }
  /// 'descr': '<f8', or [('t', '<f8'), ('ax', '<f4')].
  void read_types() {
    std::string_view types = value_of("descr");
    if (types.starts_with("'")) {
      elements.push_back(element_of(types.substr(1, types.find('\'', 1) - 1)));
      return;
    }
    if (!types.starts_with("[")) refuse("a header without a type of its elements");
    types = types.substr(0, types.find(']'));
    // Quoted texts in turn: a name, its type.
    std::vector<std::string_view> quoted;
    for (std::size_t at = 0; (at = types.find('\'', at)) != std::string_view::npos;) {
      const std::size_t end = types.find('\'', at + 1);
      if (end == std::string_view::npos) break;
      quoted.push_back(types.substr(at + 1, end - at - 1));
      at = end + 1;
    }
    if (quoted.empty() || quoted.size() % 2 != 0) refuse("columns that are arrays themselves");
    for (std::size_t i = 0; i < quoted.size(); i += 2) {
      std::string& name = names.emplace_back(quoted[i]);
      // A name is one cell of the header of a table.
      std::ranges::replace_if(
          name, [](char c) { return c == ',' || c == '"' || c == '#' || c == '\n' || c == '\r'; }, ' ');
      elements.push_back(element_of(quoted[i + 1]));
    }
  }

  std::string_view text_;
  const std::string& source_;
};

template <class Number>
void append(ByteReader& from, std::string& text) {
  fmt::format_to(std::back_inserter(text), "{}", from.number<Number>());
}

void append_number(std::string_view bytes, const Element& element, std::string& text) {
  ByteReader reader(bytes, element.order);
  const bool is_signed = element.kind == 'i';
  switch (element.bytes) {
    case 1:
      return is_signed ? append<std::int8_t>(reader, text) : append<std::uint8_t>(reader, text);
    case 2:
      return is_signed ? append<std::int16_t>(reader, text) : append<std::uint16_t>(reader, text);
    case 4:
      if (element.kind == 'f') return append<float>(reader, text);
      return is_signed ? append<std::int32_t>(reader, text) : append<std::uint32_t>(reader, text);
    default:
      if (element.kind == 'f') return append<double>(reader, text);
      return is_signed ? append<std::int64_t>(reader, text) : append<std::uint64_t>(reader, text);
  }
}

}  // namespace

LogTable numpy_table(std::string_view bytes, const std::string& source) try {
  constexpr std::size_t kMagic = 6;
  ByteReader reader(bytes);
  reader.skip(kMagic);
  const auto version = reader.number<std::uint8_t>();
  reader.skip(1);
  const std::size_t length = version == 1 ? reader.number<std::uint16_t>() : reader.number<std::uint32_t>();
  const NumpyHeader header(reader.text(length), source);
  const std::string_view data = bytes.substr(reader.position());
  const bool has_names = !header.names.empty();
  if (header.shape.size() != (has_names ? 1U : 2U))
    header.refuse(fmt::format("an array of {} dimensions", header.shape.size()));
  // The element of row i and column k begins at i * by_row + offset of k.
  std::size_t rows = header.shape[0], columns = has_names ? header.names.size() : header.shape[1];
  std::vector<std::size_t> offset(columns < data.size() + 1 ? columns : 0);
  std::size_t by_row = 0;
  if (offset.size() != columns) throw LogEnds();
  if (has_names) {
    for (std::size_t k = 0; k < columns; ++k)
      offset[k] = std::exchange(by_row, by_row + header.elements[k].bytes);
  } else {
    const std::size_t size = header.elements.front().bytes;
    // Numbers of one column lie together in Fortran's order. An array of three long rows is one of columns.
    bool by_columns = header.fortran;
    if (rows <= 4 && columns > 4) {
      std::swap(rows, columns);
      by_columns = !by_columns;
      offset.resize(columns);
    }
    if (rows > data.size() / size) throw LogEnds();
    by_row = by_columns ? size : size * columns;
    for (std::size_t k = 0; k < columns; ++k) offset[k] = k * (by_columns ? size * rows : size);
  }
  if (rows > 0 && (by_row == 0 || rows > data.size() / by_row)) throw LogEnds();
  LogTable table{fmt::format("NumPy array of {} rows", rows), {}};
  if (has_names) table.text = fmt::format("{}\n", fmt::join(header.names, ","));
  for (std::size_t i = 0; i < rows; ++i) {
    for (std::size_t k = 0; k < columns; ++k) {
      const Element& element = header.elements[has_names ? k : 0];
      if (k > 0) table.text += ',';
      const std::size_t at = i * by_row + offset[k];
      if (at + element.bytes > data.size()) throw LogEnds();
      append_number(data.substr(at, element.bytes), element, table.text);
    }
    table.text += '\n';
  }
  return table;
} catch (const LogEnds&) {
  throw std::runtime_error(
      fmt::format("{}: a NumPy array that ends too early; required: the whole file", source));
}

}  // namespace abcal
