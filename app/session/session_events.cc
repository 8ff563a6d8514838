#include "app/session/session_events.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <type_traits>
#include <utility>

namespace abcal {
namespace {

using Json = nlohmann::json;

// Each function visits the members of a structure once: the same list writes and reads it.

/// Writes members into a JSON object.
class MemberWriter {
 public:
  explicit MemberWriter(Json& json) : json_(json) {}
  template <class Value>
  void member(const char* key, Value& value) {
    json_[key] = written(value);
  }

 private:
  static Json written(double value) {
    if (std::isfinite(value)) return value;
    if (std::isnan(value)) return "nan";
    return value > 0.0 ? "inf" : "-inf";
  }
  static Json written(const std::string& text) { return text; }
  static Json written(bool value) { return value; }
  static Json written(Angle angle) { return written(angle.deg()); }
  static Json written(RunPhase phase) { return std::string(to_string(phase)); }
  static Json written(const Eigen::Vector3d& v) {
    return Json::array({written(v[0]), written(v[1]), written(v[2])});
  }
  template <class Value>
  static Json written(const std::optional<Value>& value) {
    return value ? written(*value) : Json(nullptr);
  }
  template <class Value>
  static Json written(const std::vector<Value>& list) {
    Json json = Json::array();
    for (const Value& value : list) json.push_back(written(value));
    return json;
  }
  template <class Value>
  static Json written(const Value& value) {
    if constexpr (std::is_integral_v<Value>) {
      return value;
    } else {
      Json json = Json::object();
      MemberWriter writer(json);
      visit_members(writer, value);
      return json;
    }
  }

  Json& json_;
};

/// Reads members from a JSON object.
class MemberReader {
 public:
  explicit MemberReader(const Json& json) : json_(json) {}
  template <class Value>
  void member(const char* key, Value& value) {
    read(json_.at(key), value);
  }

 private:
  static void read(const Json& json, double& value) {
    if (json.is_number()) {
      value = json.get<double>();
      return;
    }
    const auto text = json.get<std::string>();
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    if (text == "nan") {
      value = std::numeric_limits<double>::quiet_NaN();
    } else if (text == "inf" || text == "-inf") {
      value = text == "inf" ? kInfinity : -kInfinity;
    } else {
      throw std::invalid_argument(fmt::format("found \"{}\"; required: a number", text));
    }
  }
  static void read(const Json& json, std::string& text) { text = json.get<std::string>(); }
  static void read(const Json& json, bool& value) { value = json.get<bool>(); }
  static void read(const Json& json, Angle& angle) {
    double degrees = 0.0;
    read(json, degrees);
    angle = Angle::degrees(degrees);
  }
  static void read(const Json& json, RunPhase& phase) {
    const auto word = json.get<std::string>();
    for (int k = 0; k <= static_cast<int>(RunPhase::kParking); ++k) {
      phase = static_cast<RunPhase>(k);
      if (word == to_string(phase)) return;
    }
    throw std::invalid_argument(fmt::format("found phase \"{}\"; required: a phase of a run", word));
  }
  static void read(const Json& json, Eigen::Vector3d& v) {
    for (std::size_t j = 0; j < 3; ++j) read(json.at(j), v[static_cast<Eigen::Index>(j)]);
  }
  template <class Value>
  static void read(const Json& json, std::optional<Value>& value) {
    value.reset();
    if (!json.is_null()) read(json, value.emplace());
  }
  template <class Value>
  static void read(const Json& json, std::vector<Value>& list) {
    list.clear();
    for (const Json& each : json) read(each, list.emplace_back());
  }
  template <class Value>
  static void read(const Json& json, Value& value) {
    if constexpr (std::is_integral_v<Value>) {
      value = json.get<Value>();
    } else {
      MemberReader reader(json);
      visit_members(reader, value);
    }
  }

  const Json& json_;
};

template <class Structure, class Plain>
concept Like = std::is_same_v<std::remove_const_t<Structure>, Plain>;

template <class Visitor, Like<PlannedAngle> Planned>
void visit_members(Visitor& v, Planned& angle) {
  v.member("experiment", angle.experiment);
  v.member("n", angle.n);
  v.member("closing", angle.closing);
  v.member("alpha_deg", angle.alpha);
  v.member("x_deg", angle.x);
  v.member("z_deg", angle.z);
  v.member("check", angle.check);
}

template <class Visitor, Like<DwellRecord> Dwell>
void visit_members(Visitor& v, Dwell& dwell) {
  v.member("experiment", dwell.experiment);
  v.member("n", dwell.n);
  v.member("closing", dwell.closing);
  v.member("alpha_deg", dwell.alpha);
  v.member("commanded_x_deg", dwell.commanded_x);
  v.member("commanded_z_deg", dwell.commanded_z);
  v.member("encoder_x_deg", dwell.encoder_x);
  v.member("encoder_z_deg", dwell.encoder_z);
  v.member("time_s", dwell.time_s);
  v.member("settle_time_s", dwell.settle_time_s);
  v.member("count", dwell.count);
  v.member("lost", dwell.lost);
  v.member("mean", dwell.mean);
  v.member("spread", dwell.spread);
  v.member("u_mean", dwell.u_mean);
  v.member("temperature_degc", dwell.temperature_degc);
  v.member("flags", dwell.flags);
}

template <class Visitor, Like<ItemReading> Item>
void visit_members(Visitor& v, Item& item) {
  v.member("k", item.k);
  v.member("mean", item.mean);
  v.member("flags", item.flags);
  v.member("temperature_degc", item.temperature_degc);
}

template <class Visitor, Like<ItemSummary> Item>
void visit_members(Visitor& v, Item& item) {
  v.member("k", item.k);
  v.member("name", item.name);
  v.member("model", item.model);
  v.member("unit", item.unit);
  v.member("rate_hz", item.rate_hz);
  v.member("missing", item.missing);
  v.member("measured", item.measured);
}

template <class Visitor, Like<InstrumentSummary> Instrument>
void visit_members(Visitor& v, Instrument& instrument) {
  v.member("maker", instrument.maker);
  v.member("model", instrument.model);
  v.member("serial_number", instrument.serial_number);
}

template <class Visitor, Like<RunBeganEvent> Event>
void visit_members(Visitor& v, Event& event) {
  v.member("file", event.file);
  v.member("resumed", event.resumed);
  v.member("bench", event.bench);
  v.member("item", event.item);
  v.member("operator", event.operator_name);
  v.member("unit", event.unit);
  v.member("stage", event.stage);
  v.member("accelerometer", event.accelerometer);
  v.member("rate_hz", event.rate_hz);
  v.member("plan", event.plan);
  v.member("measured", event.measured);
  v.member("estimated_s", event.estimated_s);
  v.member("simulated_time", event.simulated_time);
  v.member("items", event.items);
}

template <class Visitor, Like<PhaseEvent> Event>
void visit_members(Visitor& v, Event& event) {
  v.member("position", event.position);
  v.member("phase", event.phase);
}

template <class Visitor, Like<DwellDoneEvent> Event>
void visit_members(Visitor& v, Event& event) {
  v.member("position", event.position);
  v.member("dwell", event.dwell);
  v.member("items", event.items);
}

/// Events that contain only a position in the plan.
template <class Event>
concept PositionOnly = Like<Event, AngleBegunEvent> || Like<Event, HeldEvent> || Like<Event, ContinuedEvent>;
template <class Visitor, PositionOnly Event>
void visit_members(Visitor& v, Event& event) {
  v.member("position", event.position);
}

/// Those that are a text for a person.
template <class Event>
concept TextOnly = Like<Event, FlagEvent> || Like<Event, PortLostEvent> || Like<Event, PortBackEvent>;
template <class Visitor, TextOnly Event>
void visit_members(Visitor& v, Event& event) {
  v.member("text", event.text);
}

template <class Visitor, Like<NoticeEvent> Event>
void visit_members(Visitor& v, Event& event) {
  v.member("kind", event.kind);
  v.member("text", event.text);
}

/// A note, asked for or stored.
template <class Note>
concept AnyNote = Like<Note, NoteStoredEvent> || Like<Note, NoteRequest>;
template <class Visitor, AnyNote Note>
void visit_members(Visitor& v, Note& note) {
  v.member("text", note.text);
  v.member("by", note.by);
}

template <class Visitor, Like<AllMeasuredEvent> Event>
void visit_members(Visitor& v, Event& event) {
  v.member("file", event.file);
}

template <class Visitor, Like<ReplayComparedEvent> Event>
void visit_members(Visitor& v, Event& event) {
  v.member("same", event.same);
  v.member("replayed", event.replayed);
  v.member("ended_alike", event.ended_alike);
  v.member("recorded_end", event.recorded_end);
}

template <class Visitor, Like<FinishedEvent> Event>
void visit_members(Visitor& v, Event& event) {
  v.member("file", event.file);
  v.member("complete", event.complete);
  v.member("verdict", event.verdict);
  v.member("reason", event.reason);
  v.member("measured", event.measured);
  v.member("planned", event.planned);
  v.member("measured_before", event.measured_before);
}

template <class Visitor, Like<StartRequest> Request>
void visit_members(Visitor& v, Request& request) {
  v.member("bench_toml", request.bench_toml);
  v.member("bench_file", request.bench_file);
  v.member("run_file", request.run_file);
  v.member("record", request.record);
}

template <class Visitor, Like<ResumeRequest> Request>
void visit_members(Visitor& v, Request& request) {
  v.member("run_file", request.run_file);
}

template <class Visitor, Like<ReplayRequest> Request>
void visit_members(Visitor& v, Request& request) {
  v.member("recorded_file", request.recorded_file);
  v.member("run_file", request.run_file);
}

/// Those that are their name.
template <class Request>
concept NameOnly = Like<Request, HoldRequest> || Like<Request, ContinueRequest> || Like<Request, StopRequest>;
template <class Visitor, NameOnly Request>
void visit_members(Visitor&, Request&) {}

/// @param key  Of the member that names the alternative.
template <class Variant>
Json write_variant(const Variant& variant, const char* key) {
  return std::visit(
      [&](const auto& alternative) {
        Json json = Json::object();
        json[key] = alternative.kName;
        MemberWriter writer(json);
        visit_members(writer, alternative);
        return json;
      },
      variant);
}

template <class Alternative, class Variant>
bool read_alternative(const Json& json, const std::string& name, std::optional<Variant>& found) {
  if (name != Alternative::kName) return false;
  Alternative alternative;
  MemberReader reader(json);
  visit_members(reader, alternative);
  found.emplace(std::move(alternative));
  return true;
}

template <class Variant, std::size_t... kIndices>
Variant read_variant(const Json& json, const char* key, std::index_sequence<kIndices...>) {
  try {
    const auto name = json.at(key).get<std::string>();
    std::optional<Variant> found;
    const bool known =
        (read_alternative<std::variant_alternative_t<kIndices, Variant>>(json, name, found) || ...);
    if (!known) throw std::invalid_argument(fmt::format("unknown name \"{}\"", name));
    return *std::move(found);
  } catch (const Json::exception& error) {
    throw std::invalid_argument(
        fmt::format("required: the JSON of one {} of a session; {}", key, error.what()));
  } catch (const std::invalid_argument& error) {
    throw std::invalid_argument(
        fmt::format("required: the JSON of one {} of a session; {}", key, error.what()));
  }
}

template <class Variant>
Variant read_variant(const Json& json, const char* key) {
  return read_variant<Variant>(json, key, std::make_index_sequence<std::variant_size_v<Variant>>());
}

}  // namespace

nlohmann::json to_json_object(const SessionEvent& event) {
  return write_variant(event, "event");
}

nlohmann::json to_json_object(const SessionRequest& request) {
  return write_variant(request, "request");
}

SessionEvent event_from_json(const nlohmann::json& json) {
  return read_variant<SessionEvent>(json, "event");
}

SessionRequest request_from_json(const nlohmann::json& json) {
  return read_variant<SessionRequest>(json, "request");
}

}  // namespace abcal
