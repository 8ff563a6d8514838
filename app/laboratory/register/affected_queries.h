#pragma once

#include <string>

// Questions to the register about everything that rests on a record. They are asked of registers with many
// thousand certificates, so that each goes by an index (a test reads SQLite's plan). Functions, so that a
// program that never asks them holds no text of them.

namespace abcal::lab {

/// The sources of runs that a name means: of a record, or identity or serial number of equipment.
inline std::string named_sources() {
  return "select run_sha256, kind, name, serial_number, role from used_source where name = :name union "
         "select run_sha256, kind, name, serial_number, role from used_source where serial_number = :name "
         "union select u.run_sha256, u.kind, u.name, u.serial_number, u.role from calibration c join "
         "used_source u on u.name = c.certificate where c.equipment = :name";
}

/// Runs with their sources in question: 8 columns.
inline std::string affected_runs() {
  return "select r.run_sha256, r.file, r.item, r.date, s.kind, s.name, s.serial_number, s.role from (" +
         named_sources() +
         ") s join known_run r on r.run_sha256 = s.run_sha256 order by r.date, r.run_sha256, s.name";
}

/// Certificates of these runs, and the certificate of this number, with their addressees: 16 columns.
inline std::string affected_certificates() {
  return "select c.number, c.state, c.run_sha256, c.xml_sha256, c.item, c.measured_by, c.approved_by, "
         "c.issue_date, c.replaces, c.reason, c.utc, c.approval, a.name, a.address, a.email, a.language from "
         "(" +
         ("select m.number as number from (" + named_sources() +
          ") s join certificate m on m.run_sha256 = s.run_sha256") +
         (" union select f.certificate as number from (" + named_sources() +
          ") s join certified_run f on f.run_sha256 = s.run_sha256") +
         " union select number from certificate where number = :name) n join certificate c on c.number = "
         "n.number left join addressee a on a.certificate = c.number where c.state <> 'reserved' order by "
         "c.number";
}

}  // namespace abcal::lab
