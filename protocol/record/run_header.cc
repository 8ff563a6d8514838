#include "protocol/record/run_header.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "drivers/text/names.h"
#include "drivers/text/number.h"
#include "protocol/plan/effect_sizes.h"
#include "protocol/record/dwell_chain.h"
#include "protocol/record/limits_entries.h"
#include "protocol/record/run_label.h"
#include "protocol/record/run_schema.h"

namespace abcal {
namespace {

constexpr std::string_view kLabelPrefix = "label.";
constexpr std::string_view kItemLabelPrefix = "label.item.";
constexpr const char* kAccelerometerRole = "accelerometer";
constexpr std::string_view kItemRole = "item-";

/// Prefix of the keys of an item's own facts; those of item 1 are the run's.
std::string facts_prefix(int item) {
  return item == 1 ? "" : fmt::format("item-{}.", item);
}

std::string shortest(double value) {
  return fmt::format("{}", value);
}

using NamedAlignment = std::pair<const char*, std::optional<MeasuredValue> MeasuredAlignment::*>;
constexpr std::array<NamedAlignment, 3> kAlignments{
    {{"zx", &MeasuredAlignment::zx}, {"zy", &MeasuredAlignment::zy}, {"xz", &MeasuredAlignment::xz}}};

std::map<std::string, std::string> facts_of(const RunHeader& header) {
  std::map<std::string, std::string> meta{
      {"schema", std::string(kRunSchemaName)},
      {"state", std::string(to_string(RunState::kRunning))},
      {"program_version", header.program_version},
      {"created_utc", header.created_utc},
      {"bench_toml", header.bench_toml},
      {"response_unit", header.response_unit},
      {"g_loc.value_mps2", shortest(header.g_loc.value_mps2)},
      {"g_loc.expanded_uncertainty_mps2", shortest(header.g_loc.expanded_uncertainty_mps2)},
      {"g_loc.coverage_factor", shortest(header.g_loc.coverage_factor)},
      {"g_loc.source", header.g_loc.source},
      {"protocol.step_deg", shortest(header.step.deg())},
      {"protocol.steps", std::to_string(header.steps)},
  };
  if (!header.stage_record.empty()) meta["stage_record"] = header.stage_record;
  if (header.approach) meta["protocol.approach_deg"] = shortest(header.approach->deg());
  meta["protocol.axes_order"] = to_string(header.axes_order);
  for (const auto& [name, member] : kAlignments) {
    const std::optional<MeasuredValue>& measured = header.measured_alignment.*member;
    if (!measured) continue;
    meta[std::string("alignment.") + name] = shortest(measured->value);
    meta[std::string("alignment.u_") + name] = shortest(measured->standard_uncertainty);
  }
  for (const auto& [key, value] : effect_size_entries(header.tolerances)) meta[key] = value;
  for (const auto& [key, value] : limits_entries(header.limits, header.expected)) meta[key] = value;
  for (const auto& [key, value] : header.labels) meta[std::string(kLabelPrefix) + key] = value;
  return meta;
}

void add_item_facts(const ItemFacts& facts, const std::string& prefix,
                    std::map<std::string, std::string>& meta) {
  meta[prefix + "response_unit"] = facts.response_unit;
  for (const auto& [key, value] : effect_size_entries(facts.tolerances)) meta[prefix + key] = value;
  for (const auto& [key, value] : limits_entries(facts.limits, facts.expected)) meta[prefix + key] = value;
  for (const auto& [key, value] : facts.labels) meta[prefix + std::string(kLabelPrefix) + key] = value;
}

void write_instruments(SqliteDatabase& database, const std::vector<InstrumentIdentity>& instruments) {
  for (const InstrumentIdentity& identity : instruments) {
    database.insert("instrument")
        .set("role", identity.role)
        .set("maker", identity.maker)
        .set("model", identity.model)
        .set("serial_number", identity.serial_number)
        .set("firmware", identity.firmware)
        .set("details", identity.details)
        .run();
  }
}

/// The items of a run: those of its header, and where it names none, the one that its labels describe;
/// without a label for it, the serial number is the one that the accelerometer reported.
std::vector<RunItem> items_of(const RunHeader& header) {
  if (!header.items.empty()) return header.items;
  const auto label = [&](const std::string& key) { return label_of(header.labels, "item." + key); };
  RunItem item;
  item.maker = label("maker");
  item.model = label("model");
  item.serial_number = label("serial_number");
  item.firmware = label("firmware");
  item.response_unit = header.response_unit;
  const auto accelerometer =
      std::ranges::find(header.instruments, kAccelerometerRole, &InstrumentIdentity::role);
  if (item.serial_number.empty() && accelerometer != header.instruments.end())
    item.serial_number = accelerometer->serial_number;
  return {item};
}

void write_items(SqliteDatabase& database, const std::vector<RunItem>& items) {
  for (const RunItem& item : items) {
    database.insert("item")
        .set("k", std::int64_t{item.k})
        .set("maker", item.maker)
        .set("model", item.model)
        .set("serial_number", item.serial_number)
        .set("firmware", item.firmware)
        .set("driver", item.driver)
        .set("port", item.port)
        .set("mounting", item.mounting)
        .set("response_unit", item.response_unit)
        .set("rate_hz", item.rate_hz)
        .set("full_scale", item.full_scale)
        .set("resolution", item.resolution)
        .run();
    for (const auto& [name, value] : item.registers)
      database.insert("item_register")
          .set("item", std::int64_t{item.k})
          .set("name", name)
          .set("value", value)
          .run();
  }
}

void write_plan(SqliteDatabase& database, const std::vector<PlannedAngle>& angles) {
  for (std::size_t position = 0; position < angles.size(); ++position) {
    const PlannedAngle& angle = angles[position];
    database.insert("plan")
        .set("position", static_cast<std::int64_t>(position))
        .set("experiment", std::int64_t{angle.experiment})
        .set("n", std::int64_t{angle.n})
        .set("closing", std::int64_t{angle.closing})
        .set("alpha_deg", angle.alpha.deg())
        .set("x_deg", angle.x.deg())
        .set("z_deg", angle.z.deg())
        .set("face", std::int64_t{angle.face})
        .set("sweep", std::int64_t{angle.sweep})
        .set("rate_deg_per_s", angle.rate_deg_per_s)
        .run();
  }
}

/// The facts of a run file, by key.
class Facts {
 public:
  Facts(SqliteDatabase& database, std::string source) : source_(std::move(source)) {
    SqliteStatement rows = database.prepare("select key, value from meta");
    while (rows.step()) all_[rows.text("key")] = rows.text("value");
  }

  const std::map<std::string, std::string>& all() const { return all_; }
  bool contains(const std::string& key) const { return all_.contains(key); }
  std::string text(const std::string& key) const {
    const auto found = all_.find(key);
    if (found == all_.end())
      throw RunFileError(source_ + ": meta \"" + key + "\" is missing; the file is damaged");
    return found->second;
  }
  double real(const std::string& key) const {
    const std::string value = text(key);
    if (const auto number = pieces::number<double>(value)) return *number;
    throw RunFileError(source_ + ": meta \"" + key + "\" is \"" + value + "\", not a number");
  }

 private:
  std::string source_;
  std::map<std::string, std::string> all_;
};

/// @param prefix before the keys of the item's own facts
void read_facts(const Facts& facts, const std::string& prefix, RunHeader& header) {
  header.program_version = facts.text("program_version");
  header.created_utc = facts.text("created_utc");
  header.bench_toml = facts.text("bench_toml");
  header.response_unit = facts.text(prefix + "response_unit");
  header.g_loc = {facts.real("g_loc.value_mps2"), facts.real("g_loc.expanded_uncertainty_mps2"),
                  facts.real("g_loc.coverage_factor"), facts.text("g_loc.source")};
  const auto optional_real = [&](const std::string& key) {
    return facts.contains(key) ? std::optional(facts.real(key)) : std::nullopt;
  };
  const auto optional_text = [&](const std::string& key) {
    return facts.contains(key) ? std::optional(facts.text(key)) : std::nullopt;
  };
  // Version 2 has the five tolerances only: further effects keep their defaults.
  if (!facts.contains("stage_uncertainty.alignment_deg")) {
    for (const char* key : {"alignment_deg", "step_deg", "initial_turn_deg", "zero_deg", "drift"})
      static_cast<void>(facts.text(std::string("tolerances.") + key));
  }
  const auto item_real = [&](const std::string& key) { return optional_real(prefix + key); };
  const auto item_text = [&](const std::string& key) { return optional_text(prefix + key); };
  read_effect_sizes([&](const std::string& key, double) { return item_real(key); }, item_text,
                    header.tolerances);
  for (const auto& [name, member] : kAlignments) {
    const std::string key = std::string("alignment.") + name;
    if (!facts.contains(key)) continue;
    header.measured_alignment.*member =
        MeasuredValue{facts.real(key), facts.real(std::string("alignment.u_") + name)};
  }
  read_limits_entries(item_real, item_text, header.limits, header.expected);
  header.step = Angle::degrees(facts.real("protocol.step_deg"));
  header.steps = static_cast<int>(facts.real("protocol.steps"));
  header.stage_record = optional_text("stage_record").value_or("");
  if (const auto deg = optional_real("protocol.approach_deg")) header.approach = Angle::degrees(*deg);
  if (const auto order = optional_text("protocol.axes_order"))
    header.axes_order = axes_order_named(*order).value_or(AxesOrder::kTogether);  // The way is not known.
  const std::string own = prefix + std::string(kItemLabelPrefix);
  for (const auto& [key, value] : facts.all()) {
    if (key.starts_with(own)) {
      header.labels[key.substr(prefix.size() + kLabelPrefix.size())] = value;
    } else if (key.starts_with(kLabelPrefix) && !key.starts_with(kItemLabelPrefix)) {
      header.labels[key.substr(kLabelPrefix.size())] = value;
    }
  }
}

/// Reads the instruments of the bench, and the accelerometer of one item.
void read_instruments(SqliteDatabase& database, int item, std::vector<InstrumentIdentity>& instruments) {
  SqliteStatement rows = database.prepare("select * from instrument order by role");
  while (rows.step()) {
    std::string role = rows.text("role");
    if (role == item_role(item)) role = kAccelerometerRole;
    if (role.starts_with(kItemRole)) continue;
    instruments.push_back({role, rows.text("maker"), rows.text("model"), rows.text("serial_number"),
                           rows.text("firmware"), rows.text("details")});
  }
  std::ranges::sort(instruments, {}, &InstrumentIdentity::role);
}

void read_plan(SqliteDatabase& database, std::vector<PlannedAngle>& plan) {
  const bool with_face = has_faces(database);
  SqliteStatement rows = database.prepare("select * from plan order by position");
  while (rows.step()) {
    plan.push_back({static_cast<int>(rows.integer("experiment")), static_cast<int>(rows.integer("n")),
                    rows.integer("closing") != 0, Angle::degrees(rows.real("alpha_deg")),
                    Angle::degrees(rows.real("x_deg")), Angle::degrees(rows.real("z_deg"))});
    if (!with_face) continue;
    plan.back().face = static_cast<int>(rows.integer("face"));
    plan.back().sweep = static_cast<int>(rows.integer("sweep"));
    plan.back().rate_deg_per_s = rows.real("rate_deg_per_s");
  }
  // Angles outside the experiments are check poses, but those of a levelling are its measurement.
  if (!has_experiments(plan)) return;
  for (PlannedAngle& angle : plan) angle.check = angle.experiment == 0;
}

void read_items(SqliteDatabase& database, RunHeader& header) {
  SqliteStatement rows = database.prepare("select * from item order by k");
  SqliteStatement registers = database.prepare("select name, value from item_register where item = :item");
  while (rows.step()) {
    RunItem& item = header.items.emplace_back();
    item.k = static_cast<int>(rows.integer("k"));
    item.maker = rows.text("maker");
    item.model = rows.text("model");
    item.serial_number = rows.text("serial_number");
    item.firmware = rows.text("firmware");
    item.driver = rows.text("driver");
    item.port = rows.text("port");
    item.mounting = rows.text("mounting");
    item.response_unit = rows.text("response_unit");
    item.rate_hz = rows.optional_real("rate_hz");
    item.full_scale = rows.optional_real("full_scale");
    item.resolution = rows.optional_real("resolution");
    registers.set("item", std::int64_t{item.k});
    while (registers.step()) item.registers[registers.text("name")] = registers.text("value");
    registers.reset();
  }
}

void read_sessions(SqliteDatabase& database, std::vector<StoredSession>& sessions) {
  SqliteStatement rows = database.prepare("select * from session order by id");
  while (rows.step()) {
    StoredSession& session = sessions.emplace_back();
    session.id = rows.integer("id");
    if (const auto begun = rows.optional_integer("begun_utc_ns"))
      session.begun = Clock::UtcTime(Clock::Duration(*begun));
    session.origin_s = to_seconds(Clock::Duration(rows.integer("origin_ns")));
    session.program_version = rows.text("program_version");
    session.ended_utc = rows.text("ended_utc");
    session.end_reason = rows.text("end_reason");
  }
}

}  // namespace

std::string item_role(int item) {
  return std::string(kItemRole) + std::to_string(item);
}

void set_meta(SqliteDatabase& database, std::string_view key, std::string_view value) {
  database.prepare("insert or replace into meta(key, value) values(:key, :value)")
      .set("key", key)
      .set("value", value)
      .run();
}

void set_timing(SqliteDatabase& database, const RunTiming& timing) {
  set_meta(database, "timing.moving_s", shortest(timing.moving_s));
  set_meta(database, "timing.settling_s", shortest(timing.settling_s));
  set_meta(database, "timing.dwelling_s", shortest(timing.dwelling_s));
  set_meta(database, "timing.overhead_s", shortest(timing.overhead_s));
}

void write_run_header(SqliteDatabase& database, const RunHeader& header) {
  auto facts = facts_of(header);
  for (std::size_t i = 0; i < header.further_items.size(); ++i)
    add_item_facts(header.further_items[i], facts_prefix(static_cast<int>(i) + 2), facts);
  for (const auto& [key, value] : facts) set_meta(database, key, value);
  set_timing(database, {});
  write_instruments(database, header.instruments);
  write_items(database, items_of(header));
  write_plan(database, header.plan);
}

void read_run_header(SqliteDatabase& database, const std::string& source, StoredRun& run) {
  const Facts facts(database, source);
  run.state = run_state_from(facts.text("state"));
  RunHeader& header = run.header;
  const std::string prefix = facts_prefix(run.item);
  if (run.item < 1 || !facts.contains(prefix + "response_unit"))
    throw RunFileError(fmt::format("{}: it has no item {}; its items are counted from 1", source, run.item));
  read_facts(facts, prefix, header);
  run.timing = {facts.real("timing.moving_s"), facts.real("timing.settling_s"),
                facts.real("timing.dwelling_s"), facts.real("timing.overhead_s")};
  read_instruments(database, run.item, header.instruments);
  read_plan(database, header.plan);
  if (run_file_version(database) >= 3) {
    read_items(database, header);
    read_sessions(database, run.sessions);
  }
  header.items = items_of(header);
}

constexpr auto kStates = names<RunState>({{RunState::kRunning, "running"},
                                          {RunState::kInterrupted, "interrupted"},
                                          {RunState::kComplete, "complete"},
                                          {RunState::kAbandoned, "abandoned"}});

std::string_view to_string(RunState state) {
  return kStates.of(state, "unknown");
}

RunState run_state_from(const std::string& word) {
  if (const auto state = kStates.value(word)) return *state;
  throw RunFileError("a run in the state \"" + word + "\", which this program does not know");
}

}  // namespace abcal
