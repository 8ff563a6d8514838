# Layers point one way: each folder may include only what stands here (docs/architecture.md, "Who may include whom").
# Run by ctest:  cmake -DSOURCE_DIR=... -P layering_check.cmake   (ABCAL_EXTRA_FILE: a file to check as well, for the
# test of the test, as FOLDER=PATH).

set(instrument "drivers/instrument/")
set(wire "drivers/instrument/;drivers/wire/")
set(record "drivers/instrument/angle.h;drivers/instrument/clock.h;protocol/plan/;protocol/record/")
set(numbers "drivers/instrument/angle.h;protocol/plan/tolerances.h;protocol/plan/effect_sizes.h;protocol/plan/limits.h;protocol/record/run_record.h;protocol/model/")

# folder | folders and headers of the project that it may include | third-party headers that it may include
set(rules
  "drivers/instrument|${instrument}|Eigen/"
  "drivers/wire|${wire}|boost/;libserialport.h;spdlog/;fmt/;Eigen/"
  "drivers/manual_stage|${wire};drivers/manual_stage/|boost/;spdlog/;fmt/;Eigen/"
  "protocol/plan|drivers/instrument/angle.h;protocol/plan/|Eigen/;fmt/"
  "protocol/model|drivers/instrument/angle.h;protocol/plan/effect_sizes.h;protocol/model/|Eigen/"
  "protocol/gravity|drivers/instrument/angle.h;protocol/gravity/|fmt/"
  "protocol/record|${record}|Eigen/;unsupported/Eigen/;fmt/;sqlite3.h;openssl/"
  "protocol/run|drivers/instrument/;protocol/plan/;protocol/record/;protocol/run/|Eigen/;fmt/;boost/math/"
  "protocol/analysis|${numbers};protocol/analysis/|Eigen/;fmt/;boost/math/;Random123/"
  "protocol/uncertainty|${numbers};protocol/analysis/;protocol/uncertainty/|Eigen/;fmt/;boost/math/;Random123/;hwy/"
  "sim|${wire};sim/|Eigen/;boost/;fmt/;spdlog/;Random123/"
)

# Every folder with a driver.cc is a driver; all have the same rule.
file(GLOB registrations RELATIVE ${SOURCE_DIR} ${SOURCE_DIR}/drivers/*/driver.cc)
foreach(registration IN LISTS registrations)
  get_filename_component(driver ${registration} DIRECTORY)
  list(APPEND rules "${driver}|${wire};drivers/registry.h;${driver}/|boost/;spdlog/;fmt/;Eigen/")
endforeach()

set(violations "")
function(check_file folder file)
  file(STRINGS "${file}" includes REGEX "^[ \t]*#[ \t]*include")
  foreach(line IN LISTS includes)
    if(line MATCHES "#[ \t]*include[ \t]*\"([^\"]+)\"")
      set(header "${CMAKE_MATCH_1}")
      set(permitted "${own_headers}")
    elseif(line MATCHES "#[ \t]*include[ \t]*<([^>]+)>")
      set(header "${CMAKE_MATCH_1}")
      # The standard library and POSIX: no slash, or sys/, netinet/, arpa/, linux/.
      if(NOT header MATCHES "/" AND NOT header MATCHES "\\.(h|hpp)$")
        continue()
      endif()
      if(header MATCHES "^(sys|netinet|arpa|linux)/" OR header MATCHES
         "^(fcntl|unistd|poll|pty|termios|signal|grp|pwd|netdb|stdlib|dirent|errno)\\.h$")
        continue()
      endif()
      set(permitted "${foreign_headers}")
    else()
      continue()
    endif()
    set(found FALSE)
    foreach(prefix IN LISTS permitted)
      string(FIND "${header}" "${prefix}" at)
      if(at EQUAL 0)
        set(found TRUE)
      endif()
    endforeach()
    if(NOT found)
      string(APPEND violations "  ${file} includes ${header}\n")
    endif()
  endforeach()
  set(violations "${violations}" PARENT_SCOPE)
endfunction()

set(checked 0)
# The rules hold lists of their own, so they are walked as text: a rule begins with its folder and a bar.
string(REGEX REPLACE ";((drivers/|protocol/|si)[a-z_/]*[a-z_][|])" "\n\\1" text "${rules}")
string(REPLACE ";" "," text "${text}")
string(REPLACE "\n" ";" lines "${text}")
foreach(line IN LISTS lines)
  string(REPLACE "|" ";" parts "${line}")
  list(GET parts 0 folder)
  list(GET parts 1 own)
  list(GET parts 2 foreign)
  string(REPLACE "," ";" own_headers "${own}")
  string(REPLACE "," ";" foreign_headers "${foreign}")
  file(GLOB_RECURSE files "${SOURCE_DIR}/${folder}/*.h" "${SOURCE_DIR}/${folder}/*.cc")
  if(ABCAL_EXTRA_FILE MATCHES "^${folder}=(.+)$")
    list(APPEND files "${CMAKE_MATCH_1}")
  endif()
  foreach(file IN LISTS files)
    check_file("${folder}" "${file}")
    math(EXPR checked "${checked} + 1")
  endforeach()
endforeach()

if(checked LESS 20)
  message(FATAL_ERROR "only ${checked} files found below ${SOURCE_DIR}: the check looks in the wrong place")
endif()
if(violations)
  message(FATAL_ERROR "includes that point the wrong way:\n${violations}")
endif()
message(STATUS "${checked} files include only what their layer may")
