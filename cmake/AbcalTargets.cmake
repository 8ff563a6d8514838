# One library per folder, one test program per folder; sources are listed, never globbed.

set(ABCAL_WARNINGS -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wdouble-promotion -Wold-style-cast)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
  list(APPEND ABCAL_WARNINGS -Wno-restrict)  # GCC 12 warns falsely of joined std::string temporaries (GCC bug 105651)
endif()
if(ABCAL_WERROR)
  list(APPEND ABCAL_WARNINGS -Werror)
endif()

if(ABCAL_SANITIZE)
  add_compile_options(-fsanitize=${ABCAL_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${ABCAL_SANITIZE})
  if(ABCAL_SANITIZE MATCHES "thread")
    # GCC's thread sanitizer does not follow atomic fences, and says so with a warning.
    add_compile_definitions(BOOST_ASIO_DISABLE_FENCED_BLOCK)
  endif()
endif()

# A whole build reads the sources of a target as few translation units: their common headers are then parsed once, which is
# half of a build from nothing. The preset dev leaves it off, so that a changed file is compiled alone.
option(ABCAL_UNITY "Compile the sources of a target as few translation units" OFF)

# Folder path = include path from the repository root. A result must not depend on the machine that printed
# it: no -march=native, no contraction of a*b+c into fused operations, no -ffast-math.
function(abcal_target_options target)
  target_include_directories(${target} PUBLIC $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}>)
  target_compile_options(${target} PRIVATE ${ABCAL_WARNINGS} -ffp-contract=off)
  if(ABCAL_UNITY)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 10)
  endif()
endfunction()

# abcal_add_library(name SOURCES ... PUBLIC ... PRIVATE ...) makes abcal_name with alias abcal::name.
function(abcal_add_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  if(ARG_SOURCES)
    add_library(abcal_${name} STATIC ${ARG_SOURCES})
    abcal_target_options(abcal_${name})
    target_link_libraries(abcal_${name} PUBLIC ${ARG_PUBLIC} PRIVATE ${ARG_PRIVATE})
  else()
    add_library(abcal_${name} INTERFACE)
    target_include_directories(abcal_${name} INTERFACE ${PROJECT_SOURCE_DIR})
    target_link_libraries(abcal_${name} INTERFACE ${ARG_PUBLIC})
  endif()
  add_library(abcal::${name} ALIAS abcal_${name})
endfunction()

# abcal_add_driver(name SOURCES driver.cc codec.cc ... PRIVATE ...) makes the library of the driver in the folder name.
# CODEC_NAME: what its codec is called in tests/fuzz, where that is not the name of the folder.
function(abcal_add_driver name)
  cmake_parse_arguments(ARG "" "CODEC_NAME" "SOURCES;PRIVATE" ${ARGN})
  abcal_add_library(${name} SOURCES ${ARG_SOURCES} PUBLIC abcal::wire PRIVATE ${ARG_PRIVATE})
  if(NOT ARG_CODEC_NAME)
    set(ARG_CODEC_NAME ${name})
  endif()
  set_property(GLOBAL APPEND PROPERTY ABCAL_DRIVERS ${name})
  set_property(GLOBAL PROPERTY ABCAL_CODEC_OF_${name} ${ARG_CODEC_NAME})
endfunction()

# abcal_add_test(name SOURCES ... LINK ...) makes test program name. Test suites whose name begins with "Long"
# carry the ctest label "long", all others "quick". PROGRAM: its tests start the program abcal.
function(abcal_add_test name)
  cmake_parse_arguments(ARG "PROGRAM" "" "SOURCES;LINK" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  abcal_target_options(${name})
  target_link_libraries(${name} PRIVATE ${ARG_LINK} abcal::project_paths GTest::gmock GTest::gtest_main)
  if(ARG_PROGRAM)
    add_dependencies(${name} abcal)
  endif()
  include(GoogleTest)
  gtest_discover_tests(${name} TEST_FILTER "-Long*:*/Long*" DISCOVERY_TIMEOUT 60
    PROPERTIES LABELS quick TIMEOUT 300)
  gtest_discover_tests(${name} TEST_FILTER "Long*:*/Long*" TEST_LIST ${name}_long DISCOVERY_TIMEOUT 60
    PROPERTIES LABELS long TIMEOUT 3600)
endfunction()
