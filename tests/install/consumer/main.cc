// A third-party program: the estimators as a library, found with find_package(abcal).

#include <protocol/estimators/circle/abc_estimator.h>
#include <protocol/estimators/joint/analyse_joint.h>
#include <protocol/record/import_table.h>

#include <cstdio>

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const abcal::RunRecord record = abcal::import_table(argv[1]).record;
  for (const abcal::CalibrationResult& result : {abcal::analyse_abc(record), abcal::analyse_joint(record)}) {
    std::printf("%s", result.estimator.c_str());
    for (const abcal::Quantity& s : result.intrinsic_sensitivity) std::printf(" %.9f", s.value);
    std::printf("\n");
  }
}
