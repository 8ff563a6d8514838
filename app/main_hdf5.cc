// abcal-hdf5: writes groups, datasets and their attributes as HDF5. A program of its own (started by
// app/results/report/hdf5_export.h), so that abcal need not load HDF5 and its dependencies.
#include <H5Cpp.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "app/document/data_tree.h"
#include "app/run_program.h"
#include "app/system/output.h"

namespace {

using abcal::DataNode;

constexpr hsize_t kChunk = 4096;  // rows
constexpr unsigned kCompression = 4;

H5::StrType utf8() {
  H5::StrType type(H5::PredType::C_S1, H5T_VARIABLE);
  type.setCset(H5T_CSET_UTF8);
  return type;
}

const H5::PredType& in_file(double) {
  return H5::PredType::IEEE_F64LE;
}
const H5::PredType& in_file(std::int64_t) {
  return H5::PredType::STD_I64LE;
}
const H5::PredType& in_memory(double) {
  return H5::PredType::NATIVE_DOUBLE;
}
const H5::PredType& in_memory(std::int64_t) {
  return H5::PredType::NATIVE_INT64;
}

/// Writes an attribute of any type.
struct AttributeWriter {
  const H5::H5Object& object;
  const std::string& name;

  void operator()(std::int64_t number) const {
    object.createAttribute(name, in_file(number), H5::DataSpace(H5S_SCALAR))
        .write(in_memory(number), &number);
  }
  void operator()(const std::string& text) const {
    object.createAttribute(name, utf8(), H5::DataSpace(H5S_SCALAR)).write(utf8(), text);
  }
  void operator()(const std::vector<std::string>& texts) const {
    const hsize_t size = texts.size();
    std::vector<const char*> pointers;
    for (const std::string& text : texts) pointers.push_back(text.c_str());
    object.createAttribute(name, utf8(), H5::DataSpace(1, &size)).write(utf8(), pointers.data());
  }
};

void set_attributes(const H5::H5Object& object, const DataNode& node) {
  for (const auto& [name, attribute] : node.attributes) std::visit(AttributeWriter{object, name}, attribute);
}

/// HDF5 has a size type of its own.
template <class Number>
std::vector<hsize_t> shape_of(const DataNode::Array<Number>& array) {
  return {array.shape.begin(), array.shape.end()};
}

template <class Number>
void append_rows(const DataNode::Array<Number>& rows, H5::DataSet& dataset) {
  if (rows.values.empty()) return;
  const H5::DataSpace before = dataset.getSpace();
  std::vector<hsize_t> size(static_cast<std::size_t>(before.getSimpleExtentNdims()));
  before.getSimpleExtentDims(size.data());
  const std::vector<hsize_t> count = shape_of(rows);
  if (count.size() != size.size())
    throw std::invalid_argument(
        fmt::format("rows of {} dimensions; required: {}", count.size(), size.size()));
  std::vector<hsize_t> begin(size.size(), 0);
  begin.front() = size.front();
  size.front() += count.front();
  dataset.extend(size.data());
  const H5::DataSpace where = dataset.getSpace();
  where.selectHyperslab(H5S_SELECT_SET, count.data(), begin.data());
  dataset.write(rows.values.data(), in_memory(Number{}),
                H5::DataSpace(static_cast<int>(count.size()), count.data()), where);
}

/// The groups and datasets of a file.
class Tree {
 public:
  explicit Tree(const H5::H5File& file) : file_(file) {}

  void add(const DataNode& node) {
    std::visit([&](const auto& content) { add(node, content); }, node.content);
  }

 private:
  void add(const DataNode& node, const DataNode::Group&) {
    const bool is_root = node.path == "/";
    set_attributes(is_root ? file_.openGroup(node.path) : file_.createGroup(node.path), node);
  }

  void add(const DataNode& node, const std::string& text) {
    const H5::DataSet dataset = file_.createDataSet(node.path, utf8(), H5::DataSpace(H5S_SCALAR));
    dataset.write(text, utf8());
    set_attributes(dataset, node);
  }

  template <class Number>
  void add(const DataNode& node, const DataNode::Array<Number>& array) {
    if (const auto known = growing_.find(node.path); known != growing_.end())
      return append_rows(array, known->second);
    if (node.grows) {
      append_rows(array, growing_.emplace(node.path, growing(node, array)).first->second);
      return;
    }
    const std::vector<hsize_t> shape = shape_of(array);
    const H5::DataSpace space(static_cast<int>(shape.size()), shape.data());  // of no dimension: one number
    const H5::DataSet dataset = file_.createDataSet(node.path, in_file(Number{}), space);
    if (!array.values.empty()) dataset.write(array.values.data(), in_memory(Number{}));
    set_attributes(dataset, node);
  }

  /// A dataset without rows yet.
  template <class Number>
  H5::DataSet growing(const DataNode& node, const DataNode::Array<Number>& array) {
    std::vector<hsize_t> none = shape_of(array), unlimited = none, chunk = none;
    none.at(0) = 0;
    unlimited.at(0) = H5S_UNLIMITED;
    chunk.at(0) = kChunk;
    const int rank = static_cast<int>(none.size());
    H5::DSetCreatPropList properties;
    properties.setChunk(rank, chunk.data());
    properties.setShuffle();
    properties.setDeflate(kCompression);
    H5::DataSet dataset = file_.createDataSet(node.path, in_file(Number{}),
                                              H5::DataSpace(rank, none.data(), unlimited.data()), properties);
    set_attributes(dataset, node);
    return dataset;
  }

  const H5::H5File& file_;
  std::map<std::string, H5::DataSet> growing_;  ///< By their paths.
};

void write_hdf5(std::istream& nodes, const std::string& path) {
  H5::Exception::dontPrint();  // The exception contains the error.
  try {
    H5::H5File file(path, H5F_ACC_TRUNC);
    {
      Tree tree(file);
      while (const std::optional<DataNode> node = abcal::read_node(nodes)) tree.add(*node);
    }
    // Asked for here, as a destructor keeps to itself that the disk was full.
    file.flush(H5F_SCOPE_GLOBAL);
    file.close();
  } catch (const H5::Exception& error) {
    throw std::runtime_error(
        fmt::format("{}: HDF5: {}: {} (is the disk full?)", path, error.getFuncName(), error.getDetailMsg()));
  }
}

void add_write(CLI::App& parent) {
  struct Options {
    std::string tree, output;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("write", "Write groups and datasets as HDF5");
  command->add_option("TREE", options->tree, "groups and datasets, as abcal hands them over")->required();
  command->add_option("OUTPUT", options->output, "file to write; what is there is replaced")->required();
  command->callback([options] {
    std::ifstream nodes(options->tree, std::ios::binary);
    if (!nodes) throw std::invalid_argument(fmt::format("{} cannot be read", options->tree));
    write_hdf5(nodes, options->output);
  });
}

}  // namespace

int main(int argc, char** argv) {
  // If a file cannot be written, each destructor of HDF5 repeats the exception's message on that stream.
  abcal::silence_standard_error_stream();
  const int exit_code = abcal::run_program(
      argc, argv,
      {"abcal-hdf5", "abcal-hdf5 writes the HDF5 files of `abcal report --hdf5` and of the console.",
       [](CLI::App& app, int&) { add_write(app); }});
  // Every file is closed by now; if one could not be written, HDF5 crashes at the end of the program.
  std::fflush(nullptr);
  std::_Exit(exit_code);
}
