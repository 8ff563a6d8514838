#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/record/sqlite.h"

namespace abcal {

/// An issued certificate. Fields in the order in which they are chained.
struct IssuedCertificate {
  std::string utc;  ///< When it was issued.
  std::string number;
  std::string measured_by, approved_by;
  std::string date;      ///< Date of issue, as on the certificate: "2026-03-01".
  std::string replaces;  ///< Number of the certificate it replaces; empty: none.
  std::string reason;    ///< Why.
  std::string program_version;
  std::string laboratory_toml;  ///< The laboratory file as read.
  std::string xml;              ///< Its bytes, signature included.
  /// For a run with several items: the item of the certificate, from 1. 0: the run has one item. Chained
  /// last, where it is not 0.
  int item = 0;
};

/// `RUN.results`, in the folder of the run: analyses and issued certificates. Rows are only ever added, each
/// in one transaction: several programs may add at once.
class ResultsFile {
 public:
  /// The note in the table `run` of results that were made again.
  static constexpr std::string_view kMadeAgain = "made again: earlier analyses are not known";

  /// Begins the results of a run that is about to be closed: without any, and without its hash. Does nothing
  /// where it is begun already.
  /// @throws RunFileError
  static void begin(const std::filesystem::path& run_path);

  /// Opens the results of a closed run; they name its hash. If results that begin() had made are missing,
  /// they are made again, with a note.
  /// @throws RunFileError also where they belong to another run
  ResultsFile(const std::filesystem::path& run_path, const std::string& run_sha256);

  /// Whether this call created the file again, which must be reported: earlier analyses are unknown.
  bool made_again() const { return made_again_; }

  /// Stores an analysis unless the very same one is there already.
  void add_analysis(const std::string& utc, std::string_view program_version, std::string_view estimator,
                    std::string_view result_json);

  /// How many are stored.
  std::size_t analyses();

  /// Keeps an issued certificate. Refuses a number that is there already, a second certificate of an item
  /// that does not replace its first, and the replacement of one that is replaced already or is of another
  /// item.
  void add_certificate(const IssuedCertificate& certificate);

  static std::filesystem::path path_beside(const std::filesystem::path& run_path);
  /// path_beside(), to be written. @throws RunFileError if it is a link: what it leads to may be somebody
  /// else's
  static std::filesystem::path path_to_write(const std::filesystem::path& run_path);

  /// Refuses a run that is not closed although results exist for its name: they belong to another run.
  /// @throws RunFileError
  static void require_none(const std::filesystem::path& run_path);

  /// The certificates issued for a run, oldest first; none where there are no results.
  static std::vector<IssuedCertificate> certificates(const std::filesystem::path& run_path);
  /// The certificates of one item: from 1 if there are several; the item of a run with one is 0 or 1.
  static std::vector<IssuedCertificate> certificates(const std::filesystem::path& run_path, int item);

 private:
  explicit ResultsFile(const std::filesystem::path& run_path);

  SqliteDatabase database_;
  bool made_again_ = false;
};

}  // namespace abcal
