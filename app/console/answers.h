#pragma once

#include <boost/asio/thread_pool.hpp>
#include <filesystem>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "app/console/approval.h"
#include "app/console/comparisons.h"
#include "app/console/console_session.h"
#include "app/console/download.h"
#include "app/console/http_exchange.h"
#include "app/console/logins.h"
#include "app/console/run_library.h"
#include "app/console/server_common.h"
#include "app/console/signature_desk.h"
#include "app/console/workshop.h"

namespace abcal::console {

/// Answers requests over HTTP: the files of the page, runs and their products, certificates. Answers that
/// take seconds are made in threads of their own. Its functions are for the thread of the connections.
class Answers {
 public:
  Answers(ServerCommon& common, Logins& logins, const Session::Options& bench);
  ~Answers();
  Answers(const Answers&) = delete;
  Answers& operator=(const Answers&) = delete;

  /// The answer to a request. `later` is set if the answer takes long.
  HttpResponse answer(const Asked& asked, Slow& later);
  /// POST /runs/NAME/signed-certificate, which alone may be long.
  static bool is_signed_certificate(const HttpRequest& request);

 private:
  HttpResponse refuse(const Asked& asked, boost::beast::http::status status, const Message& why);
  /// A run and one of its items, as named by a form or a path. Item "" gives 0: the run has one item.
  std::optional<ItemOfRun> find_item(const std::string& run, const std::string& item) const;
  /// The item in /runs/NAME/WHAT or /runs/NAME/items/K/WHAT. Nothing for other paths and unknown runs.
  std::optional<ItemOfRun> find_item(const std::vector<std::string>& words) const;
  /// Orders a product of runs. False for other paths.
  bool order_of_library(const std::vector<std::string>& words, Slow& later);
  bool order_of_run(const ItemOfRun& of, const std::string& what, Slow& later);
  bool order_list_of_runs(const Asked& asked, const std::vector<std::string>& words, Slow& later);
  bool order_of_measurement(const std::vector<std::string>& words, Slow& later);
  bool order_readings(const Asked& asked, const std::vector<std::string>& words, Slow& later);
  bool order_benches(const std::vector<std::string>& words, Slow& later);
  bool order_check_chart(const std::vector<std::string>& words, Slow& later);
  bool order_comparison(const std::vector<std::string>& words, Slow& later);
  bool order_start_form(const Asked& asked, Slow& later);
  /// A maker of a product of these files. The product is cached for the next request.
  Workshop::Make kept(const std::string& what, std::vector<std::filesystem::path> files,
                      std::function<Product(const std::stop_token&)> make);
  HttpResponse approve_certificate(const Asked& asked, Slow& later);
  HttpResponse prepare_certificate(const Asked& asked, const ApprovalForm& form, Slow& later);
  HttpResponse take_signed_certificate(const Asked& asked, const std::vector<std::string>& words,
                                       Slow& later);
  bool order_approval(const std::vector<std::string>& words, const Visitor& visitor, Slow& later);
  ApprovalPlace approval_place() const {
    return {common_.options.register_location, common_.options.laboratory_file};
  }

  ServerCommon& common_;
  Logins& logins_;
  const std::filesystem::path bench_file_, runs_;
  RunLibrary library_;
  const Comparisons comparisons_;
  SignatureDesk signatures_;          ///< Used in the thread of `seal_` only.
  boost::asio::thread_pool seal_{1};  ///< Issues certificates, one after another.
  ProductCache products_;
  Workshop lists_, analyses_, prints_;
};

}  // namespace abcal::console
