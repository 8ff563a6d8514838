#pragma once

#include <filesystem>
#include <string>

#include "protocol/record/dwell_chain.h"
#include "protocol/record/sqlite.h"

namespace abcal::test {

/// Makes the chain of a run's dwells, and its end in the seal, again, as anyone can who may write the file.
inline void rebuild_chain(const std::filesystem::path& path) {
  SqliteDatabase run(path, SqliteDatabase::Mode::kReadWrite);
  run.execute("update dwell set chain = null");
  SqliteStatement rows = run.prepare("select id from dwell order by id");
  std::string link = head_link(run);
  while (rows.step()) {
    link = dwell_link(run, rows.integer(0), link);
    run.prepare("update dwell set chain = :chain where id = :dwell")
        .set("chain", link)
        .set("dwell", rows.integer(0))
        .run();
  }
  run.execute("update seal set dwell_chain = (select chain from dwell order by id desc limit 1)");
}

}  // namespace abcal::test
