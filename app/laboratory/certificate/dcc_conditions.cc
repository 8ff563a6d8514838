#include "app/laboratory/certificate/dcc_conditions.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>

#include "app/bench_file/not_real.h"
#include "app/laboratory/certificate/certified_record.h"
#include "app/laboratory/certificate/dcc_rates.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/traceability.h"
#include "app/laboratory/register/records.h"
#include "app/results/analysis/held_out_words.h"
#include "protocol/plan/effect_sizes.h"
#include "protocol/plan/faces.h"
#include "protocol/record/run_label.h"

namespace abcal {
namespace {

constexpr double kKelvinAtZeroCelsius = 273.15;

struct Range {
  double low, high;
};

/// Smallest and largest of the existing values in any of the runs.
template <class Row>
std::optional<Range> range_of(const std::vector<const ReportData*>& runs,
                              const std::function<const std::vector<Row>&(const ReportData&)>& rows,
                              const std::function<std::optional<double>(const Row&)>& value) {
  std::optional<Range> range;
  for (const ReportData* data : runs) {
    for (const Row& row : rows(*data)) {
      const std::optional<double> found = value(row);
      if (!found) continue;
      if (!range) range = Range{*found, *found};
      range->low = std::min(range->low, *found);
      range->high = std::max(range->high, *found);
    }
  }
  return range;
}

XmlElement add_condition(XmlElement& conditions, const std::string& ref_type, const Wording& name) {
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

void add_bound(XmlElement& data, const std::string& ref_type, const Wording& name, double value,
               const std::string& unit) {
  XmlElement quantity = data.add("dcc:quantity");
  quantity.attribute("refType", ref_type);
  add_words(quantity, "dcc:name", name);
  if (unit != "\\degreecelsius") return add_real(quantity, value, unit, name.text);
  XmlElement both = quantity.add("si:hybrid");
  add_real(both, value + kKelvinAtZeroCelsius, "\\kelvin", name.text);
  add_real(both, value, unit, name.text);
}

/// A quantity of the surroundings: its refType, name and unit of D-SI.
struct ConditionKind {
  std::string ref_type;
  Wording name;
  std::string unit;
};

/// Rounded to a thousandth of its unit: a finer step than instruments for the surroundings have.
double shown_condition(double value) {
  return std::round(value * 1e3) / 1e3;
}

void add_range(XmlElement& conditions, const Words& words, const ConditionKind& kind,
               const std::optional<Range>& range) {
  if (!range) return;
  XmlElement condition = add_condition(conditions, kind.ref_type, kind.name);
  XmlElement data = condition.add("dcc:data");
  add_bound(data, kind.ref_type + "Min", words("smallest"), shown_condition(range->low), kind.unit);
  add_bound(data, kind.ref_type + "Max", words("largest"), shown_condition(range->high), kind.unit);
}

void add_gravity(XmlElement& conditions, const Certificate& certificate, const CalibrationResult& result) {
  const Words& words = certificate.words;
  XmlElement condition =
      add_condition(conditions, "abc_localGravity", words("Local acceleration of gravity g_loc"));
  const std::string source = result.g_loc_source.empty() ? words("not stated").text : result.g_loc_source;
  const std::string& site = certificate.laboratory.laboratory.gravity_site;
  add_words(condition, "dcc:description",
            site.empty() ? words("Source: {source}", source)
                         : words("Source: {source}; holds at: {place}", source, site));
  XmlElement data = condition.add("dcc:data");
  XmlElement quantity = data.add("dcc:quantity");
  quantity.attribute("refType", "abc_localGravity");
  add_value(quantity, result.g_loc, "local gravity");
}

void add_instrument(XmlElement& list, const Words& words, const InstrumentIdentity& instrument,
                    const RunHeader& header) {
  XmlElement equipment = list.add("dcc:measuringEquipment");
  equipment.attribute("refType", "abc_" + instrument.role);
  add_words(equipment, "dcc:name",
            words("Instrument used as {role}, as it identified itself", word_of(kRoles, instrument.role)));
  std::string details = instrument.details;
  const std::string stated = label_of(header.labels, stated_serial_number_label(instrument.role));
  if (const std::string end = stated_serial_number_words(stated); details.ends_with(end))
    details.resize(details.size() - end.size());
  Wording description =
      words("firmware {firmware}; {driver}",
            instrument.firmware.empty() ? words("not reported").text : instrument.firmware, details);
  if (!stated.empty())
    description.text += "; " + words("serial number {serial_number} (stated, not read)", stated).text;
  add_words(equipment, "dcc:description", description);
  if (!one_line(instrument.maker).empty()) {
    XmlElement manufacturer = equipment.add("dcc:manufacturer");
    add_name(manufacturer, "dcc:name", instrument.maker);
  }
  add_line(equipment, "dcc:model", instrument.model);
  if (one_line(instrument.serial_number).empty()) return;
  XmlElement identifications = equipment.add("dcc:identifications");
  add_identification(identifications, "manufacturer", instrument.serial_number, words("Serial number"));
}

void add_calibrated(XmlElement& list, const Words& words, const Equipment& from) {
  XmlElement equipment = list.add("dcc:measuringEquipment");
  equipment.attribute("refType", from.quantity == "angle"                     ? "basic_standardUsed"
                                 : from.quantity == lab::kStageRecordQuantity ? "abc_stageRecord"
                                                                              : "abc_equipment");
  add_name(equipment, "dcc:name", from.name);
  const bool is_record = from.quantity == lab::kStageRecordQuantity;
  const std::string certificate = one_line(from.certificate), issuer = one_line(from.certificate_issuer);
  add_words(
      equipment, "dcc:description",
      is_record
          ? words("Errors of the stage, measured by the laboratory: record {certificate}, approved by "
                  "{issuer} on {performed}, valid until {due}.",
                  certificate, issuer, date_words(from.performed), date_words(from.due))
          : words("Calibrated in {quantity}; certificate {certificate} of {issuer}, performed {performed}, "
                  "valid until {due}.",
                  word_of(kQuantities, from.quantity), certificate, issuer, date_words(from.performed),
                  date_words(from.due)));
  if (!from.certificate_sha256.empty())
    add_hash(equipment, "dcc:certificate",
             is_record ? words("Record of the stage")
                       : words("Calibration certificate of {quantity}", one_line(from.name)),
             from.certificate, from.certificate_sha256);
  if (!one_line(from.maker).empty()) {
    XmlElement manufacturer = equipment.add("dcc:manufacturer");
    add_name(manufacturer, "dcc:name", from.maker);
  }
  add_line(equipment, "dcc:model", from.model);
  XmlElement identifications = equipment.add("dcc:identifications");
  add_identification(identifications, "manufacturer", from.serial_number, words("Serial number"));
  add_identification(identifications, "other", from.certificate, words("Calibration certificate"));
  add_identification(identifications, "other", from.certificate_issuer, words("Issuer of the certificate"));
  add_identification(identifications, "other", words(word_of(kQuantities, from.quantity)).text,
                     words("Traceable quantity"));
  if (from.performed)
    add_identification(identifications, "other", format_date(*from.performed), words("Calibrated on"));
  if (from.due) add_identification(identifications, "other", format_date(*from.due), words("Valid until"));
}

void add_setting(XmlElement& settings, const std::string& ref_type, const Wording& name, double value,
                 const std::string& unit) {
  XmlElement quantity = settings.add("dcc:usedMethodQuantity");
  quantity.attribute("refType", ref_type);
  add_words(quantity, "dcc:name", name);
  add_real(quantity, value, unit, name.text);
}

/// Rates of the sweeps, each once, in the order of the plan.
void add_rates(XmlElement& settings, const Words& words, const ProtocolConfig& protocol) {
  std::vector<double> added;
  for (const double rate : protocol.rate_deg_per_s) {
    if (std::find(added.begin(), added.end(), rate) != added.end()) continue;
    added.push_back(rate);
    add_setting(settings, "abc_rate", words("Rate of the turn"), rate, kDegreesPerSecond);
  }
  add_setting(settings, "abc_sweeps", words("Sweeps of each experiment"), protocol.sweeps, "\\one");
  add_setting(settings, "abc_stops", words("Dwells at rest in each experiment"), protocol.stops, "\\one");
}

/// The three experiments and their settings.
void add_protocol(XmlElement& methods, const Certificate& certificate, const ReportData& data) {
  const Words& words = certificate.words;
  XmlElement protocol = methods.add("dcc:usedMethod");
  protocol.attribute("refType", "abc_protocol");
  add_words(protocol, "dcc:name", words("ABC protocol: three rotation experiments in gravity"));
  const bool turns = is_at_constant_rate(data.record);
  add_words(protocol, "dcc:description",
            turns ? words("The accelerometer is turned about the two axes of a rotation stage at constant "
                          "rates, so that gravity becomes a sine, and its outputs are read on the way. The "
                          "sensitivity matrix and the offsets at rest, and the response at each rate, follow "
                          "by least squares from the outputs and the angles that the encoders tell, the "
                          "intrinsic properties from the rows of the matrix.")
                  : words("The accelerometer is turned about the two axes of a rotation stage; at each angle "
                          "the outputs are averaged. The sensitivity matrix and the offsets follow from the "
                          "outputs by least squares, the intrinsic properties from the rows of the matrix."));
  add_line(protocol, "dcc:reference", "doi:10.6028/jres.126.038");
  if (turns) add_line(protocol, "dcc:reference", "Gaitan, Geist, Measurement 189 (2022), 110528");
  if (!certificate.laboratory.job.procedure.empty())
    add_line(protocol, "dcc:reference",
             words("Procedure of the laboratory: {procedure}", certificate.laboratory.job.procedure).text);
  XmlElement settings = protocol.add("dcc:usedMethodQuantities");
  const auto add = [&](const std::string& ref_type, const Wording& name, double value,
                       const std::string& unit) { add_setting(settings, ref_type, name, value, unit); };
  add("abc_steps", words("Angles of each experiment"), data.record.steps, "\\one");
  if (has_two_faces(data.record))
    add("abc_faces", words("Faces, in each of which half of the angles are measured"), kFaces, "\\one");
  add("abc_step", words("Rotation step"), data.record.step.deg(), "\\degree");
  if (!data.bench) return;
  const ProtocolConfig& settled = data.bench->protocol;
  if (turns) {
    add_rates(settings, words, settled);
    add("abc_warmUp", words("Warm-up before the first angle"), settled.warm_up_s, "\\second");
    return;
  }
  if (settled.settle_auto) {
    add("abc_settle", words("Least wait from standstill to the first reading, ended by the outputs"),
        data.settle_times_s().first, "\\second");
  } else {
    add("abc_settle", words("Wait from standstill to the first reading"), settled.settle_s, "\\second");
  }
  add("abc_dwell", words("Readings averaged at each angle"), settled.dwell_readings, "\\one");
  add("abc_warmUp", words("Warm-up before the first angle"), settled.warm_up_s, "\\second");
}

void add_estimator(XmlElement& methods, const Words& words, const ReportData& data) {
  XmlElement estimator = methods.add("dcc:usedMethod");
  estimator.attribute("refType", "abc_estimator");
  add_words(estimator, "dcc:name", words("Estimator: {estimator}", data.estimator));
  Wording description =
      data.estimator == kPublishedEstimator
          ? words(
                "The protocol as published: harmonic fits of each experiment. It was declared before "
                "the first angle was measured, or is that of runs without a declaration.")
      : data.is_of_several_runs()
          ? words(
                "One least-squares fit of the readings of several runs with the errors of the stage as "
                "unknowns, which are common to the runs.")
          : words(
                "One least-squares fit of all readings with the errors of the stage as unknowns. It "
                "was declared before the first angle was measured.");
  if (data.result().stage_record)
    description.text += " " + words("The record of the stage is their prior.").text;
  add_words(estimator, "dcc:description", description);
}

/// Unit of a size, in D-SI.
std::string unit_of_effect(std::string_view unit) {
  if (unit == "urad") return "\\micro\\radian";
  if (unit == "radian") return "\\radian";
  if (unit == "degree") return "\\degree";
  if (unit == "s") return "\\second";
  if (unit == "mm") return "\\milli\\metre";
  if (unit == "1") return "\\one";
  throw std::logic_error(fmt::format("a size in {}, which has no unit of D-SI here", unit));
}

/// Effects beyond a perfect stage and a linear item, with their assumed sizes and the sources of these.
void add_effects(XmlElement& uncertainty, const Words& words, const EffectSizes& sizes) {
  XmlElement effects = uncertainty.add("dcc:usedMethodQuantities");
  for (const EffectSizeKey& key : effect_size_keys()) {
    // An effect that nobody stated and that is not in the fit does not apply.
    if (!(key.get(sizes) > 0.0) && !sizes.sources.contains(key.key)) continue;
    XmlElement effect = effects.add("dcc:usedMethodQuantity");
    effect.attribute("refType", "abc_effect");
    add_words(effect, "dcc:name", words(key.words));
    const auto source = sizes.sources.find(key.key);
    add_words(effect, "dcc:description",
              source == sizes.sources.end() ? words("Standard uncertainty; a default that nobody stated")
                                            : words("Standard uncertainty; source: {source}",
                                                    source_words(words, source->second).text));
    add_real(effect, key.get(sizes), unit_of_effect(key.unit), std::string(key.words));
  }
}

/// |a| on held-out poses: a check of the stated uncertainties, and no result.
void add_held_out_norm(XmlElement& list, const Words& words, const HeldOutNorm& norm) {
  XmlElement metadatum =
      add_metadatum(list, "abc_heldOutNorm", words("Check of U: magnitude of a on held-out poses"));
  add_words(metadatum, "dcc:description", words(held_out_words(norm)));
  XmlElement data = metadatum.add("dcc:data");
  const auto add = [&](const std::string& ref_type, const Wording& name, double value) {
    XmlElement quantity = data.add("dcc:quantity");
    quantity.attribute("refType", ref_type);
    add_words(quantity, "dcc:name", name);
    // The digits of the sentence.
    add_real(quantity, std::stod(fmt::format("{:.1e}", value)), "\\one", name.text);
  };
  add("abc_heldOutRms", words("root mean square of |a|/g_loc - 1"), norm.rms);
  add("abc_heldOutRmsOfModel", words("the same by the fitted model of the item"), norm.rms_of_model);
  add("abc_heldOutRmsExpected", words("expected of it by the stated uncertainties"), norm.rms_expected);
}

}  // namespace

XmlElement add_methods(XmlElement& measurement, const Certificate& certificate, const ReportData& data) {
  const Words& words = certificate.words;
  XmlElement methods = measurement.add("dcc:usedMethods");
  add_protocol(methods, certificate, data);
  add_estimator(methods, words, data);
  XmlElement uncertainty = methods.add("dcc:usedMethod");
  uncertainty.attribute("refType", "basic_uncertainty");
  add_words(uncertainty, "dcc:name", words("Uncertainty of measurement"));
  add_words(uncertainty, "dcc:description",
            words("Type A from the scatter of the readings, type B from the effects of stage and item listed "
                  "here, propagated to first order with all correlations."));
  add_line(uncertainty, "dcc:norm", "JCGM 100:2008");
  add_line(uncertainty, "dcc:norm", "JCGM 102:2011");
  add_effects(uncertainty, words, sizes_behind(data));
  return methods;
}

void add_used_software(XmlElement& measurement, const Certificate& certificate, const ReportData& data) {
  const Words& words = certificate.words;
  XmlElement software = measurement.add("dcc:usedSoftware");
  add_software(software, words, words("abcal, analysis").text, certificate.program_version);
  if (data.run)
    add_software(software, words, words("abcal, measurement").text, data.run->header.program_version);
}

void add_equipment(XmlElement& measurement, const Certificate& certificate, const ReportData& data) {
  XmlElement list = measurement.add("dcc:measuringEquipments");
  for (const Equipment& equipment : certificate.laboratory.equipment)
    if (belongs_to(equipment, data.result())) add_calibrated(list, certificate.words, equipment);
  for (const InstrumentIdentity& instrument : data.run->header.instruments)
    if (!instrument.role.starts_with("accelerometer"))
      add_instrument(list, certificate.words, instrument, data.run->header);
}

void add_conditions(XmlElement& measurement, const Certificate& certificate,
                    const std::vector<const ReportData*>& runs, const ItemState& state) {
  const Words& words = certificate.words;
  XmlElement conditions = measurement.add("dcc:influenceConditions");
  // An observation comes from an instrument; a typed-in value is a statement of the operator.
  const bool stated = std::any_of(runs.begin(), runs.end(),
                                  [](const ReportData* data) { return is_environment_stated(*data); });
  const auto look = [&](std::optional<double> StoredEnvironment::*member) {
    return range_of<StoredEnvironment>(
        runs,
        [](const ReportData& data) -> const std::vector<StoredEnvironment>& { return data.run->environment; },
        [member](const StoredEnvironment& row) { return row.*member; });
  };
  add_range(
      conditions, words,
      {"basic_temperature",
       stated ? words("Temperature of the room, stated by the operator") : words("Temperature of the room"),
       "\\degreecelsius"},
      look(&StoredEnvironment::temperature_degc));
  add_range(conditions, words,
            {"basic_humidityRelative",
             stated ? words("Relative humidity of the room, stated by the operator")
                    : words("Relative humidity of the room"),
             "\\percent"},
            look(&StoredEnvironment::humidity_percent));
  add_range(conditions, words,
            {"abc_pressure",
             stated ? words("Pressure of the air, stated by the operator") : words("Pressure of the air"),
             "\\hecto\\pascal"},
            look(&StoredEnvironment::pressure_hpa));
  add_range(
      conditions, words,
      {"abc_itemTemperature", words("Temperature of the item, by its own sensor"), "\\degreecelsius"},
      range_of<DwellRecord>(
          runs, [](const ReportData& data) -> const std::vector<DwellRecord>& { return data.record.dwells; },
          [](const DwellRecord& dwell) { return dwell.temperature_degc; }));
  add_gravity(conditions, certificate, runs.front()->result());
  if (state.status.empty()) return;
  XmlElement condition = add_condition(conditions, "abc_itemState", words("State of the item"));
  condition.add("dcc:status", state.status);
  add_text(condition, words("The item {state}. Adjustment: {adjustment}", state.words,
                            certificate.laboratory.job.adjustment));
}

void add_metadata(XmlElement& measurement, const Certificate& certificate, const CertifiedRun& certified) {
  const ReportData& data = certified.data;
  const Words& words = certificate.words;
  XmlElement list = measurement.add("dcc:measurementMetaData");
  const auto add = [&](const std::string& ref_type, const Wording& name, const Wording& text) {
    XmlElement metadatum = add_metadatum(list, ref_type, name);
    add_text(metadatum, text);
  };
  add("abc_rawDataHash", words("SHA-256 of the raw data"),
      data.sha256 ? words.as_given(*data.sha256) : words("none: the run is not closed"));
  add("abc_rawData", words("File of the raw data"), words.as_given(data.path.filename().string()));
  if (data.is_of_several_runs())
    for (const ReportData& run : certified.together) {
      XmlElement metadatum = add_metadatum(list, "abc_runHash", words("SHA-256 of a run of the measurement"));
      add_words(metadatum, "dcc:description", words.as_given(run.path.filename().string()));
      add_text(metadatum, words.as_given(run.sha256.value_or("")));
    }
  const auto [from, to] = period_of(runs_of_result(certified.together, data));
  add("abc_period", words("Measured, UTC"), words("{from} to {to}", from, to));
  const CalibrationResult& result = data.result();
  if (result.stage_record) {
    XmlElement tests = add_metadatum(list, "abc_stageRecordTest",
                                     words("Distance of each part of the stage from its record, in what the "
                                           "record expects (probability)"));
    add_words(tests, "dcc:description", words(tests_of_record(*result.stage_record)));
  }
  add("abc_estimator", words("Estimator"), words.as_given(result.estimator));
  XmlElement verdict = add_metadatum(list, "abc_verdict", words("Verdict of the analysis"));
  // The Schematron requires sentences in an element with a name.
  add_words(verdict, "dcc:description",
            words("{verdict}: {why}", word_of(kVerdicts, to_string(result.verdict)), result.why));
  for (const Message& note : result.diagnostics.notes) {
    XmlElement metadatum = add_metadatum(list, "abc_note", words("Note of the analysis"));
    add_words(metadatum, "dcc:description", words(note));
  }
  if (data.held_out_norm) add_held_out_norm(list, words, *data.held_out_norm);
}

}  // namespace abcal
