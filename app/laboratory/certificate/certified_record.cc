#include "app/laboratory/certificate/certified_record.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "app/bench_file/stage_record_file.h"
#include "app/laboratory/certificate/traceability.h"
#include "app/laboratory/register/records.h"
#include "app/results/analysis/series_of_runs.h"
#include "protocol/estimators/measurement/stage_curves.h"
#include "protocol/model/effects.h"
#include "protocol/plan/effect_sizes.h"
#include "protocol/record/stage_record.h"
#include "protocol/statistics/median.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {
namespace {

constexpr Term kRecord{"record of the stage"};

Message identity_words(const Equipment& stated) {
  return {"\"{number}\" (SHA-256 {hash})", stated.certificate, stated.certificate_sha256};
}

Message words_of_run(const ReportData& run) {
  return {"run \"{file}\"", run.path.filename().string()};
}

Reason not_stated(const std::vector<Equipment>& equipment, const std::string& sha256, const Message& which) {
  std::vector<Message> others;
  for (const Equipment& one : equipment)
    if (one.quantity == lab::kStageRecordQuantity) others.push_back(identity_words(one));
  return {which, kRecord,
          others.empty()
              ? Message("SHA-256 {hash}, which the laboratory does not state", sha256)
              : Message("SHA-256 {hash}; the laboratory states {records}", sha256, in_sequence(others, ", ")),
          Message("an [[equipment]] with quantity = \"stage record\" and this certificate_sha256; with a "
                  "register, a calibration of such equipment with this --sha256, which a person who may "
                  "approve added before the run")};
}

/// Whether any learning of a record had this item.
bool was_taught_by_item(const StageRecord& record, const std::string& item) {
  return std::ranges::any_of(record.learnings, [&](const Learning& learning) {
    return std::ranges::find(learning.runs, item, &TeachingRun::item) != learning.runs.end();
  });
}

/// The times at which the record is used: in the laboratory's dates, and in its own validity.
void check_times(const Equipment& stated, const StageRecord& record, double validity,
                 const std::vector<const ReportData*>& of_result, const Message& which,
                 std::vector<Reason>& problems) {
  const auto learned = parse_date(record.learned_utc());
  if (stated.performed && learned && *stated.performed < *learned)
    problems.push_back(
        {which, kRecord,
         Message("{number}, approved on {date}", stated.certificate, date_words(stated.performed)),
         Message("a date not before {learned}, when it was learned", format_date(*learned))});
  for (const ReportData* run : of_result) {
    const auto day = parse_date(run->ended_utc());
    if (day && !holds_on(stated, *day))
      problems.push_back(
          {which, kRecord,
           Message("{number}, approved on {performed}, valid until {due}", stated.certificate,
                   date_words(stated.performed), date_words(stated.due)),
           Message("one that holds on {day}, the day of {run}", format_date(*day), words_of_run(*run))});
    if (const double age = months_between(record.learned_utc(), run->started_utc()); age > validity)
      problems.push_back(
          {which, kRecord,
           Message("{number}, {age:.1f} months old at {run}", stated.certificate, age, words_of_run(*run)),
           Message("at most {validity:.1f} months, for which it is good: learn the stage again", validity)});
  }
}

/// Outputs of a kind, in the order of study_output.h.
struct Kind {
  int first, count;
};

/// The largest part that a record has in the variance of an output of a kind, in percent; it includes what
/// the stage does not repeat.
double largest_part(const Budget& budget, const Kind& kind) {
  double largest = 0.0;
  for (int k = kind.first; k < kind.first + kind.count; ++k) {
    double part = 0.0;
    for (const BudgetLine& line : budget.lines)
      if (line.source == kStageRecordSource) part += budget.share_per_mps2(line, k);
    largest = std::max(largest, part);
  }
  return 100.0 * largest;
}

/// The median standard uncertainty of the angles of an axis, in degrees.
double median_uncertainty(const StageRecord& record, char axis) {
  std::vector<double> u;
  for (const StageCurvePoint& point : angle_error(record.state, axis))
    u.push_back(point.standard_uncertainty * 180.0 / std::numbers::pi);
  return u.empty() ? 0.0 : median(std::move(u));
}

/// The name of a part of a record that is tested.
Message part_words(const EffectTest& test) {
  static constexpr std::array<Term, 5> kParts{"alignment", "initial turns", "zeros", "fine map of X",
                                              "fine map of Z"};
  const std::string name = test.name.english();
  return std::ranges::find(kParts, name, &Term::english) == kParts.end() ? effect_words(name)
                                                                         : word_of(kParts, name);
}

Message test_words(const StageRecordUse& use) {
  std::vector<Message> against;
  const EffectTest* furthest = nullptr;
  int tested = 0;
  for (const EffectTest& test : use.tests) {
    if (test.degrees_of_freedom == 0) continue;
    ++tested;
    if (!test.passed) against.push_back(part_words(test));
    if (furthest == nullptr || test.probability < furthest->probability) furthest = &test;
  }
  if (!against.empty())
    return {"This calibration contradicts it in {parts}.", in_sequence(std::move(against), ", ")};
  if (furthest == nullptr) return Message("This calibration tests no part of it.");
  return {
      "This calibration agrees with it in all of the {count} parts that it tests; the least probable is "
      "{part}, {times:.1f} times as far from it as expected (probability {probability:.2g}).",
      tested, part_words(*furthest), furthest->times_stated, furthest->probability};
}

Message words_of_record(const Equipment* stated, const StageRecordUse& use) {
  if (stated == nullptr)
    return {
        "The errors of the stage are taken from a record that the laboratory does not state (SHA-256 "
        "{hash}).",
        use.sha256};
  return {
      "The errors of the stage are taken from record {number}, approved by {issuer} on {performed}, valid "
      "until {due} (SHA-256 {hash}).",
      stated->certificate,
      stated->certificate_issuer,
      date_words(stated->performed),
      date_words(stated->due),
      use.sha256};
}

}  // namespace

const Equipment* find_stage_record(const std::vector<Equipment>& equipment, const std::string& sha256) {
  const auto found = std::ranges::find_if(equipment, [&](const Equipment& one) {
    return one.quantity == lab::kStageRecordQuantity && one.certificate_sha256 == sha256;
  });
  return found == equipment.end() ? nullptr : &*found;
}

bool belongs_to(const Equipment& equipment, const CalibrationResult& result) {
  return equipment.quantity != lab::kStageRecordQuantity ||
         (result.stage_record && equipment.certificate_sha256 == result.stage_record->sha256);
}

std::vector<Reason> against_stage_record(const LaboratoryFile& laboratory, const ReportData& data,
                                         const std::vector<const ReportData*>& certified,
                                         const std::vector<const ReportData*>& of_result,
                                         const Message& which) {
  std::vector<Reason> problems;
  const auto& use = data.result().stage_record;
  if (!use || !data.run) return problems;
  const StageRecord& record = *data.record.stage_record.record;
  if (const Equipment* stated = find_stage_record(laboratory.equipment, use->sha256))
    check_times(*stated, record, use->validity_months, of_result, which, problems);
  else
    problems.push_back(not_stated(laboratory.equipment, use->sha256, which));
  for (const ReportData* run : certified)
    if (run->sha256 && record.was_taught_by(*run->sha256))
      problems.push_back({which, kRecord, Message("{run} taught it", words_of_run(*run)),
                          Message("one that other runs taught: what this run says would count twice")});
  if (const std::string item = item_of(*data.run);
      laboratory.laboratory.record_of_own_item != "stated" && was_taught_by_item(record, item))
    problems.push_back({which, kRecord, Message("it was learned from the item itself, {item}", item),
                        Message("one that was learned from other items, or [laboratory] record_of_own_item = "
                                "\"stated\", which the certificate says")});
  return problems;
}

EffectSizes sizes_behind(const ReportData& data) {
  EffectSizes sizes = data.record.tolerances;
  if (!data.result().stage_record) return sizes;
  for (const EffectSizeKey& key : effect_size_keys()) {
    const bool in_budget = data.budget && std::ranges::find(data.budget->lines, key.key, &BudgetLine::key) !=
                                              data.budget->lines.end();
    if (key.section != "stage_uncertainty" || in_budget) continue;
    key.set(sizes, 0.0);
    sizes.sources.erase(std::string(key.key));
  }
  return sizes;
}

Statement stage_record_statement(const Certificate& certificate, const ReportData& data,
                                 const Wording& title) {
  const Words& words = certificate.words;
  const StageRecordUse& use = *data.result().stage_record;
  const StageRecord& record = *data.record.stage_record.record;
  std::vector<Message> sentences{
      words_of_record(find_stage_record(certificate.laboratory.equipment, use.sha256), use),
      Message(
          "It was learned on {learned} from {runs} runs, and was {age:.1f} months old at this calibration; "
          "it is good for {validity:.1f} months.",
          use.learned_utc.substr(0, 10), use.runs, use.age_months, use.validity_months),
      Message(
          "It rests on the closure of the full circle of each axis, on local gravity, and on the outputs of "
          "the items that taught it, as they were read in those runs; no standard of angle is part of it."),
      Message("It states the angles of X and Z with standard uncertainties of {x:.1g} and {z:.1g} degrees "
              "(median); from visit to visit an angle repeats to {step:.1g} degrees.",
              median_uncertainty(record, 'X'), median_uncertainty(record, 'Z'),
              record.repeatabilities[static_cast<std::size_t>(RepeatPart::kStep)].rms * 180.0 /
                  std::numbers::pi)};
  if (data.budget)
    sentences.push_back(Message(
        "Its part of the variance, with that of what the stage does not repeat, is at most {matrix:.0f} % "
        "for "
        "the sensitivity matrix, {intrinsic:.0f} % for the intrinsic sensitivities, {angles:.0f} % for the "
        "angles between the axes and {offsets:.0f} % for the offsets.",
        largest_part(*data.budget, {0, kFirstOffset}),
        largest_part(*data.budget, {kFirstIntrinsicSensitivity, 3}),
        largest_part(*data.budget, {kFirstIntrinsicAngle, 3}),
        largest_part(*data.budget, {kFirstOffset, 3})));
  sentences.push_back(test_words(use));
  if (was_taught_by_item(record, item_of(*data.run)))
    sentences.push_back(Message("The item calibrated here is one of those that taught it."));
  sentences.push_back(Message("Results that use one record are correlated by it."));
  Statement statement;
  statement.ref_type = "abc_stageRecord";
  statement.title = title;
  statement.text = words(in_sequence(std::move(sentences), " "));
  return statement;
}

Message tests_of_record(const StageRecordUse& use) {
  std::vector<Message> tests;
  for (const EffectTest& test : use.tests)
    if (test.degrees_of_freedom > 0)
      tests.push_back(Message("{part} {times:.2f} ({probability:.2g})", part_words(test), test.times_stated,
                              test.probability));
  return in_sequence(std::move(tests));
}

}  // namespace abcal
