#include "app/measure/session/run_witness.h"

#include <fmt/format.h>

#include <optional>
#include <utility>
#include <vector>

#include "app/witness/witness_check.h"

namespace abcal {
namespace {

constexpr std::chrono::milliseconds kPatience{2000};

/// The statements of the witness that the file holds, summarised.
struct Known {
  std::int64_t links = 0;  ///< Number of the last link that was signed.
  std::string last;        ///< The link that was signed last, or at which the run was begun.
  bool has_begun = false, has_ended = false;
};

Known known_of(const std::vector<WitnessedLine>& rows) {
  Known known;
  for (const WitnessedLine& row : rows) {
    const WitnessStatement statement = parse_witness_line(row.line);
    if (statement.what == WitnessAct::kBegin) {
      known.has_begun = true;
      known.last = statement.head;
    } else if (statement.what == WitnessAct::kLink) {
      known.links = statement.k;
      known.last = statement.now;
    } else if (statement.what == WitnessAct::kClose) {
      known.has_ended = true;
    }
  }
  return known;
}

}  // namespace

RunWitness::RunWitness(std::unique_ptr<WitnessClient> client, std::function<void(const std::string&)> warn)
    : client_(std::move(client)), warn_(std::move(warn)) {}

void RunWitness::begin(RunFile& file, const std::string& bench, const std::string& person, bool simulated) {
  run_ = file.head();
  simulated_ = simulated;
  require_as_witnessed(file.path());
  if (!client_) {
    if (known_of(RunFile::witnessed(file.path())).has_begun)
      warn_("the run was witnessed until now, and there is no witness: its next angles are not witnessed");
    return;
  }
  try {
    fetch_missing(file);
    require_as_witnessed(file.path());
    const Known known = known_of(RunFile::witnessed(file.path()));
    posted_ = known.links;
    // Angles that were never signed stay unsigned; the run continues after them.
    if (!known.has_begun || known.last != file.last_link())
      file.append_witness(client_->begin(run_, bench, person, file.last_link(), simulated));
    has_begun_ = true;
  } catch (const WitnessSilent& error) {
    warn_(fmt::format("the run is not witnessed: {}", error.what()));
    return;
  }
  if (simulated_) return;
  file.keep_witness(
      [this](const std::string& before, const std::string& link) {
        client_->post_link(run_, ++posted_, before, link);
      },
      [this] {
        std::vector<WitnessedLine> lines;
        for (LinkAnswer& answer : client_->take_answers()) {
          if (answer.line)
            lines.push_back(*std::move(answer.line));
          else if (!std::exchange(has_warned_, true))
            warn_(fmt::format("angle {} and later ones are not witnessed: {}", answer.k, answer.refusal));
        }
        return lines;
      });
}

void RunWitness::fetch_missing(RunFile& file) {
  std::vector<WitnessedLine> rows = RunFile::witnessed(file.path());
  if (rows.empty()) {  // The program may have died before it had stored the beginning.
    if (auto line = client_->fetch(run_, WitnessAct::kBegin)) file.append_witness(*line);
    rows = RunFile::witnessed(file.path());
  }
  const Known known = known_of(rows);
  if (!known.has_begun) return;
  for (std::int64_t k = known.links + 1;; ++k) {
    const auto line = client_->fetch(run_, WitnessAct::kLink, k);
    if (!line) break;
    file.append_witness(*line);
  }
}

void RunWitness::require_as_witnessed(const std::filesystem::path& path) const {
  Trust trust;
  if (client_) trust.keys.push_back({"the witness of this computer", client_->public_pem()});
  for (const IntegrityCheck& check : check_witness(path, trust).checks)
    if (!check.good)
      throw RunFileError(
          fmt::format("{}: the file is not what was witnessed: {}. It is not continued; restore it from a "
                      "copy, or measure again",
                      path.string(), check.found));
}

void RunWitness::finish(RunFile& file) {
  run_ = file.head();
  require_as_witnessed(file.path());
  if (!client_ || RunFile::witnessed(file.path()).empty()) return;
  try {
    fetch_missing(file);
    require_as_witnessed(file.path());
  } catch (const WitnessSilent& error) {
    warn_(fmt::format("the end of the run is not witnessed: {}", error.what()));
    return;
  }
  const Known known = known_of(RunFile::witnessed(file.path()));
  posted_ = known.links;
  has_begun_ = known.has_begun;
  if (!known.has_ended) end(file);
}

void RunWitness::await_angles() {
  if (!client_ || !has_begun_ || simulated_) return;
  if (!client_->wait_until_answered(kPatience))
    warn_("the witness does not answer: the last angles are not witnessed");
}

void RunWitness::end(RunFile& file) {
  if (!client_ || !has_begun_) return;
  try {
    const std::string last = file.last_link();
    file.append_witness(client_->close(run_, posted_, last, file.closing()));
  } catch (const WitnessSilent& error) {
    warn_(fmt::format("the end of the run is not witnessed: {}", error.what()));
  } catch (const WitnessRefusal& error) {
    warn_(fmt::format("the end of the run is not witnessed: {}", error.what()));
  }
}

}  // namespace abcal
