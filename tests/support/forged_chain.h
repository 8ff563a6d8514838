#pragma once

#include <filesystem>
#include <string>

#include "protocol/record/dwell_chain.h"
#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"

namespace abcal::test {

/// Makes the chain of a run's events again.
inline void rebuild_events(SqliteDatabase& run) {
  SqliteStatement rows = run.prepare("select id, utc, who, kind, text from event order by id");
  for (std::string link; rows.step();) {
    link = next_link(link, {rows.text(1), rows.text(2), rows.text(3), rows.text(4)});
    run.prepare("update event set chain = :chain where id = :event")
        .set("chain", link)
        .set("event", rows.integer(0))
        .run();
  }
}

/// Makes the chains of a run's events and dwells, and their ends in the seal, again, as anyone can who may
/// write the file.
inline void rebuild_chain(const std::filesystem::path& path) {
  SqliteDatabase run(path, SqliteDatabase::Mode::kReadWrite);
  rebuild_events(run);
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
  run.execute(
      "update seal set dwell_chain = (select chain from dwell order by id desc limit 1), event_chain = "
      "(select "
      "chain from event order by id desc limit 1)");
}

}  // namespace abcal::test
