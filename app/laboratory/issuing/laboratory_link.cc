#include "app/laboratory/issuing/laboratory_link.h"

#include "app/laboratory/compare/check_run_notice.h"
#include "app/laboratory/register/find_operator.h"

namespace abcal {

LaboratoryLink laboratory_link() {
  return {find_operator, check_run_notices};
}

}  // namespace abcal
