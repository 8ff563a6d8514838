// The inputs that fuzzing has found so far, kept in tests/fuzz/corpus, as a test with any compiler.

#include <gtest/gtest.h>

#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "tests/support/fuzz_inputs.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

class KeptCorpusTest : public testing::TestWithParam<std::string> {};

TEST_P(KeptCorpusTest, AgreesWithTheReference) {
  std::size_t inputs = 0;
  for (const auto& file :
       std::filesystem::directory_iterator(test::source_folder() / "tests/fuzz/corpus" / GetParam())) {
    std::ifstream stream(file.path(), std::ios::binary);
    ASSERT_TRUE(stream) << file.path();
    const std::string input{std::istreambuf_iterator<char>(stream), {}};
    test::show_target(input);
    ++inputs;
  }
  EXPECT_GT(inputs, 0U);
}

INSTANTIATE_TEST_SUITE_P(Codecs, KeptCorpusTest, testing::Values(ABCAL_CODEC),
                         [](const auto& codec) { return codec.param; });

}  // namespace
}  // namespace abcal
