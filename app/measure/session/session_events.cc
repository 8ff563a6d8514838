#include "app/measure/session/session_events.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <type_traits>
#include <utility>

#include "protocol/record/message_json.h"

namespace abcal {
namespace {

using Json = nlohmann::json;

Json json_of(double value) {
  if (std::isfinite(value)) return value;
  if (std::isnan(value)) return "nan";
  return value > 0.0 ? "inf" : "-inf";
}

Json json_of(Angle angle) {
  return json_of(angle.deg());
}

Json json_of(const Eigen::Vector3d& v) {
  return Json::array({json_of(v[0]), json_of(v[1]), json_of(v[2])});
}

Json json_of(int number) {
  return number;
}

Json json_of(const Message& message) {
  return message.english();
}

template <class Value>
Json json_of(const std::optional<Value>& value) {
  return value ? json_of(*value) : Json(nullptr);
}

Json json_of(const PlannedAngle& angle) {
  return {{"experiment", angle.experiment}, {"n", angle.n},
          {"closing", angle.closing},       {"alpha_deg", json_of(angle.alpha)},
          {"x_deg", json_of(angle.x)},      {"z_deg", json_of(angle.z)},
          {"check", angle.check},           {"face", angle.face}};
}

Json json_of(const DwellRecord& dwell) {
  return {{"experiment", dwell.experiment},
          {"face", dwell.face},
          {"n", dwell.n},
          {"closing", dwell.closing},
          {"alpha_deg", json_of(dwell.alpha)},
          {"commanded_x_deg", json_of(dwell.commanded_x)},
          {"commanded_z_deg", json_of(dwell.commanded_z)},
          {"encoder_x_deg", json_of(dwell.encoder_x)},
          {"encoder_z_deg", json_of(dwell.encoder_z)},
          {"time_s", json_of(dwell.time_s)},
          {"settle_time_s", json_of(dwell.settle_time_s)},
          {"count", dwell.count},
          {"lost", dwell.lost},
          {"mean", json_of(dwell.mean)},
          {"spread", json_of(dwell.spread)},
          {"u_mean", json_of(dwell.u_mean)},
          {"temperature_degc", json_of(dwell.temperature_degc)},
          {"flags", dwell.flags}};
}

Json json_of(const DwellDoneEvent& event) {
  Json items = Json::array();  // Empty where item 1 is the only one: the dwell is its own.
  if (event.dwells.size() > 1 || event.first_item() != 1)
    for (const auto& [item, dwell] : event.dwells)
      items.push_back({{"k", item},
                       {"mean", json_of(dwell.mean)},
                       {"flags", dwell.flags},
                       {"temperature_degc", json_of(dwell.temperature_degc)}});
  return {{"position", event.position}, {"dwell", json_of(event.first())}, {"items", std::move(items)}};
}

Json json_of(const ItemSummary& item) {
  return {{"k", item.k},
          {"name", item.name},
          {"model", item.model},
          {"unit", item.unit},
          {"rate_hz", json_of(item.rate_hz)},
          {"missing", json_of(item.missing)},
          {"measured", item.measured}};
}

Json json_of(const InstrumentSummary& instrument) {
  return {
      {"maker", instrument.maker}, {"model", instrument.model}, {"serial_number", instrument.serial_number}};
}

template <class Value>
Json list_of(const std::vector<Value>& values) {
  Json list = Json::array();
  for (const Value& value : values) list.push_back(json_of(value));
  return list;
}

Json json_of(const RunBeganEvent& event) {
  return {{"file", event.file},
          {"resumed", event.resumed},
          {"bench", event.bench},
          {"item", event.item},
          {"operator", event.operator_name},
          {"unit", event.unit},
          {"stage", json_of(event.stage)},
          {"accelerometer", json_of(event.accelerometer)},
          {"rate_hz", json_of(event.rate_hz)},
          {"plan", list_of(event.plan)},
          {"measured", list_of(event.measured)},
          {"estimated_s", json_of(event.estimated_s)},
          {"simulated_time", event.simulated_time},
          {"simulated", event.simulated},
          {"items", list_of(event.items)}};
}

Json json_of(const PhaseEvent& event) {
  return {{"position", event.position}, {"phase", to_string(event.phase)}};
}

/// Events that contain only a position in the plan.
template <class Event>
concept PositionOnly = std::is_same_v<Event, AngleBegunEvent> || std::is_same_v<Event, HeldEvent> ||
    std::is_same_v<Event, ContinuedEvent>;
template <PositionOnly Event>
Json json_of(const Event& event) {
  return {{"position", event.position}};
}

Json json_of(const FlagEvent& event) {
  return {{"text", json_of(event.text)}, {"item", json_of(event.item)}};
}

Json json_of(const PortLostEvent& event) {
  return {{"text", json_of(event.text)}};
}

Json json_of(const PortBackEvent& event) {
  return {{"text", json_of(event.text)}};
}

Json json_of(const NoticeEvent& event) {
  return {{"kind", event.kind}, {"text", json_of(event.text)}, {"item", json_of(event.item)}};
}

Json json_of(const NoteStoredEvent& event) {
  return {{"text", event.text}, {"by", event.by}};
}

Json json_of(const AllMeasuredEvent& event) {
  return {{"file", event.file}};
}

Json json_of(const ReplayComparedEvent& event) {
  return {{"same", event.same},
          {"replayed", event.replayed},
          {"ended_alike", event.ended_alike},
          {"recorded_end", event.recorded_end}};
}

Json json_of(const FinishedEvent& event) {
  return {{"file", event.file},
          {"complete", event.complete},
          {"verdict", event.verdict},
          {"reason", json_of(event.reason)},
          {"measured", event.measured},
          {"planned", event.planned},
          {"measured_before", event.measured_before}};
}

/// The messages of an event, whose texts it has.
struct MessagesOf {
  using Messages = std::vector<Message>;
  Messages operator()(const FinishedEvent& event) const { return {event.reason}; }
  Messages operator()(const RunBeganEvent& event) const {
    Messages all;
    for (const ItemSummary& item : event.items) all.push_back(item.missing);
    return all;
  }
  template <class Event>
  requires std::is_same_v<decltype(Event::text), Message> Messages operator()(const Event& event) const {
    return {event.text};
  }
  template <class Event>
  Messages operator()(const Event&) const {
    return {};
  }
};

}  // namespace

nlohmann::json to_json_object(const SessionEvent& event) {
  return std::visit(
      [](const auto& alternative) {
        Json json = json_of(alternative);
        json["event"] = alternative.kName;
        if (const Json messages = messages_json(MessagesOf{}(alternative)); !messages.empty())
          json["messages"] = messages;
        return json;
      },
      event);
}

}  // namespace abcal
