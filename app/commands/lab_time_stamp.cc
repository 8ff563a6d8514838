#include <stdexcept>

#include "app/commands/lab.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/witness/time_stamp_authority.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"
#include "protocol/record/time_stamp.h"

namespace abcal {
namespace {

struct StampOptions {
  std::string run, authority, query, answer;
};

void tell(const StampOptions& options, const KeptTimeStamp& stamp) {
  if (stamp.new_one) {
    print_result("time stamp {} by {}, kept in {}\n", stamp.utc, stamp.authority,
                 ResultsFile::path_beside(options.run).string());
  } else {
    print_result("{} has a time stamp already; the earlier one stays\n", options.run);
  }
}

void stamp(const StampOptions& options) {
  if (!RunFile::is_closed(options.run))
    throw std::invalid_argument(options.run + ": is not closed; only a closed run has a hash to be stamped");
  if (options.query.empty()) {
    tell(options, stamp_run(options.run, time_stamp_authority(options.authority)));
  } else if (!options.answer.empty()) {
    tell(options, keep_time_stamp_answer(options.run, read_file(options.query), read_file(options.answer)));
  } else {
    OutputFile(options.query).write(time_stamp_request(sha256_of_file(options.run)));
    print_result("request written: {}; `openssl ts` and authorities take it. Keep it for --answer\n",
                 options.query);
  }
}

}  // namespace

void add_lab_time_stamp(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<StampOptions>();
  CLI::App* command =
      parent.add_subcommand("timestamp", "Have an authority stamp the hash of a closed run (RFC 3161)");
  command->add_option("RUN", options->run, "run file")->required();
  CLI::Option* authority =
      command->add_option("--authority", options->authority,
                          "http://HOST/PATH of the authority (default: ABCAL_TIME_STAMP_AUTHORITY)");
  CLI::Option* query =
      command->add_option("--query", options->query,
                          "write the request to this file; with --answer: the request that was answered");
  CLI::Option* answer =
      command->add_option("--answer", options->answer, "the authority's answer to the request in --query");
  answer->needs(query);
  authority->excludes(query);
  command->callback([options, &exit_code] {
    if (time_stamp_authority(options->authority).empty() && options->query.empty())
      throw std::invalid_argument(
          "lab timestamp: required: --authority, ABCAL_TIME_STAMP_AUTHORITY, or --query");
    stamp(*options);
    exit_code = kExitDone;
  });
}

}  // namespace abcal
