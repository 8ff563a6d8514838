#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "app/system/interrupt.h"

namespace abcal {

/// A file that is written under a temporary name in the same folder and renamed when it is complete: a
/// failure leaves nothing behind, and an older file unchanged.
class OutputFile {
 public:
  /// @throws std::runtime_error if the folder cannot be written to
  explicit OutputFile(std::filesystem::path path);
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&&) = delete;
  ~OutputFile();  ///< Removes a file that was not committed.

  const std::filesystem::path& path() const { return path_; }
  /// Where to write until commit(): an empty file in the same folder, with the same extension.
  const std::filesystem::path& temporary() const { return temporary_; }

  /// Writes the file to the disk and renames it.
  /// @throws std::runtime_error
  void commit();

  /// Writes the complete content and commits. @throws std::runtime_error
  void write(const std::string& content);

  /// As write(), but never in place of a file that exists, not even of one that was made meanwhile.
  /// @throws std::runtime_error
  void write_new(const std::string& content);

 private:
  void write_temporary(const std::string& content) const;

  std::filesystem::path path_, temporary_;
  std::unique_ptr<BeforeSignalEnds> removed_too_;  ///< The temporary file.
};

/// Waits until a file or folder is on the disk. A renamed file survives a power failure only once its folder
/// is on the disk, too.
/// @param named  in the message, in place of `path`
/// @throws std::runtime_error
void flush_to_disk(const std::filesystem::path& path, const std::filesystem::path& named);

/// The path itself, or the first of "NAME-2.EXT", "NAME-3.EXT" ... that does not exist.
std::filesystem::path first_free_path(const std::filesystem::path& wanted);

/// A file that a command was asked to write.
struct RequestedOutput {
  std::string option;  ///< "--html"
  std::filesystem::path path;
};

/// Refuses files that may not be written, with all problems at once, before any is written: one exists and
/// `force` is not given, is a folder, is the same as another, or is one of `inputs` (never, `force` or not),
/// or its folder does not exist.
/// @throws std::invalid_argument
void require_writable(const std::vector<RequestedOutput>& outputs,
                      const std::vector<std::filesystem::path>& inputs, bool force);

}  // namespace abcal
