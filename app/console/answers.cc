#include "app/console/answers.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "app/bench_file/bench_config.h"
#include "app/console/other_benches.h"
#include "app/console/silent_connections.h"
#include "app/console/start_form.h"
#include "app/console/target.h"
#include "app/laboratory/compare/chart_report.h"
#include "app/laboratory/register/register.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "app/system/real_clock.h"
#include "drivers/text/number.h"
#include "protocol/record/run_file.h"

namespace abcal::console {
namespace {

namespace http = boost::beast::http;

/// Memory for products of runs that may be requested again, in bytes: some hundred results, some PDFs.
constexpr std::size_t kMostKept = 16 * 1024 * 1024;
/// Number of analyses at a time; a bench runs on two processors at least.
constexpr std::size_t kAnalysts = 2;

/// Columns of pixels of a chart, if the page does not state them; a very wide screen.
constexpr std::size_t kColumns = 1200, kMostColumns = 4000;

/// Rows of a page of the list of runs, at most.
constexpr std::size_t kMostRows = 500;

/// A bench of a tile answers within this time, or is shown as silent.
constexpr std::chrono::milliseconds kPatienceWithTile{500};

/// The number of an item; nullopt if the text is not one.
std::optional<int> item_of(const std::string& text) {
  const auto item = pieces::number<int>(text);
  return item && *item >= 1 && *item <= static_cast<int>(kMostItems) ? item : std::nullopt;
}

/// The name and the item of KIND/NAME/WHAT (no item) and KIND/NAME/items/K/WHAT; nullopt for other paths.
std::optional<std::pair<std::string, std::string>> named_in(const std::vector<std::string>& words,
                                                            std::string_view kind) {
  const bool of_item = words.size() == 5 && words[2] == "items" && !words[3].empty();
  if ((words.size() != 3 && !of_item) || words[0] != kind) return std::nullopt;
  return std::pair(words[1], of_item ? words[3] : std::string());
}

/// The download of this name; null: there is none.
const Download* find_download(const std::string& name) {
  const auto found = std::ranges::find(downloads(), name, &Download::name);
  return found == downloads().end() ? nullptr : &*found;
}

/// The fields after "?"; nullopt if they cannot be parsed.
auto query_of(const HttpRequest& request) {
  const std::string_view target = view(request.target());
  const std::size_t query = target.find('?');
  return parse_form(query == std::string_view::npos ? std::string_view() : target.substr(query + 1));
}

/// The folders of protocols: that of the runs, and that of the laboratory file if there is one.
std::vector<std::filesystem::path> folders_of_comparisons(const std::filesystem::path& runs,
                                                          const std::filesystem::path& laboratory_file) {
  std::vector<std::filesystem::path> folders{runs};
  if (!laboratory_file.empty()) folders.push_back(laboratory_file.parent_path() / ".");
  return folders;
}

}  // namespace

Answers::Answers(ServerCommon& common, Logins& logins, const Session::Options& bench)
    : common_(common),
      logins_(logins),
      bench_file_(bench.bench_file),
      runs_(bench.runs),
      library_(bench.runs),
      comparisons_(folders_of_comparisons(bench.runs, common.options.laboratory_file),
                   common.options.register_location),
      signatures_(approval_place()),
      products_(kMostKept),
      lists_(common.io, 1),
      analyses_(common.io, kAnalysts),
      prints_(common.io, 1) {}

Answers::~Answers() {
  for (Workshop* workshop : {&lists_, &analyses_, &prints_}) workshop->close();
  seal_.join();  // A certificate in progress is still issued.
}

HttpResponse Answers::refuse(const Asked& asked, http::status status, const Message& why) {
  return console::refuse(common_.log_refusal, asked, status, why);
}

HttpResponse Answers::answer(const Asked& asked, Slow& later) {
  const HttpRequest& request = asked.request;
  if (asked.access == Access::kWrongHost)
    return refuse(asked, http::status::misdirected_request,
                  Message("This console is not known by that name; see `abcal serve --host`."));
  if (asked.access == Access::kWrongOrigin)
    return refuse(asked, http::status::forbidden, Message("Another page may not use this console."));
  if (logins_.is_proxied_unknown(request))
    return refuse(asked, http::status::forbidden,
                  Message("This came through a proxy, but this console is for this computer's accounts "
                          "alone; see `abcal serve --trusted-proxy`."));
  const std::optional<Target> target = parse_target(view(request.target()));
  if (!target) return refuse(asked, http::status::bad_request, Message("The path cannot be read."));
  const std::string& path = target->path;
  const bool reads = request.method() == http::verb::get || request.method() == http::verb::head;
  if (path == "/login" && request.method() == http::verb::post && !logins_.is_open())
    return logins_.log_in(asked, later);
  if (asked.access == Access::kNoToken) return logins_.ask_who(asked, path);
  if (path == "/logout" && request.method() == http::verb::post) return logins_.log_out(asked);
  if (path == "/approve" && request.method() == http::verb::post) return approve_certificate(asked, later);
  if (is_signed_certificate(request)) return take_signed_certificate(asked, target->words, later);
  if (!reads) return refuse(asked, http::status::method_not_allowed, Message("Only GET is answered here."));

  if (auto asset = answer_with_asset(request, path == "/" ? "/index.html" : path)) return *std::move(asset);
  if (path == "/who") {
    const Visitor& visitor = asked.visitor;
    return json_answer(request, {{"person", visitor.who.name}, {"may_steer", visitor.may_steer}});
  }
  if (path == "/start-form") {
    if (order_start_form(asked, later)) return {};
    return refuse(asked, http::status::bad_request, Message("The fields of the form cannot be read."));
  }
  if (order_list_of_runs(asked, target->words, later) || order_readings(asked, target->words, later) ||
      order_of_library(target->words, later) || order_of_measurement(target->words, later) ||
      order_check_chart(target->words, later) || order_benches(target->words, later) ||
      order_comparison(target->words, later) || order_approval(target->words, asked.visitor, later)) {
    later.head = head_of(request);
    later.turn.first = asked.visitor.may_steer;
    return {};
  }
  later = {};  // An unknown path orders nothing.
  return refuse(asked, http::status::not_found, Message("There is no such page."));
}

/// GET /start-form?steps=...&serial_number=...: the run that would be started. @return false: the fields
/// cannot be read
bool Answers::order_start_form(const Asked& asked, Slow& later) {
  const auto fields = query_of(asked.request);
  if (!fields) return false;
  later.head = head_of(asked.request);
  later.workshop = &analyses_;
  later.turn = {asked.visitor.who.name.empty() ? counted_address(asked.peer.client) : asked.visitor.who.name,
                asked.visitor.may_steer};
  later.make = [this, fields = *fields, who = asked.visitor.who](const std::stop_token&) {
    const StartFormAsked form{bench_file_, runs_, common_.options.register_location, who,
                              parse_run_choice(fields)};
    return made_of_json(start_form(form, library_, common_.clock.utc_now()));
  };
  return true;
}

Workshop::Make Answers::kept(const std::string& what, std::vector<std::filesystem::path> files,
                             std::function<Product(const std::stop_token&)> make) {
  return [this, what, files = std::move(files), make = std::move(make)](const std::stop_token& cancelled) {
    const std::string key = products_.key_of(what, files);
    if (!key.empty())
      if (std::shared_ptr<const Product> known = products_.find(key)) return known;
    auto product = std::make_shared<const Product>(make(cancelled));
    // Kept only if the files have not changed meanwhile.
    if (!key.empty() && products_.key_of(what, files) == key) products_.keep(key, product);
    return product;
  };
}

/// /runs/NAME/result, /runs/NAME/DOWNLOAD, /runs/NAME/items/K/result and so on,
/// /compare/NAME/NAME[/shared-stage], /history/SERIAL/PROPERTY
bool Answers::order_of_library(const std::vector<std::string>& words, Slow& later) {
  later.workshop = &analyses_;
  if (words.size() == 3 && words[0] == "history") {
    if (!RunLibrary::is_charted(words[2])) return false;
    later.make = [this, serial = words[1], property = words[2]](const std::stop_token& stop) {
      return made_of_json(library_.history(serial, property, stop));
    };
    return true;
  }
  later.name = fmt::format("{}", fmt::join(words, "/"));
  const bool shared_stage = words.size() == 4 && words[3] == "shared-stage";
  if ((words.size() == 3 || shared_stage) && words[0] == "compare") {
    const auto first = library_.find_item(words[1]), second = library_.find_item(words[2]);
    if (!first || !second) return false;
    later.make = kept(later.name, {named_item(*first).file, named_item(*second).file},
                      [first = *first, second = *second, shared_stage](const std::stop_token&) {
                        return *made_of_json(RunLibrary::compare(first, second, shared_stage));
                      });
    return true;
  }
  const auto of = find_item(words);
  return of && order_of_run(*of, words.back(), later);
}

/// /benches: the benches of this computer as tiles, and links to other consoles.
bool Answers::order_benches(const std::vector<std::string>& words, Slow& later) {
  if (words != std::vector<std::string>{"benches"}) return false;
  std::vector<std::filesystem::path> folders = common_.options.tile_folders;
  if (!folders.empty() && std::ranges::find(folders, runs_) == folders.end()) folders.push_back(runs_);
  later.workshop = &lists_;
  later.make = [folders, links = common_.options.tile_links](const std::stop_token&) {
    return made_of_json(
        nlohmann::ordered_json{{"benches", other_benches(folders, kPatienceWithTile)}, {"links", links}});
  };
  return true;
}

/// /comparisons: the state of all; /comparisons/NAME/outcome and /comparisons/NAME/draft_a.html of one. False
/// for other paths.
bool Answers::order_comparison(const std::vector<std::string>& words, Slow& later) {
  if (words.empty() || words[0] != "comparisons") return false;
  later.workshop = &analyses_;
  if (words.size() == 1) {
    later.make = [this](const std::stop_token&) { return made_of_json(comparisons_.list()); };
    return true;
  }
  const auto protocol = words.size() == 3 ? comparisons_.find(words[1]) : std::nullopt;
  if (!protocol || (words[2] != "outcome" && words[2] != "draft_a.html")) return false;
  later.make = [this, protocol = *protocol, is_draft = words[2] == "draft_a.html"](const std::stop_token&) {
    const Clock::UtcTime now = common_.clock.utc_now();
    if (!is_draft) return made_of_json(comparisons_.outcome(protocol, now));
    return std::make_shared<const Product>(
        Product{200, "text/html; charset=utf-8", comparisons_.draft(protocol, now), true});
  };
  return true;
}

/// /check-charts: the charts of the register; /check-charts/NAME: one of them (abcal.chart/1); none without
/// a register. False for other paths.
bool Answers::order_check_chart(const std::vector<std::string>& words, Slow& later) {
  if (words.empty() || words.size() > 2 || words[0] != "check-charts") return false;
  const std::filesystem::path& location = common_.options.register_location;
  if (location.empty() && words.size() == 2) return false;
  later.workshop = &analyses_;
  later.make = [location, name = words.size() == 2 ? words[1] : ""](const std::stop_token&) {
    if (location.empty()) return made_of_json(nlohmann::ordered_json::array());
    lab::Register opened = lab::Register::open(location, RealClock().utc_now());
    if (!name.empty()) return made_of_json(chart_json(shown_chart(opened, name)));
    nlohmann::ordered_json list = nlohmann::ordered_json::array();
    for (const lab::CheckStandard& one : opened.check_standards())
      list.push_back({{"name", one.name}, {"item", one.item}, {"retired", one.retired}});
    return made_of_json(list);
  };
  return true;
}

/// /runs: the whole list;
/// /runs?search=...&sort=...&descending=1&state=...&item=...&bench=...&from=...&count=...: a page of it.
/// False for other paths, and for fields that cannot be read.
bool Answers::order_list_of_runs(const Asked& asked, const std::vector<std::string>& words, Slow& later) {
  if (words != std::vector<std::string>{"runs"}) return false;
  const auto fields = query_of(asked.request);
  if (!fields) return false;
  later.workshop = &lists_;
  if (fields->empty()) {
    later.make = [this](const std::stop_token&) { return made_of_json(library_.list()); };
    return true;
  }
  RunLibrary::PageAsked page;
  for (const auto& [key, value] : *fields) {
    if (key == "search") {
      page.search = value;
    } else if (key == "sort") {
      page.sort = value;
    } else if (key == "descending") {
      page.descending = value == "1";
    } else if (key == "state") {
      page.state = value;
    } else if (key == "item") {
      page.item = value;
    } else if (key == "bench") {
      page.bench = value;
    } else if (key == "from" || key == "count") {
      const auto number = pieces::number<std::size_t>(value);
      if (!number) return false;
      if (key == "from") page.from = *number;
      if (key == "count") page.count = std::min(*number, kMostRows);
    } else {
      return false;
    }
  }
  later.make = [this, page](const std::stop_token&) { return made_of_json(library_.page(page)); };
  return true;
}

/// /runs/NAME/readings?position=...&columns=... and the same of an item. False for other paths, and for
/// fields that cannot be read.
bool Answers::order_readings(const Asked& asked, const std::vector<std::string>& words, Slow& later) {
  if (words.empty() || words.back() != "readings") return false;
  const auto of = find_item(words);
  const auto fields = query_of(asked.request);
  if (!of || !fields) return false;
  std::optional<std::size_t> position;
  std::size_t columns = kColumns;
  for (const auto& [key, value] : *fields) {
    const auto number = pieces::number<std::size_t>(value);
    if (!number || (key != "position" && key != "columns")) return false;
    if (key == "position") position = number;
    if (key == "columns") columns = std::clamp<std::size_t>(*number, 1, kMostColumns);
  }
  later.workshop = &analyses_;
  later.name = fmt::format("{}?{},{}", fmt::join(words, "/"), position.value_or(-1), columns);
  later.make = [of = *of, position, columns](const std::stop_token&) {
    return made_of_json(RunLibrary::readings(of.run, of.item, position, columns));
  };
  return true;
}

std::optional<ItemOfRun> Answers::find_item(const std::string& run, const std::string& item) const {
  const auto path = library_.find(run);
  const auto number = item.empty() ? 0 : item_of(item);
  if (!path || !number) return std::nullopt;
  return ItemOfRun{*path, *number};
}

/// /measurements: the list; /measurements/NAME/result, /measurements/NAME/DOWNLOAD and the same of an item.
bool Answers::order_of_measurement(const std::vector<std::string>& words, Slow& later) {
  if (words.empty() || words[0] != "measurements") return false;
  later.workshop = &lists_;
  if (words.size() == 1) {
    later.make = [this](const std::stop_token&) { return made_of_json(library_.measurements()); };
    return true;
  }
  const auto named = named_in(words, "measurements");
  if (!named) return false;
  const auto path = library_.find_measurement(named->first);
  const auto item = named->second.empty() ? 1 : item_of(named->second);
  if (!path || !item) return false;
  later.workshop = &analyses_;
  later.name = fmt::format("{}", fmt::join(words, "/"));
  const ItemOfRun of{*path, *item};
  std::function<Product(const std::stop_token&)> make;
  if (words.back() == "result") {
    make = [this, of](const std::stop_token&) {
      return *made_of_json(library_.measurement(of.run, of.item));
    };
  } else if (const Download* download = find_download(words.back());
             download != nullptr && (!download->available || download->available(of))) {
    if (download->is_printed) later.workshop = &prints_;
    make = [of, download](const std::stop_token& cancelled) {
      return Product{200, download->content_type, download->make(of, cancelled), true};
    };
  }
  if (!make) return false;
  later.make = [this, of, what = later.name, make](const std::stop_token& cancelled) {
    std::vector<std::filesystem::path> files{of.run, ResultsFile::path_beside(of.run)};
    const MeasurementFile listed = listed_measurement(of.run);
    for (const MeasurementPart& run : listed.runs) files.push_back(run.path);
    if (listed.stage_record) files.push_back(listed.stage_record->path);
    return kept(what, files, make)(cancelled);
  };
  return true;
}

std::optional<ItemOfRun> Answers::find_item(const std::vector<std::string>& words) const {
  const auto named = named_in(words, "runs");
  return named ? find_item(named->first, named->second) : std::nullopt;
}

/// Orders a product of one item of a run; item 0 is the first that was not left out.
bool Answers::order_of_run(const ItemOfRun& of, const std::string& what, Slow& later) {
  const std::vector<std::filesystem::path> files{of.run, ResultsFile::path_beside(of.run)};
  const std::string of_item = fmt::format(", item {}", of.item);
  if (what == "result") {
    later.make = kept("result" + of_item, files, [this, of](const std::stop_token&) {
      return *made_of_json(library_.result(of.run, of.item));
    });
    return true;
  }
  if (what == "angles") {
    later.make = kept("angles" + of_item, files, [of](const std::stop_token&) {
      return *made_of_json(RunLibrary::angles(of.run, of.item));
    });
    return true;
  }
  const Download* download = find_download(what);
  if (download == nullptr) return false;
  if (download->is_printed) later.workshop = &prints_;
  later.make = kept(download->name + of_item, files, [of, download](const std::stop_token& cancelled) {
    const int item = shown_item(RunFile::load(of.run), of.item);
    return Product{200, download->content_type, download->make({of.run, item}, cancelled), true};
  });
  return true;
}

}  // namespace abcal::console
