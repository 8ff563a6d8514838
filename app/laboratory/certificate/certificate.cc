#include "app/laboratory/certificate/certificate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string_view>

#include "app/formats/dsi_unit.h"
#include "app/formats/typed_unit.h"
#include "app/laboratory/certificate/certified_record.h"
#include "app/laboratory/certificate/certified_series.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/measurand.h"
#include "app/laboratory/certificate/traceability.h"
#include "app/laboratory/register/records.h"
#include "drivers/text/text.h"

namespace abcal {
namespace {

std::string problem_list(const std::string& head, const std::vector<Problem>& problems) {
  std::string text = fmt::format("{}: {} problem{}", head, problems.size(), problems.size() == 1 ? "" : "s");
  for (const Problem& problem : problems) text += "\n  " + to_string(problem);
  return text;
}

/// Names in problems for the run of a certificate, and for the common facts of a series.
constexpr Term kRunWords{"run"}, kAsFound{"as-found run"}, kSeriesWords{"runs over temperature"};

/// Whether a reason is listed for its own run or for another one.
bool is_listed(const std::vector<Reason>& reasons, Reason reason, const Message& other_run) {
  const auto is_there = [&] { return std::ranges::find(reasons, reason) != reasons.end(); };
  if (is_there()) return true;
  if (reason.run != Message(kSeriesWords)) return false;
  reason.run = other_run;
  return is_there();
}

/// Collects the problems of a certificate in two lists: those that a draft cannot have either, and the rest.
class Inspection {
 public:
  Inspection(const LaboratoryFile& laboratory, std::vector<Problem> of_file)
      : laboratory_(laboratory), of_file_(std::move(of_file)) {}

  void check(const ReportData& data, const Message& which) {
    check_state(data, which);
    check_labels(data, which);
    check_identity(data, which);
    check_conditions(data, which);
    check_equipment(data, which);
  }

  /// Checks each run of a measurement. Its certificate rests on how much the item changes between them.
  void check_together(const std::vector<ReportData>& runs, const ReportData& data, const Message& which) {
    for (const ReportData& one : runs)
      check(one, Message("run {file}", quoted(one.path.filename().string())));
    if (!data.is_of_several_runs() || data.record.tolerances.sources.contains("drift_between_runs")) return;
    of_run_.push_back({which, Message("{key}", "[item_uncertainty] drift_between_runs"), Message("nothing"),
                       Message("by how much the item changes from run to run, with its source")});
  }

  /// The customer does not supply what the instrument itself reported.
  void check_supplied(const ReportData& data) {
    if (!data.run) return;
    const ItemIdentityParts identity = identity_of(data);
    const Words words(laboratory_.language);
    for (const std::string& supplied : laboratory_.job.customer_supplied) {
      std::string read;
      for (std::size_t i = 0; i < identity.size(); ++i) {
        const auto named = [&](const std::string& name) {
          return pieces::lower(supplied).find(pieces::lower(name)) != std::string::npos;
        };
        if (identity[i].known_by() == KnownBy::kRead &&
            (named(identity[i].words) || named(words(kIdentityWords[i]).text)))
          read += (read.empty() ? "" : ", ") + identity[i].words;
      }
      if (!read.empty())
        of_file_.push_back({"[job] customer_supplied", quoted(supplied).english(),
                            "what the laboratory did not check; read from the instrument: " + read});
    }
  }

  void check_pair(const ReportData& found, const ReportData& left) {
    for (const char* key : {"item.maker", "item.model", "item.serial_number"}) {
      if (found.label(key) != left.label(key)) {
        of_run_.push_back({kAsFound, Message("{key}", key), Message("\"{text}\"", found.label(key)),
                           Message("the item of the other run, \"{item}\"", left.label(key))});
      }
    }
    if (found.record.response_unit != left.record.response_unit)
      of_run_.push_back({kAsFound, Message("response unit"), Message("{unit}", found.record.response_unit),
                         Message("{unit}", left.record.response_unit)});
    if (found.started_utc() > left.started_utc())
      of_run_.push_back(
          {kAsFound,
           {},
           Message("began {began}", found.started_utc()),
           Message("a beginning not after that of the other run, {began}", left.started_utc())});
    if (laboratory_.job.adjustment.empty())
      of_file_.push_back({"[job] adjustment", "nothing",
                          "what was done to the item between the as-found and the as-left run"});
  }

  /// Checks the points of a series. A problem with the bench of all points, or of the run as well, is
  /// reported once.
  void check_series(const std::vector<ReportData>& points, const ReportData& run, const Message& which) {
    for (const ReportData& point : points) {
      if (point.sha256 != run.sha256) check_state(point, quoted(point.path.filename().string()));
      check_labels(point, kSeriesWords);
      check_identity(point, kSeriesWords);
      check_conditions(point, kSeriesWords);
      check_equipment(point, kSeriesWords);
    }
    add_of_run(problems_of_series(points, run));
    std::vector<Reason> each_once;
    for (Reason& reason : of_run_)
      if (!is_listed(each_once, reason, which)) each_once.push_back(std::move(reason));
    of_run_ = std::move(each_once);
  }

  /// @param runs  of the certificate; the last is the calibration
  void check_issue(const IssueFacts& issue, const std::vector<const ReportData*>& runs,
                   const std::vector<RunOperator>& operators) {
    check_persons(issue, operators, !equipment_of_run(*runs.back()).empty());
    check_dates(issue, runs);
    if (issue.number.find_first_not_of(" \t\r\n") == std::string::npos)
      of_run_.push_back(
          {{}, Message("number"), quoted(issue.number), Message("the unique number of the certificate")});
    if (issue.replaces && issue.replaces->reason.find_first_not_of(" \t\r\n") == std::string::npos)
      of_run_.push_back({{},
                         Message("reason"),
                         Message("nothing"),
                         Message("why certificate {number} is replaced", issue.replaces->number)});
    if (issue.replaces && issue.replaces->number == issue.number)
      of_run_.push_back({{},
                         Message("number"),
                         quoted(issue.number),
                         Message("a number different from that of the replaced certificate")});
  }

  /// States the result, also in the requested units, and decides on the limits; reports what the result does
  /// not provide.
  void derive_and_decide(const ReportData& data, CertifiedRun& run) {
    std::vector<SensitivityUnit> units;
    for (const std::string& name : laboratory_.units) {
      try {
        units.push_back(sensitivity_unit(name, data.record.response_unit));
      } catch (const std::invalid_argument& error) {
        of_file_.push_back({"[units] sensitivity", quoted(name), error.what()});
      }
    }
    const bool readable = check_units_of_limits(data);
    if (!run.has_numbers() || !data.run) return;
    run.stated = stated_result(data.result(), {.units = units,
                                               .scope = laboratory_.scope,
                                               .accredited = !laboratory_.laboratory.accreditation.empty(),
                                               .mounting = data.record.expected.mounting,
                                               .monte_carlo = run.monte_carlo ? &*run.monte_carlo : nullptr});
    if (!readable) return;
    for (const SpecificationLimit& limit : laboratory_.limits) {
      const auto quantity = stated_quantity(run.stated, limit.quantity);
      const auto in_si = quantity ? limit_in_si(limit, *quantity, data.result().g_loc.value) : std::nullopt;
      if (!in_si) {
        of_file_.push_back({fmt::format("line {}, [limit] unit of {}", limit.line, limit.quantity),
                            quoted(limit.unit), "one of " + offered_units(limit, data, quantity)});
      } else if (laboratory_.decision) {
        run.decisions.push_back(decide_printed(*laboratory_.decision, *in_si, *quantity,
                                               printed_in_si(*quantity, limit.quantity)));
        run.decisions.back().stated = limit;
      }
    }
  }

  void add_of_run(const std::vector<Reason>& reasons) {
    of_run_.insert(of_run_.end(), reasons.begin(), reasons.end());
  }

  const std::vector<Problem>& of_file() const { return of_file_; }
  const std::vector<Reason>& of_run() const { return of_run_; }
  std::vector<Problem> all() const {
    std::vector<Problem> all = of_file_;
    for (const Reason& reason : of_run_) all.push_back(reason.problem());
    return all;
  }

 private:
  static bool is_sensitivity(const SpecificationLimit& limit) {
    return limit.quantity.starts_with("sensitivity_") || limit.quantity.starts_with("intrinsic_sensitivity_");
  }

  /// Refuses limits whose unit may mean two: per standard or per local gravity. @return whether there is none
  bool check_units_of_limits(const ReportData& data) {
    bool readable = true;
    const LocalGravity& g_loc = data.record.g_loc;
    for (const SpecificationLimit& limit : laboratory_.limits) {
      const std::vector<TypedUnit> readings = readings_of(typed_unit(limit.unit));
      if (!is_sensitivity(limit) || readings.size() < 2) continue;
      readable = false;
      const std::string si = TypedUnit{data.record.response_unit, PerAcceleration::kSi}.name();
      const auto reading = [&](const TypedUnit& unit, const std::string& gravity) {
        std::string text = fmt::format("unit = \"{}\", per {}", unit.name(), gravity);
        const auto ratio = ratio_of_units(unit.name(), si, g_loc.value_mps2);
        if (!ratio || !data.record.g_loc_known) return text;
        for (const auto& [name, bound] : {std::pair{"lower", limit.lower}, {"upper", limit.upper}})
          if (bound) text += fmt::format(", {} = {:.7g} {}", name, *bound * *ratio, si);
        return text;
      };
      of_file_.push_back(
          {fmt::format("line {}, [limit] unit of {}", limit.line, limit.quantity),
           fmt::format("{}, which has two readings", quoted(limit.unit)),
           fmt::format("one of these lines: {}; or {}",
                       reading(readings.front(), "standard gravity, 9.80665 m/s2, as data sheets mean it"),
                       reading(readings.back(), fmt::format("local gravity, {} m/s2", g_loc.value_mps2)))});
    }
    return readable;
  }

  /// The limit in the SI unit in which the quantity is printed. Absent: its unit is of another kind.
  static std::optional<SpecificationLimit> limit_in_si(const SpecificationLimit& limit,
                                                       const Quantity& quantity, double g_loc_mps2) {
    const auto ratio = ratio_of_units(limit.unit, quantity.unit, g_loc_mps2);
    if (!ratio) return std::nullopt;
    const UnitInDsi in = unit_in_dsi(quantity.unit);
    SpecificationLimit in_si = limit;
    in_si.unit = in.unit.text();
    for (std::optional<double>* bound : {&in_si.lower, &in_si.upper})
      if (*bound) **bound *= *ratio * in.factor;
    return in_si;
  }

  /// Units that a limit may have, in quotes.
  static std::string offered_units(const SpecificationLimit& limit, const ReportData& data,
                                   const std::optional<Quantity>& quantity) {
    if (!is_sensitivity(limit))
      return quantity ? quoted(quantity->unit).english() : "those of a quantity with a value";
    std::string offered;
    for (const PerAcceleration per :
         {PerAcceleration::kSi, PerAcceleration::kStandard, PerAcceleration::kLocal})
      offered += (offered.empty() ? "" : ", ") + quoted(TypedUnit{data.record.response_unit, per}.name());
    return offered;
  }

  /// Two-person rule: the run's own events name the persons who measured, not present statements.
  void check_persons(const IssueFacts& issue, const std::vector<RunOperator>& operators,
                     bool has_registered_equipment) {
    for (const RunOperator& who : operators) {
      if (laboratory_.person_who_may("measure", who.name) == nullptr)
        of_run_.push_back({{},
                           Message("measured by"),
                           quoted(who.name),
                           Message("one of {names}, who may measure", names("measure"))});
      if (who.name == issue.approved_by)
        of_run_.push_back({{},
                           Message("approved by"),
                           quoted(issue.approved_by),
                           Message("a person other than the one who measured")});
      if (!issue.register_identity.empty() && !issue.training &&
          who.register_identity != issue.register_identity)
        of_run_.push_back({{},
                           Message("measured by"),
                           Message("\"{name}\" (stated, not verified)", who.name),
                           Message("a person who was logged in to the register during the run")});
    }
    const bool known = std::any_of(operators.begin(), operators.end(),
                                   [&](const RunOperator& who) { return who.name == issue.measured_by; });
    if (!issue.measured_by.empty() && !known)
      of_run_.push_back(
          {{},
           Message("{option}", "--measured-by"),
           quoted(issue.measured_by),
           Message("who measured by the events of the run: {names}", quoted(describe(operators)))});
    if (!issue.register_identity.empty() && !issue.training && !has_registered_equipment)
      of_run_.push_back(
          {{},
           Message("equipment"),
           Message("nothing that the register named when the run began"),
           Message("calibrations in the register (`abcal lab add calibration`) before the run")});
    if (laboratory_.person_who_may("approve", issue.approved_by) == nullptr)
      of_run_.push_back({{},
                         Message("approved by"),
                         quoted(issue.approved_by),
                         Message("one of {names}, who may approve", names("approve"))});
  }

  /// Dates agree with each other and with the clock.
  void check_dates(const IssueFacts& issue, const std::vector<const ReportData*>& runs) {
    const auto [begin_utc, end_utc] = period_of(runs);
    const auto begin = parse_date(begin_utc), end = parse_date(end_utc);
    if (end && issue.date < *end)
      of_run_.push_back({{},
                         Message("date of issue"),
                         Message("{date}", format_date(issue.date)),
                         Message("not before the run's end, {end}", format_date(*end))});
    if (issue.today && issue.date > *issue.today)
      of_run_.push_back({{},
                         Message("date of issue"),
                         Message("{date}", format_date(issue.date)),
                         Message("not after today, {today}", format_date(*issue.today))});
    const auto& received = laboratory_.job.received;
    // The clock of a simulated run is simulated, too.
    if (received && begin && runs.back()->simulated.empty() && *received > *begin)
      of_run_.push_back({{},
                         Message("{key}", "[job] received"),
                         Message("{date}", format_date(*received)),
                         Message("not after the run began, {began}", format_date(*begin))});
    if (issue.today && end && *end > *issue.today)
      of_run_.push_back({{},
                         Message("end of the run"),
                         Message("{date}", format_date(*end)),
                         Message("not after today, {today}", format_date(*issue.today))});
  }

  Message names(const std::string& may) const {
    std::vector<Message> all;
    for (const Person& person : laboratory_.persons)
      if (laboratory_.person_who_may(may, person.name) == &person) all.push_back(quoted(person.name));
    return all.empty() ? Message("the [[person]] entries") : in_sequence(all, ", ");
  }

  void check_state(const ReportData& data, const Message& which) {
    if (!data.complete()) {
      of_run_.push_back({which,
                         {},
                         Message("{experiment}, {measured} of {planned} angles measured",
                                 word_of(kRunStates, to_string(data.run->state)), data.run->measured.size(),
                                 data.run->header.plan.size()),
                         Message("a complete run: `abcal resume`")});
    } else {
      for (const IntegrityCheck& check : data.integrity)
        if (!check.good)
          of_run_.push_back({which, Message("{check}", check.what), Message::bare(check.found),
                             Message("consistent with what was stored")});
    }
    const CalibrationResult& result = data.result();
    if (result.verdict != Verdict::kUsable)
      of_run_.push_back(
          {which, Message("verdict"),
           Message("{verdict}: {why}", word_of(kVerdicts, to_string(result.verdict)), result.why),
           Message("usable")});
  }

  void check_labels(const ReportData& data, const Message& which) {
    for (const auto& [key, words] : {std::pair{"item.maker", "[item] maker"},
                                     {"item.model", "[item] model"},
                                     {"item.serial_number", "[item] serial_number"},
                                     {"operator.name", "[operator] name"}}) {
      if (data.label(key).find_first_not_of(" \t\r\n") == std::string::npos)
        of_run_.push_back({which, Message("{key}", words), Message("nothing"),
                           Message("given in the bench file before the run")});
    }
    const std::string name = data.label("operator.name");
    if (!name.empty() && laboratory_.person_who_may("measure", name) == nullptr)
      of_run_.push_back({which, Message("operator"), quoted(name),
                         Message("one of {names}, who may measure", names("measure"))});
  }

  /// The item of the certificate is the one whose instrument answered.
  void check_identity(const ReportData& data, const Message& which) {
    for (const IdentityPart& part : identity_of(data))
      if (!part.agrees())
        of_run_.push_back(
            {which, Message("[item] {key}", part.key),
             Message("\"{stated}\", but the instrument reported \"{reported}\"", part.stated, part.reported),
             Message("a run of the item that is named: what answered was another item, or the bench "
                     "file named it wrongly")});
  }

  void check_conditions(const ReportData& data, const Message& which) {
    const auto& environment = data.run->environment;
    if (std::none_of(environment.begin(), environment.end(),
                     [](const StoredEnvironment& look) { return look.temperature_degc.has_value(); })) {
      of_run_.push_back({which, Message("temperature of the room"), Message("nothing"),
                         Message("[environment] temperature_degc in the bench file, or a sensor")});
    }
    if (!(data.record.g_loc.expanded_uncertainty_mps2 > 0.0))
      of_run_.push_back({which, Message("local gravity"), Message("no uncertainty"),
                         Message("[bench] g_loc_expanded_uncertainty_mps2, as the survey states it")});
    if (data.record.g_loc.source.empty())
      of_run_.push_back(
          {which, Message("local gravity"), Message("no source"), Message("{key}", "[bench] g_loc_source")});
  }

  void check_equipment(const ReportData& data, const Message& which) {
    const auto day = parse_date(data.ended_utc());
    for (const Equipment& one : laboratory_.equipment) {
      // A record of a stage must hold only where it is used: against_stage_record().
      if (day && one.due && *one.due < *day && one.quantity != lab::kStageRecordQuantity)
        of_run_.push_back(
            {{},
             Message("line {line}, [[equipment]] {name}, due", one.line, quoted(one.name)),
             Message("{date}", format_date(*one.due)),
             Message("a date not before that of the {which}, {date}", which, format_date(*day))});
    }
    const std::string missing =
        serial_number_without_equipment(laboratory_.equipment, "angle", serial_numbers_of(data, "stage"));
    if (!missing.empty())
      of_run_.push_back({which, Message("stage"), Message("serial number {serial_number}", quoted(missing)),
                         Message("an [[equipment]] with quantity = \"angle\" and this serial_number")});
    const bool volts = data.record.response_unit.ends_with("V");
    if (volts && std::none_of(laboratory_.equipment.begin(), laboratory_.equipment.end(),
                              [](const Equipment& one) { return one.quantity == "voltage"; })) {
      of_run_.push_back({which, Message("output in {unit}", data.record.response_unit),
                         Message("no calibrated voltmeter"),
                         Message("an [[equipment]] with quantity = \"voltage\"")});
    }
  }

  const LaboratoryFile& laboratory_;
  std::vector<Problem> of_file_;
  std::vector<Reason> of_run_;
};

std::vector<Shift> shifts_between(const StatedResult& found, const StatedResult& left) {
  std::vector<Shift> shifts;
  const auto add = [&](const std::string& name) {
    const auto a = stated_quantity(found, name), b = stated_quantity(left, name);
    if (!a || !b) return;
    Shift shift;
    shift.name = name;
    shift.difference.unit = b->unit;
    shift.difference.value = b->value - a->value;
    shift.difference.standard_uncertainty = std::hypot(a->standard_uncertainty, b->standard_uncertainty);
    shift.difference.degrees_of_freedom = std::min(a->degrees_of_freedom, b->degrees_of_freedom);
    shift.normalised_error =
        shift.difference.value / (coverage_factor(shift.difference) * shift.difference.standard_uncertainty);
    shifts.push_back(shift);
  };
  for (const char* axis : kOutputNames) add(std::string("intrinsic_sensitivity_") + axis);
  for (const char* pair : kOutputPairs) add(std::string("intrinsic_angle_") + pair);
  for (const char* axis : kOutputNames) add(std::string("offset_") + axis);
  return shifts;
}

/// Even a draft needs a run, and a result with a sensitivity matrix.
void require_certifiable(const ReportData& data) {
  if (!data.run)
    throw CertificateRefused(data.path.string(),
                             {{"run", "a table of readings, and so no run that is traceable",
                               "a run file: a certificate names item, operator and bench"}});
  if (find_estimator(data.estimator).certifiable) return;
  throw CertificateRefused(data.path.string(),
                           {{"estimator", data.estimator, "one that gives the sensitivity matrix"}});
}

/// A point over temperature.
void require_point(const ReportData& data) {
  require_certifiable(data);
  if (data.is_of_several_runs())
    throw CertificateRefused(
        data.path.string(),
        {{"--temperature", "a measurement of several runs",
          "points of one run each: what runs on one stage share is not known to the fit of the points"}});
  if (data.result().stage_record)
    throw CertificateRefused(data.path.string(),
                             {{"--temperature", "a result with a record of the stage",
                               "points without one: what all share of it is not known to their common fit"}});
}

std::vector<const ReportData*> runs_of(const CertificateRequest& request) {
  std::vector<const ReportData*> runs;
  if (request.as_found) runs.push_back(&*request.as_found);
  for (const ReportData& point : request.series) runs.push_back(&point);
  for (const ReportData& one : request.together_as_found) runs.push_back(&one);
  for (const ReportData& one : request.together) runs.push_back(&one);
  runs.push_back(&request.run);
  return runs;
}

/// The operators in all runs of a certificate.
std::vector<RunOperator> operators_of_runs(const std::vector<const ReportData*>& runs) {
  std::vector<RunOperator> operators;
  for (const ReportData* data : runs) {
    if (!data->run) continue;
    for (RunOperator& who : operators_of(*data->run))
      if (std::find(operators.begin(), operators.end(), who) == operators.end())
        operators.push_back(std::move(who));
  }
  return operators;
}

std::vector<Reason> reasons_against(const LaboratoryFile& laboratory, const CertificateRequest& request) {
  std::vector<Reason> reasons = against_traceability(laboratory, request.run, kRunWords);
  if (request.as_found)
    for (Reason& reason : against_traceability(laboratory, *request.as_found, kAsFound))
      reasons.push_back(std::move(reason));
  // A reason against the run itself, or against several points, is reported once.
  for (const ReportData& point : request.series)
    for (Reason& reason : against_traceability(laboratory, point, kSeriesWords))
      if (!is_listed(reasons, reason, kRunWords)) reasons.push_back(std::move(reason));
  return reasons;
}

}  // namespace

std::vector<const ReportData*> runs_of(const Certificate& certificate) {
  std::vector<const ReportData*> runs;
  if (certificate.as_found) runs.push_back(&certificate.as_found->data);
  if (certificate.series)
    for (const ReportData& point : certificate.series->points) runs.push_back(&point);
  if (certificate.as_found)
    for (const ReportData& one : certificate.as_found->together) runs.push_back(&one);
  for (const ReportData& one : certificate.run.together) runs.push_back(&one);
  runs.push_back(&certificate.run.data);
  return runs;
}

std::vector<const ReportData*> runs_of_result(const std::vector<ReportData>& together,
                                              const ReportData& data) {
  if (!data.is_of_several_runs()) return {&data};
  std::vector<const ReportData*> runs;
  for (const ReportData& run : together) runs.push_back(&run);
  return runs;
}

std::pair<std::string, std::string> period_of(const std::vector<const ReportData*>& runs) {
  std::string begin, end;
  for (const ReportData* run : runs) {
    const std::string started = run->started_utc(), ended = run->ended_utc();
    if (begin.empty() || (!started.empty() && started < begin)) begin = started;
    if (end.empty() || ended > end) end = ended;
  }
  return {begin, end};
}

std::string Certificate::measured_by() const {
  std::string names;
  for (const RunOperator& who : operators)
    if (names.find(who.name) == std::string::npos) names += (names.empty() ? "" : ", ") + who.name;
  return names;
}

CertificateRefused::CertificateRefused(const std::string& run, std::vector<Problem> problems)
    : std::runtime_error(
          problem_list("no certificate for " + run, problems) +
          "\n  `abcal report --draft` makes a draft in spite of this and lists the reasons in it"),
      problems_(std::move(problems)) {}

std::string draft_number(const ReportData& run) {
  return "DRAFT-" + (run.sha256 ? run.sha256->substr(0, 12) : std::string("open")) +
         (run.is_one_of_several() ? fmt::format("-{}", run.item) : "");
}

void add_monte_carlo(CertificateRequest& request) {
  const auto of = [](const ReportData& data) -> std::optional<CertifiedUncertainty> {
    // A common fit of several items or runs has no Monte Carlo; an incomplete run has no hash yet.
    if (!data.sha256 || data.is_one_of_several() || data.is_of_several_runs()) return std::nullopt;
    return certified_uncertainty_of(data.record, data.result(), *data.sha256);
  };
  request.monte_carlo = of(request.run);
  if (request.as_found) request.monte_carlo_as_found = of(*request.as_found);
}

Certificate make_certificate(CertificateRequest request) {
  require_certifiable(request.run);
  if (request.as_found) require_certifiable(*request.as_found);
  for (const ReportData& point : request.series) require_point(point);
  ReadLaboratoryFile read = std::move(request.laboratory);
  Certificate certificate;
  certificate.laboratory = std::move(read.file);
  certificate.words = Words(certificate.laboratory.language);
  // The register's data at the start of the run take precedence over the present file.
  if (auto registered = equipment_of_run(request.run); !registered.empty())
    certificate.laboratory.equipment = std::move(registered);
  certificate.operators = operators_of_runs(runs_of(request));
  const std::vector<Reason> not_traceable = reasons_against(certificate.laboratory, request);
  for (const Reason& reason : not_traceable) certificate.not_traceable.push_back(reason.message());
  Inspection inspection(certificate.laboratory, std::move(read.problems));
  const Message which = request.as_found ? Message("as-left run") : Message(kRunWords);
  inspection.check(request.run, which);
  inspection.check_supplied(request.run);
  inspection.check_together(request.together, request.run, which);
  inspection.add_of_run(against_stage_record(certificate.laboratory, request.run, runs_of(request),
                                             runs_of_result(request.together, request.run), which));
  if (request.as_found) {
    inspection.check(*request.as_found, kAsFound);
    inspection.add_of_run(against_stage_record(certificate.laboratory, *request.as_found, runs_of(request),
                                               runs_of_result(request.together_as_found, *request.as_found),
                                               kAsFound));
    inspection.check_together(request.together_as_found, *request.as_found, kAsFound);
    inspection.check_pair(*request.as_found, request.run);
  }
  if (!request.series.empty()) {
    inspection.check_series(request.series, request.run, which);
    std::vector<Reason> problems;
    certificate.series = certified_series(request.series, problems);
    inspection.add_of_run(problems);
  }
  if (request.issue) {
    inspection.check_issue(*request.issue, runs_of(request), certificate.operators);
    if (!request.issue->training && !request.draft) inspection.add_of_run(not_traceable);
  }

  certificate.run.monte_carlo = std::move(request.monte_carlo);
  certificate.run.data = std::move(request.run);
  certificate.run.together = std::move(request.together);
  inspection.derive_and_decide(certificate.run.data, certificate.run);
  if (request.as_found) {
    certificate.as_found.emplace().data = std::move(*request.as_found);
    certificate.as_found->monte_carlo = std::move(request.monte_carlo_as_found);
    certificate.as_found->together = std::move(request.together_as_found);
    Inspection silent(certificate.laboratory,
                      {});  // Units and limits are the same, so their problems are reported only once.
    silent.derive_and_decide(certificate.as_found->data, *certificate.as_found);
  }

  if (!inspection.of_file().empty())
    throw LaboratoryFileError(certificate.laboratory.source, inspection.all());
  const bool may_be_draft =
      request.draft && certificate.run.data.run && (!certificate.as_found || certificate.as_found->data.run);
  if (!inspection.of_run().empty() && !may_be_draft)
    throw CertificateRefused(certificate.run.data.path.string(), problems_of(inspection.of_run()));
  for (const Reason& reason : inspection.of_run()) certificate.reservations.push_back(reason.message());

  if (certificate.as_found && certificate.as_found->has_numbers() && certificate.run.has_numbers())
    certificate.shifts = shifts_between(certificate.as_found->stated, certificate.run.stated);
  certificate.issue = std::move(request.issue);
  certificate.number = certificate.issue ? certificate.issue->number : draft_number(certificate.run.data);
  certificate.program_version = certificate.run.data.program_version;
  return certificate;
}

}  // namespace abcal
