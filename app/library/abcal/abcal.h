#pragma once

// All of the library. Nothing but the standard library and Eigen is included.

#include "abcal/bench.h"
#include "abcal/certificate.h"
#include "abcal/compare.h"
#include "abcal/export.h"
#include "abcal/instrument.h"
#include "abcal/model.h"
#include "abcal/plan.h"
#include "abcal/record.h"
#include "abcal/result.h"
#include "abcal/study.h"
#include "abcal/values.h"
