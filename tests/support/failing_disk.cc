#include "tests/support/failing_disk.h"

#include <filesystem>
#include <new>
#include <stdexcept>

namespace abcal::test {

/// SQLite allocates it, with the real file behind it.
struct FailingDisk::File {
  sqlite3_file base;
  FailingDisk* disk;
  const char* name;
  sqlite3_file* real;
};

struct FailingDisk::Methods {
  static File& self(sqlite3_file* file) { return *reinterpret_cast<File*>(file); }
  static const sqlite3_io_methods& inner(sqlite3_file* file) { return *self(file).real->pMethods; }

  static int close(sqlite3_file* f) {
    return self(f).real->pMethods != nullptr ? inner(f).xClose(self(f).real) : SQLITE_OK;
  }
  static int read(sqlite3_file* f, void* to, int n, sqlite3_int64 at) {
    if (self(f).disk->next(Call::kRead, "read of", self(f).name)) return SQLITE_IOERR_READ;
    return inner(f).xRead(self(f).real, to, n, at);
  }
  static int write(sqlite3_file* f, const void* from, int n, sqlite3_int64 at) {
    const auto failure = self(f).disk->next(Call::kWrite, "write to", self(f).name);
    if (!failure) return inner(f).xWrite(self(f).real, from, n, at);
    if (*failure == Failure::kInputOutput) return SQLITE_IOERR_WRITE;
    if (*failure == Failure::kShortWrite) inner(f).xWrite(self(f).real, from, n / 2, at);
    return SQLITE_FULL;
  }
  static int truncate(sqlite3_file* f, sqlite3_int64 size) {
    if (self(f).disk->next(Call::kOtherChange, "truncation of", self(f).name)) return SQLITE_IOERR_TRUNCATE;
    return inner(f).xTruncate(self(f).real, size);
  }
  static int sync(sqlite3_file* f, int /*flags*/) {
    return self(f).disk->next(Call::kOtherChange, "sync of", self(f).name) ? SQLITE_IOERR_FSYNC : SQLITE_OK;
  }
  static int size(sqlite3_file* f, sqlite3_int64* size) { return inner(f).xFileSize(self(f).real, size); }
  static int lock(sqlite3_file* f, int level) { return inner(f).xLock(self(f).real, level); }
  static int unlock(sqlite3_file* f, int level) { return inner(f).xUnlock(self(f).real, level); }
  static int reserved(sqlite3_file* f, int* result) {
    return inner(f).xCheckReservedLock(self(f).real, result);
  }
  static int control(sqlite3_file* f, int op, void* arg) {
    return inner(f).xFileControl(self(f).real, op, arg);
  }
  static int sector_size(sqlite3_file* f) { return inner(f).xSectorSize(self(f).real); }
  static int characteristics(sqlite3_file* f) { return inner(f).xDeviceCharacteristics(self(f).real); }
  static int map(sqlite3_file* f, int region, int size, int extend, void volatile** to) {
    // The index of the write-ahead log grows.
    if (extend != 0 && self(f).disk->next(Call::kOtherChange, "mapping of", self(f).name))
      return SQLITE_IOERR_SHMSIZE;
    return inner(f).xShmMap(self(f).real, region, size, extend, to);
  }
  static int map_lock(sqlite3_file* f, int offset, int n, int flags) {
    return inner(f).xShmLock(self(f).real, offset, n, flags);
  }
  static void barrier(sqlite3_file* f) { inner(f).xShmBarrier(self(f).real); }
  static int unmap(sqlite3_file* f, int remove) { return inner(f).xShmUnmap(self(f).real, remove); }
  static int fetch(sqlite3_file* f, sqlite3_int64 at, int n, void** to) {
    return inner(f).xFetch(self(f).real, at, n, to);
  }
  static int unfetch(sqlite3_file* f, sqlite3_int64 at, void* what) {
    return inner(f).xUnfetch(self(f).real, at, what);
  }

  static constexpr sqlite3_io_methods kTable{
      3,           close,           read, write,    truncate, sync,  size,  lock,   unlock, reserved, control,
      sector_size, characteristics, map,  map_lock, barrier,  unmap, fetch, unfetch};

  static FailingDisk& disk(sqlite3_vfs* vfs) { return *static_cast<FailingDisk*>(vfs->pAppData); }

  static int open(sqlite3_vfs* vfs, const char* name, sqlite3_file* file, int flags, int* out_flags) {
    File& mine = self(file);
    mine.base.pMethods = nullptr;
    if ((flags & SQLITE_OPEN_READWRITE) != 0 && disk(vfs).next(Call::kOtherChange, "opening of", name))
      return SQLITE_CANTOPEN;
    mine.disk = &disk(vfs);
    mine.name = name;
    mine.real = reinterpret_cast<sqlite3_file*>(&mine + 1);
    mine.real->pMethods = nullptr;
    const int code = mine.disk->real_->xOpen(mine.disk->real_, name, mine.real, flags, out_flags);
    if (mine.real->pMethods != nullptr) mine.base.pMethods = &kTable;
    return code;
  }
  static int remove(sqlite3_vfs* vfs, const char* name, int sync_folder) {
    if (disk(vfs).next(Call::kOtherChange, "removal of", name)) return SQLITE_IOERR_DELETE;
    return disk(vfs).real_->xDelete(disk(vfs).real_, name, sync_folder);
  }
};

FailingDisk::FailingDisk() : real_(sqlite3_vfs_find(nullptr)), vfs_(*real_) {
  vfs_.zName = "failing disk";
  vfs_.szOsFile = static_cast<int>(sizeof(File)) + real_->szOsFile;
  vfs_.pAppData = this;
  vfs_.pNext = nullptr;
  vfs_.xOpen = Methods::open;
  vfs_.xDelete = Methods::remove;
  if (sqlite3_vfs_register(&vfs_, 1) != SQLITE_OK) throw std::runtime_error("SQLite takes no failing disk");
}

FailingDisk::~FailingDisk() {
  sqlite3_vfs_unregister(&vfs_);
  sqlite3_vfs_register(real_, 1);
}

void FailingDisk::fail(Failure how, std::size_t at, bool lasts) {
  mend();
  plan_ = Plan{how, at, lasts};
}

void FailingDisk::mend() {
  plan_.reset();
  failed_.reset();
  reads_ = writes_ = changes_ = 0;
}

std::size_t FailingDisk::calls(Failure how) const {
  if (how == Failure::kRead) return reads_;
  return how == Failure::kInputOutput ? changes_ : writes_;
}

std::optional<FailingDisk::Failure> FailingDisk::next(Call call, const char* what, const char* file) {
  ++(call == Call::kRead ? reads_ : changes_);
  if (call == Call::kWrite) ++writes_;
  if (!plan_) return std::nullopt;
  const bool can_fail = plan_->how == Failure::kRead          ? call == Call::kRead
                        : plan_->how == Failure::kInputOutput ? call != Call::kRead
                                                              : call == Call::kWrite;
  if (!can_fail) return std::nullopt;
  const std::size_t count = calls(plan_->how);
  if (count != plan_->at && !(plan_->lasts && count > plan_->at)) return std::nullopt;
  if (!failed_) {
    failed_ = std::string(what) + " " +
              (file != nullptr ? std::filesystem::path(file).filename().string() : "a temporary file");
  }
  return plan_->how;
}

}  // namespace abcal::test
