#include "app/laboratory/issuing/register_link.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <memory>

#include "app/laboratory/compare/check_run_notice.h"
#include "app/laboratory/issuing/run_sources.h"
#include "app/laboratory/register/find_operator.h"
#include "app/witness/witness_client.h"

namespace abcal {
namespace {

std::vector<std::string> notices_of_run(const EndedRun& run, const std::string& login) {
  std::vector<std::string> notices = tell_register(run, login);
  std::ranges::move(check_run_notices(run, login), std::back_inserter(notices));
  return notices;
}

}  // namespace

LaboratoryLink laboratory_link() {
  return {find_operator, notices_of_run};
}

lab::HeadWitness head_witness(const std::string& register_identity) {
  const std::shared_ptr<WitnessClient> client = WitnessClient::find();
  if (!client) return {};
  return [client, register_identity](std::int64_t entries,
                                     const std::string& sha256) -> std::optional<WitnessedLine> {
    try {
      return client->head(register_identity, entries, sha256);
    } catch (const WitnessSilent&) {
      return std::nullopt;
    } catch (const WitnessRefusal& refusal) {
      throw lab::RegisterError(
          fmt::format("the witness refuses to sign the state of the register: {}", refusal.what()));
    }
  };
}

}  // namespace abcal
