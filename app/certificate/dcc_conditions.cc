#include "app/certificate/dcc_conditions.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <functional>

#include "app/certificate/dcc_text.h"
#include "app/certificate/dsi_list.h"
#include "app/certificate/traceability.h"

namespace abcal {
namespace {

constexpr double kKelvinAtZeroCelsius = 273.15;

struct Range {
  double low, high;
};

/// Smallest and largest of what is there.
template <class Rows>
std::optional<Range> range_of(
    const Rows& rows, const std::function<std::optional<double>(const typename Rows::value_type&)>& value) {
  std::optional<Range> range;
  for (const auto& row : rows) {
    const std::optional<double> found = value(row);
    if (!found) continue;
    if (!range) range = Range{*found, *found};
    range->low = std::min(range->low, *found);
    range->high = std::max(range->high, *found);
  }
  return range;
}

XmlElement add_condition(XmlElement& conditions, const std::string& ref_type, const std::string& name) {
  XmlElement condition = conditions.add("dcc:influenceCondition");
  condition.attribute("refType", ref_type);
  add_words(condition, "dcc:name", name);
  return condition;
}

void add_real(XmlElement& parent, double value, const std::string& unit, const std::string& what) {
  XmlElement real = parent.add("si:real");
  real.add("si:value", dsi_number(value, what));
  real.add("si:unit", unit);
}

void add_bound(XmlElement& data, const std::string& ref_type, const std::string& name, double value,
               const std::string& unit) {
  XmlElement quantity = data.add("dcc:quantity");
  quantity.attribute("refType", ref_type);
  add_words(quantity, "dcc:name", name);
  if (unit != "\\degreecelsius") return add_real(quantity, value, unit, name);
  XmlElement both = quantity.add("si:hybrid");
  add_real(both, value + kKelvinAtZeroCelsius, "\\kelvin", name);
  add_real(both, value, unit, name);
}

void add_range(XmlElement& conditions, const std::string& ref_type, const std::string& name,
               const std::optional<Range>& range, const std::string& unit) {
  if (!range) return;
  XmlElement condition = add_condition(conditions, ref_type, name);
  XmlElement data = condition.add("dcc:data");
  add_bound(data, ref_type + "Min", "smallest", range->low, unit);
  add_bound(data, ref_type + "Max", "largest", range->high, unit);
}

void add_gravity(XmlElement& conditions, const Certificate& certificate, const CalibrationResult& result) {
  XmlElement condition = add_condition(conditions, "abc_localGravity", "Local acceleration of gravity g_loc");
  std::string source = "Source: " + (result.g_loc_source.empty() ? "not stated" : result.g_loc_source);
  if (!certificate.laboratory.laboratory.gravity_site.empty())
    source += "; holds at: " + certificate.laboratory.laboratory.gravity_site;
  add_words(condition, "dcc:description", source);
  XmlElement data = condition.add("dcc:data");
  XmlElement quantity = data.add("dcc:quantity");
  quantity.attribute("refType", "abc_localGravity");
  add_value(quantity, result.g_loc, "local gravity");
}

void add_text(XmlElement& parent, const std::string& text) {
  XmlElement data = parent.add("dcc:data");
  add_words(data, "dcc:text", text);
}

XmlElement add_metadatum(XmlElement& list, const std::string& ref_type, const std::string& name) {
  XmlElement metadatum = list.add("dcc:metaData");
  metadatum.attribute("refType", ref_type);
  add_words(metadatum, "dcc:name", name);
  return metadatum;
}

void add_instrument(XmlElement& list, const InstrumentIdentity& instrument) {
  XmlElement equipment = list.add("dcc:measuringEquipment");
  equipment.attribute("refType", "abc_" + instrument.role);
  add_words(equipment, "dcc:name", "Instrument used as " + instrument.role + ", as it identified itself");
  add_words(equipment, "dcc:description",
            fmt::format("firmware {}; {}", instrument.firmware.empty() ? "not reported" : instrument.firmware,
                        instrument.details));
  if (!one_line(instrument.maker).empty()) {
    XmlElement manufacturer = equipment.add("dcc:manufacturer");
    add_name(manufacturer, "dcc:name", instrument.maker);
  }
  add_line(equipment, "dcc:model", instrument.model);
  XmlElement identifications = equipment.add("dcc:identifications");
  add_identification(identifications, "manufacturer", instrument.serial_number, "Serial number");
}

void add_calibrated(XmlElement& list, const Equipment& from) {
  XmlElement equipment = list.add("dcc:measuringEquipment");
  equipment.attribute("refType", from.quantity == "angle" ? "basic_standardUsed" : "abc_equipment");
  add_name(equipment, "dcc:name", from.name);
  add_words(equipment, "dcc:description",
            fmt::format("Calibrated in {}; certificate {} of {}, performed {}, valid until {}.",
                        from.quantity, one_line(from.certificate), one_line(from.certificate_issuer),
                        from.performed ? format_date(*from.performed) : "not stated",
                        from.due ? format_date(*from.due) : "not stated"));
  if (!from.certificate_sha256.empty())
    add_hash(equipment, "dcc:certificate", "Calibration certificate of " + one_line(from.name),
             from.certificate, from.certificate_sha256);
  if (!one_line(from.maker).empty()) {
    XmlElement manufacturer = equipment.add("dcc:manufacturer");
    add_name(manufacturer, "dcc:name", from.maker);
  }
  add_line(equipment, "dcc:model", from.model);
  XmlElement identifications = equipment.add("dcc:identifications");
  add_identification(identifications, "manufacturer", from.serial_number, "Serial number");
  add_identification(identifications, "other", from.certificate, "Calibration certificate");
}

}  // namespace

void add_methods(XmlElement& measurement, const Certificate& certificate, const ReportData& data) {
  XmlElement methods = measurement.add("dcc:usedMethods");
  XmlElement protocol = methods.add("dcc:usedMethod");
  protocol.attribute("refType", "abc_protocol");
  add_words(protocol, "dcc:name", "ABC protocol: three rotation experiments in gravity");
  add_words(
      protocol, "dcc:description",
      "The accelerometer is turned about the two axes of a rotation stage; at each angle the outputs are "
      "averaged. The sensitivity matrix and the offsets follow from the harmonic parts of the outputs, the "
      "intrinsic properties from the rows of the matrix.");
  add_line(protocol, "dcc:reference", "doi:10.6028/jres.126.038");
  if (!certificate.laboratory.job.procedure.empty())
    add_line(protocol, "dcc:reference",
             "Procedure of the laboratory: " + certificate.laboratory.job.procedure);
  XmlElement settings = protocol.add("dcc:usedMethodQuantities");
  const auto add = [&](const std::string& ref_type, const std::string& name, double value,
                       const std::string& unit) {
    XmlElement quantity = settings.add("dcc:usedMethodQuantity");
    quantity.attribute("refType", ref_type);
    add_words(quantity, "dcc:name", name);
    add_real(quantity, value, unit, name);
  };
  add("abc_steps", "Angles of each experiment", data.record.steps, "\\one");
  add("abc_step", "Rotation step", data.record.step.deg(), "\\degree");
  if (data.bench) {
    add("abc_settle", "Wait from standstill to the first reading", data.bench->protocol.settle_s, "\\second");
    add("abc_dwell", "Readings averaged at each angle", data.bench->protocol.dwell_readings, "\\one");
    add("abc_warmUp", "Warm-up before the first angle", data.bench->protocol.warm_up_s, "\\second");
  }
  XmlElement uncertainty = methods.add("dcc:usedMethod");
  uncertainty.attribute("refType", "basic_uncertainty");
  add_words(uncertainty, "dcc:name", "Uncertainty of measurement");
  add_words(
      uncertainty, "dcc:description",
      "Type A from the scatter of the readings, type B from the stage's tolerances, the resolution and the "
      "drift, propagated to first order with all correlations.");
  add_line(uncertainty, "dcc:norm", "JCGM 100:2008");
  add_line(uncertainty, "dcc:norm", "JCGM 102:2011");
}

void add_used_software(XmlElement& measurement, const Certificate& certificate, const ReportData& data) {
  XmlElement software = measurement.add("dcc:usedSoftware");
  add_software(software, "abcal, analysis", certificate.program_version);
  if (data.run) add_software(software, "abcal, measurement", data.run->header.program_version);
}

void add_equipment(XmlElement& measurement, const Certificate& certificate, const ReportData& data) {
  XmlElement list = measurement.add("dcc:measuringEquipments");
  for (const Equipment& equipment : certificate.laboratory.equipment) add_calibrated(list, equipment);
  for (const InstrumentIdentity& instrument : data.run->header.instruments)
    if (!instrument.role.starts_with("accelerometer")) add_instrument(list, instrument);
}

void add_conditions(XmlElement& measurement, const Certificate& certificate, const ReportData& data,
                    const ItemState& state) {
  XmlElement conditions = measurement.add("dcc:influenceConditions");
  const auto& room = data.run->environment;
  // An observation is what an instrument said; a typed-in value is what the operator stated.
  const std::string room_by = is_environment_stated(data) ? ", stated by the operator" : "";
  const auto look = [&](std::optional<double> StoredEnvironment::*member) {
    return range_of(room, [member](const StoredEnvironment& row) { return row.*member; });
  };
  add_range(conditions, "basic_temperature", "Temperature of the room" + room_by,
            look(&StoredEnvironment::temperature_degc), "\\degreecelsius");
  add_range(conditions, "basic_humidityRelative", "Relative humidity of the room" + room_by,
            look(&StoredEnvironment::humidity_percent), "\\percent");
  add_range(conditions, "abc_pressure", "Pressure of the air" + room_by,
            look(&StoredEnvironment::pressure_hpa), "\\hecto\\pascal");
  add_range(conditions, "abc_itemTemperature", "Temperature of the item, by its own sensor",
            range_of(data.record.dwells, [](const DwellRecord& dwell) { return dwell.temperature_degc; }),
            "\\degreecelsius");
  add_gravity(conditions, certificate, data.result());
  if (!state.status.empty()) {
    XmlElement condition = add_condition(conditions, "abc_itemState", "State of the item");
    condition.add("dcc:status", state.status);
    add_text(condition, "The item " + state.words + ". Adjustment: " + certificate.laboratory.job.adjustment);
  }
}

void add_metadata(XmlElement& measurement, const ReportData& data) {
  XmlElement list = measurement.add("dcc:measurementMetaData");
  const auto add = [&](const std::string& ref_type, const std::string& name, const std::string& text) {
    XmlElement metadatum = add_metadatum(list, ref_type, name);
    add_text(metadatum, text);
  };
  add("abc_rawDataHash", "SHA-256 of the raw data", data.sha256.value_or("none: the run is not closed"));
  add("abc_rawData", "File of the raw data", data.path.filename().string());
  add("abc_period", "Measured, UTC", data.started_utc() + " to " + data.ended_utc());
  const CalibrationResult& result = data.result();
  add("abc_estimator", "Estimator", result.estimator);
  add("abc_verdict", "Verdict of the analysis", fmt::format("{}: {}", to_string(result.verdict), result.why));
  for (const std::string& note : result.diagnostics.notes) add("abc_note", "Note of the analysis", note);
}

}  // namespace abcal
