#pragma once

#include <cstddef>
#include <cstdint>
#include <iosfwd>
#include <map>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace abcal {

/// A group or a dataset of a file of hierarchical data (HDF5), or further rows of a dataset. The nodes of a
/// file follow each other, a group before what is in it, so that a long file need not fit into memory.
struct DataNode {
  struct Group {};

  /// Numbers row by row.
  template <class Number>
  struct Array {
    std::vector<std::size_t> shape;  ///< Empty: a single number.
    std::vector<Number> values;      ///< As many as the product of the shape.
  };

  using Attribute = std::variant<std::int64_t, std::string, std::vector<std::string>>;

  std::string path;  ///< From the root "/": "/entry/readings/time".
  std::variant<Group, std::string, Array<double>, Array<std::int64_t>> content;
  /// Later nodes of the path of an array add rows to it. They have no attributes, and the same shape but
  /// for its first number.
  bool grows = false;
  std::map<std::string, Attribute> attributes;
};

/// Appends a node to a stream, as an item of a CBOR sequence (RFC 8742). Numbers are stored as this computer
/// has them in memory, for a program on the same computer; texts become valid (valid_text). A failure is in
/// the state of the stream.
void write_node(const DataNode& node, std::ostream& stream);

/// The next node of a stream that write_node() has filled; nullopt at its end.
/// @throws std::runtime_error if the bytes are not a node, or cannot be read
std::optional<DataNode> read_node(std::istream& stream);

}  // namespace abcal
