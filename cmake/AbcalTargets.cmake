# One library per folder, one test program per folder; sources are listed, never globbed.

set(ABCAL_WARNINGS -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wdouble-promotion -Wold-style-cast)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
  list(APPEND ABCAL_WARNINGS -Wno-restrict)  # GCC 12 warns falsely of joined std::string temporaries (GCC bug 105651)
endif()
if(ABCAL_WERROR)
  list(APPEND ABCAL_WARNINGS -Werror)
endif()

# GCC collects garbage from 128 MB of memory on, which takes 6 % of the time of our larger translation units. With enough
# memory it begins later. Its output does not change.
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  cmake_host_system_information(RESULT memory_mb QUERY TOTAL_PHYSICAL_MEMORY)
  cmake_host_system_information(RESULT processors QUERY NUMBER_OF_LOGICAL_CORES)
  math(EXPR memory_of_one "${memory_mb} / (${processors} + 2)")  # Ninja starts one or two more than there are processors.
  if(memory_of_one GREATER 3000)
    add_compile_options(--param=ggc-min-heapsize=1500000)
  endif()
endif()

if(ABCAL_SANITIZE)
  add_compile_options(-fsanitize=${ABCAL_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${ABCAL_SANITIZE})
  if(ABCAL_SANITIZE MATCHES "thread")
    # GCC's thread sanitizer does not follow atomic fences, and warns of them.
    add_compile_definitions(BOOST_ASIO_DISABLE_FENCED_BLOCK)
  endif()
endif()

# Functions in sections of their own: a program contains only those that it uses, although a batch of sources is one object.
add_compile_options(-ffunction-sections -fdata-sections)
add_link_options(-Wl,--gc-sections)

# The same objects serve the programs and the shared library. Our functions cannot be replaced from outside, so that calls
# between them can be inlined as in a program.
add_compile_options("$<$<NOT:$<STREQUAL:$<TARGET_PROPERTY:TYPE>,EXECUTABLE>>:-fPIC;-fno-semantic-interposition>")

# Release builds check the bounds of copies and keep their tables read-only (tests/install/hardening.sh checks the program).
if(CMAKE_BUILD_TYPE STREQUAL "Release" AND NOT ABCAL_SANITIZE)
  add_compile_options(-U_FORTIFY_SOURCE -D_FORTIFY_SOURCE=3 -fstack-protector-strong
    "$<$<STREQUAL:$<TARGET_PROPERTY:TYPE>,EXECUTABLE>:-fPIE>")
  add_link_options("$<$<STREQUAL:$<TARGET_PROPERTY:TYPE>,EXECUTABLE>:-pie>" -Wl,-z,relro -Wl,-z,now)
endif()

# A whole build combines the sources of a target into few translation units: the headers that they share, which take half of
# a clean build, are parsed once. The preset dev leaves it off, so that a changed file is compiled alone.
option(ABCAL_UNITY "Compile the sources of a target as few translation units" OFF)

# Keeps sources out of these units: their anonymous namespaces contain names that other sources use, too.
function(abcal_read_apart)
  set_source_files_properties(${ARGV} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
endfunction()

# Compiles all sources of a target one by one: fully optimised linear algebra. In one unit, the compiler's time and memory
# grow faster than the code (estimators, GCC 12: 222 s and 4.6 GB as one unit, 110 s as thirteen).
function(abcal_read_each_apart)
  set_target_properties(${ARGV} PROPERTIES UNITY_BUILD OFF)
endfunction()

# Folder path = include path from the repository root, through the door of the target's layer. A result must not depend on the machine that printed
# it: no -march=native, no contraction of a*b+c into fused operations, no -ffast-math.
# Folders that set ABCAL_QUICK_BUILD get little optimisation in release builds. Under sanitizers only those that set
# ABCAL_NUMBERS get any: the optimiser spends most of the time on the checks (tests of the emulators, clang 16: 89 s at -O1,
# 19 s at -O0).
function(abcal_target_options target)
  get_target_property(sources ${target} SOURCES)
  set(first ${CMAKE_CURRENT_SOURCE_DIR}/generated)
  foreach(source IN LISTS sources)
    if(NOT source MATCHES "^${PROJECT_BINARY_DIR}")
      set(first ${source})
      break()
    endif()
  endforeach()
  abcal_door_of(${first} door)
  target_include_directories(${target} PRIVATE ${door})
  target_compile_options(${target} PRIVATE ${ABCAL_WARNINGS} -ffp-contract=off)
  if(ABCAL_QUICK_BUILD)
    # -Og: a third less compiling than -O1 for tests. GCC then warns falsely of uninitialised variables, unlike with -O1.
    target_compile_options(${target} PRIVATE $<$<CONFIG:Release>:-Og>
      $<$<AND:$<CONFIG:Release>,$<CXX_COMPILER_ID:GNU>>:-Wno-maybe-uninitialized>)
  endif()
  if(ABCAL_SANITIZE AND NOT ABCAL_NUMBERS)
    target_compile_options(${target} PRIVATE -O0)
  endif()
  if(ABCAL_UNITY)
    # Batches of at most twelve sources of one folder.
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_MODE GROUP)
    foreach(source IN LISTS sources)
      cmake_path(GET source PARENT_PATH folder)
      string(MAKE_C_IDENTIFIER "in_${folder}" folder)
      if(NOT DEFINED count_${folder})
        set(count_${folder} 0)
      endif()
      math(EXPR batch "${count_${folder}} / 12")
      math(EXPR count_${folder} "${count_${folder}} + 1")
      set_source_files_properties(${source} PROPERTIES UNITY_GROUP ${folder}_${batch})
    endforeach()
    # A source that another one includes looks like a header, whose anonymous namespace would be a mistake.
    if(CMAKE_CXX_COMPILER_ID STREQUAL GNU)
      target_compile_options(${target} PRIVATE -Wno-subobject-linkage)
    endif()
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
    target_link_libraries(abcal_${name} INTERFACE ${ARG_PUBLIC})
  endif()
  add_library(abcal::${name} ALIAS abcal_${name})
endfunction()

# abcal_add_driver(name SOURCES driver.cc codec.cc ... PRIVATE ...) makes the library of the driver in the folder name.
# CODEC_NAME: name of its codec in tests/fuzz, if that is not the name of the folder.
function(abcal_add_driver name)
  cmake_parse_arguments(ARG "" "CODEC_NAME" "SOURCES;PRIVATE" ${ARGN})
  abcal_add_library(${name} SOURCES ${ARG_SOURCES} PUBLIC abcal::wire PRIVATE ${ARG_PRIVATE})
  if(NOT ARG_CODEC_NAME)
    set(ARG_CODEC_NAME ${name})
  endif()
  set_property(GLOBAL APPEND PROPERTY ABCAL_DRIVERS ${name})
  set_property(GLOBAL PROPERTY ABCAL_CODEC_OF_${name} ${ARG_CODEC_NAME})
endfunction()

# abcal_add_test(name SOURCES ... LINK ...) makes the test program name and two tests of ctest from it: all its quick
# suites in one process, or in SHARDS parallel processes, and the suites whose name begins with "Long" (label long).
# PROGRAM: its tests start the program abcal. TIMEOUT: seconds for the quick ones (default 300). COST: their approximate
# time in seconds if that is more than 15: the longest begin first. UNSANITIZED: not run under sanitizers, which could find
# no fault of our code in it.
function(abcal_add_test name)
  cmake_parse_arguments(ARG "PROGRAM;UNSANITIZED" "SHARDS;TIMEOUT;COST" "SOURCES;LINK" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  abcal_target_options(${name})
  target_link_libraries(${name} PRIVATE ${ARG_LINK} abcal::project_paths GTest::gmock GTest::gtest_main)
  if(ARG_PROGRAM)
    add_dependencies(${name} abcal)
  endif()
  set(unsanitized)
  if(ARG_UNSANITIZED)
    set(unsanitized UNSANITIZED)
  endif()
  abcal_add_test_processes(${name} ${unsanitized} SHARDS "${ARG_SHARDS}" TIMEOUT "${ARG_TIMEOUT}" COST "${ARG_COST}")
endfunction()

# The tests of ctest for one test program. Their results are kept in build/PRESET/test_results (scripts/test counts them).
function(abcal_add_test_processes name)
  cmake_parse_arguments(ARG "UNSANITIZED" "SHARDS;TIMEOUT;COST" "" ${ARGN})
  if(NOT ARG_SHARDS)
    set(ARG_SHARDS 1)
  endif()
  if(NOT ARG_COST)
    set(ARG_COST 1)
  endif()
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  set(results ${PROJECT_BINARY_DIR}/test_results)
  math(EXPR last "${ARG_SHARDS} - 1")
  foreach(shard RANGE ${last})
    set(test ${name})
    if(ARG_SHARDS GREATER 1)
      set(test ${name}.${shard})
    endif()
    add_test(NAME ${test} COMMAND ${name} --gtest_brief=1 --gtest_filter=-Long*:*/Long* --gtest_output=xml:${results}/${test}.xml)
    set_tests_properties(${test} PROPERTIES LABELS quick TIMEOUT ${ARG_TIMEOUT} COST ${ARG_COST}
      ENVIRONMENT "GTEST_TOTAL_SHARDS=${ARG_SHARDS};GTEST_SHARD_INDEX=${shard}")
    if(ARG_UNSANITIZED)
      set_tests_properties(${test} PROPERTIES LABELS "quick;unsanitized")
    endif()
  endforeach()
  get_target_property(sources ${name} SOURCES)
  foreach(source IN LISTS sources)
    cmake_path(ABSOLUTE_PATH source)
    file(STRINGS ${source} long REGEX "^(TEST|TEST_F|TEST_P|INSTANTIATE_TEST_SUITE_P)\\(Long")
    if(long)
      add_test(NAME ${name}.long COMMAND ${name} --gtest_filter=Long*:*/Long* --gtest_output=xml:${results}/${name}.long.xml)
      set_tests_properties(${name}.long PROPERTIES LABELS long TIMEOUT 3600)
      break()
    endif()
  endforeach()
endfunction()
