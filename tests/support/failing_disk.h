#pragma once

#include <sqlite3.h>

#include <cstddef>
#include <optional>
#include <string>

namespace abcal::test {

/// A disk that fails under SQLite: while it lives, every database of this process goes through it. It passes
/// all on to the real file system, but for the call that is to fail. Nothing is forced to the real disk (that
/// takes long, and no power is cut here). One at a time, in a process with one thread.
class FailingDisk {
 public:
  enum class Failure {
    kFull,         ///< A write fails with SQLITE_FULL; none of its bytes are written.
    kShortWrite,   ///< A write fails with SQLITE_FULL after half of its bytes.
    kInputOutput,  ///< A write, a sync, a truncation, the opening or removal of a file fails with an I/O
                   ///< error.
    kRead,         ///< A read fails with an I/O error.
  };

  FailingDisk();
  FailingDisk(const FailingDisk&) = delete;
  FailingDisk& operator=(const FailingDisk&) = delete;
  ~FailingDisk();

  /// The `at`-th call from now on (1 is the next; those are counted that can fail so) fails; if `lasts`, all
  /// after it as well, until mend().
  void fail(Failure how, std::size_t at, bool lasts);
  void mend();

  /// How many calls there were since fail() or mend() that can fail so.
  std::size_t calls(Failure how) const;
  /// The call that failed first since fail(), e.g. "write to a.run-wal"; nothing: none has.
  const std::optional<std::string>& failed() const { return failed_; }

 private:
  struct File;
  struct Methods;
  enum class Call { kRead, kWrite, kOtherChange };
  /// Action of a call: absent if it is passed on, else a failure.
  std::optional<Failure> next(Call call, const char* what, const char* file);

  sqlite3_vfs* real_;
  sqlite3_vfs vfs_;
  std::size_t reads_ = 0, writes_ = 0, changes_ = 0;
  struct Plan {
    Failure how;
    std::size_t at;
    bool lasts;
  };
  std::optional<Plan> plan_;
  std::optional<std::string> failed_;
};

}  // namespace abcal::test
