#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

struct evp_md_ctx_st;

namespace abcal {

/// SHA-256 of bytes that arrive piece by piece. Small pieces are collected: the library's call for each of
/// them takes longer than to hash it.
class Sha256 {
 public:
  Sha256();
  void add(std::string_view bytes) {
    if (bytes.size() > gathered_.size() - count_) {
      pass_on(bytes);
      return;
    }
    bytes.copy(gathered_.data() + count_, bytes.size());
    count_ += bytes.size();
  }
  /// Once, at the end.
  std::string hexadecimal();

 private:
  struct FreeContext {
    void operator()(evp_md_ctx_st* context) const;
  };
  void pass_on(std::string_view bytes);

  std::unique_ptr<evp_md_ctx_st, FreeContext> context_;
  std::array<char, 4096> gathered_;
  std::size_t count_ = 0;  ///< Number of bytes gathered.
};

/// SHA-256 of a file's bytes, in hexadecimal. Not for a run that this process is writing: closing the stream
/// releases SQLite's locks. @throws RunFileError if it cannot be read.
std::string sha256_of_file(const std::filesystem::path& path);

/// SHA-256 of some bytes, in hexadecimal.
std::string sha256_of(std::string_view bytes);

/// The next link of a chain over rows: SHA-256, in hexadecimal, of the link before (empty for the first row)
/// and of all fields, each with its length, so that nothing can be moved from one field to the next. A row
/// that is changed, left out or put in between breaks every link after it.
std::string next_link(std::string_view previous, const std::vector<std::string>& fields);

}  // namespace abcal
