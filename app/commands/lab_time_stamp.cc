#include <fmt/format.h>

#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/url/parse.hpp>
#include <chrono>
#include <stdexcept>

#include "app/commands/lab.h"
#include "app/system/exit_code.h"
#include "app/system/input_file.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/sha256.h"
#include "protocol/record/time_stamp.h"

namespace abcal {
namespace {

constexpr std::chrono::seconds kPatience{15};

/// Sends a request to an authority (RFC 3161, 3.4) and returns its answer.
/// @throws std::invalid_argument (address), std::runtime_error (no answer)
std::string ask_authority(const std::string& address, const std::string& request) {
  namespace beast = boost::beast;
  namespace http = beast::http;
  const auto url = boost::urls::parse_uri(address);
  if (!url || url->scheme() != "http" || url->host().empty())
    throw std::invalid_argument(fmt::format(
        "--authority {}: required: http://HOST[:PORT][/PATH]; for others take --query and --answer",
        address));
  const std::string host = url->host(), port = url->has_port() ? std::string(url->port()) : "80";
  const std::string target = url->encoded_target().empty() ? "/" : std::string(url->encoded_target());
  boost::asio::io_context context;
  beast::tcp_stream stream(context);
  http::response<http::string_body> answer;
  beast::flat_buffer buffer;
  beast::error_code failure;
  http::request<http::string_body> message(http::verb::post, target, 11, request);
  message.set(http::field::host, host);
  message.set(http::field::content_type, "application/timestamp-query");
  message.prepare_payload();
  boost::asio::ip::tcp::resolver resolver(context);
  // One step after the other, with one deadline for each that goes over the wire.
  const auto then_read = [&](beast::error_code error, std::size_t) {
    failure = error;
    if (!error)
      http::async_read(stream, buffer, answer, [&](beast::error_code read, std::size_t) { failure = read; });
  };
  const auto then_write = [&](beast::error_code error, const auto&) {
    failure = error;
    if (!error) http::async_write(stream, message, then_read);
  };
  stream.expires_after(kPatience);
  const auto found = resolver.resolve(host, port, failure);
  if (!failure) {
    stream.async_connect(found, then_write);
    context.run();
  }
  if (failure)
    throw std::runtime_error(fmt::format("time stamp: {} does not answer: {}", address, failure.message()));
  if (answer.result() != http::status::ok)
    throw std::runtime_error(fmt::format("time stamp: {} answers {}", address, answer.result_int()));
  return answer.body();
}

struct StampOptions {
  std::string run, authority, query, answer;
};

/// Keeps the time stamp of an answer with the run. @throws std::runtime_error if the authority gave none
void keep(const StampOptions& options, const std::string& sha256, const std::string& request,
          const std::string& answer_der) {
  const TimeStampAnswer answer = read_time_stamp_answer(answer_der, request);
  if (answer.token.empty()) throw std::runtime_error("no time stamp: " + answer.refused);
  const bool kept = keep_time_stamp(options.run, answer.token);
  const TimeStampCheck stamp = check_time_stamp(answer.token, sha256, {});
  if (kept) {
    print_result("time stamp {} by {}, kept in {}\n", stamp.utc, stamp.authority,
                 ResultsFile::path_beside(options.run).string());
  } else {
    print_result("{} has a time stamp already; the earlier one stays\n", options.run);
  }
}

void stamp(const StampOptions& options) {
  if (!RunFile::is_closed(options.run))
    throw std::invalid_argument(options.run + ": is not closed; only a closed run has a hash to be stamped");
  const std::string sha256 = sha256_of_file(options.run);
  if (!options.authority.empty()) {
    const std::string request = time_stamp_request(sha256);
    keep(options, sha256, request, ask_authority(options.authority, request));
  } else if (!options.answer.empty()) {
    keep(options, sha256, bytes_of_file(options.query), bytes_of_file(options.answer));
  } else {
    OutputFile(options.query).write(time_stamp_request(sha256));
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
      command->add_option("--authority", options->authority, "http://HOST/PATH of the authority");
  CLI::Option* query =
      command->add_option("--query", options->query,
                          "write the request to this file; with --answer: the request that was answered");
  CLI::Option* answer =
      command->add_option("--answer", options->answer, "the authority's answer to the request in --query");
  answer->needs(query);
  authority->excludes(query);
  command->callback([options, &exit_code] {
    if (options->authority.empty() && options->query.empty())
      throw std::invalid_argument("lab timestamp: required: --authority, or --query");
    stamp(*options);
    exit_code = kExitDone;
  });
}

}  // namespace abcal
