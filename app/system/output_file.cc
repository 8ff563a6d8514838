#include "app/system/output_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <set>
#include <stdexcept>
#include <utility>

namespace abcal {

OutputFile::OutputFile(std::filesystem::path path) : path_(std::move(path)) {
  const std::string extension = path_.extension().string();
  std::string pattern =
      (path_.parent_path() / ("." + path_.stem().string() + "-XXXXXX" + extension)).string();
  const int fd = ::mkstemps(pattern.data(), static_cast<int>(extension.size()));
  if (fd < 0)
    throw std::runtime_error(fmt::format("{}: cannot be written: {}", path_.string(), std::strerror(errno)));
  // mkstemps makes the file readable by its owner only; a report follows the umask.
  const mode_t mask = ::umask(0);
  ::umask(mask);
  ::fchmod(fd, 0666 & ~mask);
  ::close(fd);
  temporary_ = pattern;
  removed_too_ = std::make_unique<BeforeSignalEnds>([file = temporary_] {
    std::error_code ignored;
    std::filesystem::remove(file, ignored);
  });
}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : path_(std::move(other.path_)),
      temporary_(std::exchange(other.temporary_, {})),
      removed_too_(std::move(other.removed_too_)) {}

OutputFile::~OutputFile() {
  std::error_code ignored;
  if (!temporary_.empty()) std::filesystem::remove(temporary_, ignored);
}

void OutputFile::commit() {
  flush_to_disk(temporary_, path_);
  std::error_code failed;
  std::filesystem::rename(temporary_, path_, failed);
  if (failed)
    throw std::runtime_error(fmt::format("{}: cannot be written: {}", path_.string(), failed.message()));
  temporary_.clear();
  removed_too_.reset();
}

void OutputFile::write_temporary(const std::string& content) const {
  std::ofstream file(temporary_, std::ios::binary | std::ios::trunc);
  file << content;
  file.close();
  if (!file)
    throw std::runtime_error(fmt::format("{}: cannot be written (is the disk full?)", path_.string()));
}

void OutputFile::write(const std::string& content) {
  write_temporary(content);
  commit();
}

void OutputFile::write_new(const std::string& content) {
  write_temporary(content);
  flush_to_disk(temporary_, path_);
  std::error_code failed;
  std::filesystem::create_hard_link(temporary_, path_, failed);  // Fails if there is such a file.
  if (!failed) return;
  if (std::filesystem::exists(std::filesystem::symlink_status(path_)))
    throw std::runtime_error(path_.string() + ": exists already, and stays as it is; choose another name");
  commit();  // This file system has no links.
}

void flush_to_disk(const std::filesystem::path& path, const std::filesystem::path& named) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  const bool stored = fd >= 0 && ::fsync(fd) == 0;
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (!stored)
    throw std::runtime_error(fmt::format("{}: cannot be stored: {}", named.string(), std::strerror(error)));
}

std::filesystem::path first_free_path(const std::filesystem::path& wanted) {
  std::filesystem::path path = wanted;
  for (int count = 2; std::filesystem::exists(path); ++count)
    path.replace_filename(fmt::format("{}-{}{}", wanted.stem().string(), count, wanted.extension().string()));
  return path;
}

void require_writable(const std::vector<RequestedOutput>& outputs,
                      const std::vector<std::filesystem::path>& inputs, bool force) {
  std::vector<std::string> problems;
  std::error_code ignored;
  std::set<std::filesystem::path> taken;
  for (const auto& [option, path] : outputs) {
    const auto problem = [&, name = option, file = path](const std::string& what) {
      problems.push_back(fmt::format("{} {}: {}", name, file.string(), what));
    };
    if (path.filename().empty()) {
      problem("is not the name of a file");
      continue;
    }
    const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
    if (!std::filesystem::is_directory(folder, ignored)) {
      problem(fmt::format("its folder {} does not exist", folder.string()));
      continue;
    }
    if (::access(folder.c_str(), W_OK) != 0) problem("its folder cannot be written to");
    if (!taken.insert(std::filesystem::weakly_canonical(std::filesystem::absolute(path), ignored)).second)
      problem("is named twice");
    bool is_input = false;
    for (const std::filesystem::path& input : inputs) {
      is_input = is_input || std::filesystem::equivalent(path, input, ignored);
    }
    if (is_input) {
      problem("is the source of the report and is never overwritten");
    } else if (std::filesystem::is_directory(path, ignored)) {
      problem("is a folder; required: the name of a file");
    } else if (std::filesystem::exists(path, ignored) && !force) {
      problem("exists already; choose another name, or overwrite it with --force");
    }
  }
  if (!problems.empty()) throw std::invalid_argument(fmt::format("{}", fmt::join(problems, "\n")));
}

}  // namespace abcal
