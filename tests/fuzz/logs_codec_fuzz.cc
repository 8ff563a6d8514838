// Fuzz target of the readers of logs: whatever bytes a file has, each reader gives a table whose lines have
// one number of cells, or refuses it with words; it takes no more memory than some multiple of the file.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// logs_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <string_view>

#include "app/results/logs/log_table.h"

namespace {

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "reader of a log: %s\n", what);
  std::abort();
}

template <class Read>
void try_reader(const Read& read, std::string_view bytes) {
  try {
    const abcal::LogTable table = read(bytes);
    // A number of 4 bytes has at most 15 characters with its comma, one of 1 byte at most 5.
    require(table.text.size() <= 200 + 8 * bytes.size(), "more text than the bytes can give");
    std::string_view text = table.text;
    long cells = -1;
    while (!text.empty()) {
      const std::string_view line = text.substr(0, text.find('\n'));
      text.remove_prefix(std::min(line.size() + 1, text.size()));
      if (line.starts_with('#')) continue;
      const long found = std::ranges::count(line, ',');
      require(cells < 0 || found == cells, "lines of different lengths");
      cells = found;
    }
  } catch (const std::runtime_error& error) {
    require(std::string_view(error.what()).starts_with("fuzz"), "words without the name of the file");
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  try_reader([](std::string_view log) { return abcal::numpy_table(log, "fuzz"); }, bytes);
  try_reader([](std::string_view log) { return abcal::ulog_table(log, "fuzz", {}); }, bytes);
  try_reader([](std::string_view log) { return abcal::ros_bag_table(log, "fuzz", {}); }, bytes);
  return 0;
}
