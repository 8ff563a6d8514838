# Layers point one way: each folder may include only what stands here (docs/architecture.md).
# Every folder of app, drivers, protocol and sim that has sources is listed; one that is not fails.
# Run by ctest:  cmake -DSOURCE_DIR=... -P layering_check.cmake
# For the test of the test:  ABCAL_EXTRA_FILE=FOLDER=PATH is a file to check as well, as one of FOLDER;
# ABCAL_EXTRA_FOLDER=FOLDER is a folder that is said to have sources.

set(violations "")
set(checked 0)
set(listed "")

# Standard library and POSIX: no slash and no extension, or one of these.
set(system_headers "^(sys|netinet|arpa|linux)/"
  "^(cpuid|dlfcn|fcntl|unistd|poll|pty|termios|signal|spawn|grp|pwd|netdb|stdlib|dirent|errno|limits|time)\\.h$")

function(check_file file may foreign)
  file(STRINGS "${file}" includes REGEX "^[ \t]*#[ \t]*include")
  foreach(line IN LISTS includes)
    if(line MATCHES "#[ \t]*include[ \t]*\"([^\"]+)\"")
      set(header "${CMAKE_MATCH_1}")
      set(permitted "${may}")
    elseif(line MATCHES "#[ \t]*include[ \t]*<([^>]+)>")
      set(header "${CMAKE_MATCH_1}")
      if(NOT header MATCHES "/" AND NOT header MATCHES "\\.(h|hpp)$")
        continue()
      endif()
      set(is_system FALSE)
      foreach(pattern IN LISTS system_headers)
        if(header MATCHES "${pattern}")
          set(is_system TRUE)
        endif()
      endforeach()
      if(is_system)
        continue()
      endif()
      set(permitted "${foreign}")
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

# layer(FOLDER MAY folders and headers of the project... FOREIGN third-party headers...): every folder may include itself
# and drivers/text/. TOP: only the files directly in the folder.
function(layer folder)
  cmake_parse_arguments(ARG "TOP" "" "MAY;FOREIGN" ${ARGN})
  set(may "${folder}/" drivers/text/ ${ARG_MAY})
  if(ARG_TOP)
    file(GLOB files "${SOURCE_DIR}/${folder}/*.h" "${SOURCE_DIR}/${folder}/*.cc")
  else()
    file(GLOB_RECURSE files "${SOURCE_DIR}/${folder}/*.h" "${SOURCE_DIR}/${folder}/*.cc")
    set(listed "${listed};${folder}" PARENT_SCOPE)
  endif()
  if(ABCAL_EXTRA_FILE MATCHES "^${folder}=(.+)$")
    list(APPEND files "${CMAKE_MATCH_1}")
  endif()
  foreach(file IN LISTS files)
    check_file("${file}" "${may}" "${ARG_FOREIGN}")
    math(EXPR checked "${checked} + 1")
  endforeach()
  set(violations "${violations}" PARENT_SCOPE)
  set(checked "${checked}" PARENT_SCOPE)
endfunction()

# --- drivers -------------------------------------------------------------------------------------------------------------
layer(drivers/text)
layer(drivers/instrument FOREIGN Eigen/)
layer(drivers/wire MAY drivers/instrument/ FOREIGN boost/ libserialport.h fmt/ Eigen/)
layer(drivers/manual_stage MAY drivers/instrument/ drivers/wire/ FOREIGN boost/ fmt/ Eigen/)
# Every folder with a driver.cc is a driver; all have the same rule.
file(GLOB registrations RELATIVE "${SOURCE_DIR}" "${SOURCE_DIR}/drivers/*/driver.cc")
foreach(registration IN LISTS registrations)
  get_filename_component(driver ${registration} DIRECTORY)
  layer(${driver} MAY drivers/instrument/ drivers/wire/ drivers/registry.h FOREIGN boost/ fmt/ Eigen/)
endforeach()
layer(drivers TOP MAY drivers/ FOREIGN fmt/)

# --- protocol ------------------------------------------------------------------------------------------------------------
set(angle drivers/instrument/angle.h)
# Analysis and uncertainty cannot even name an instrument.
set(numbers ${angle} protocol/plan/effect_sizes.h protocol/plan/limits.h protocol/plan/tolerances.h protocol/record/run_record.h protocol/model/)
layer(protocol/plan MAY ${angle} FOREIGN Eigen/ fmt/)
layer(protocol/model MAY ${angle} protocol/plan/effect_sizes.h FOREIGN Eigen/)
layer(protocol/gravity MAY ${angle} FOREIGN fmt/)
layer(protocol/record MAY ${angle} drivers/instrument/clock.h protocol/plan/ FOREIGN Eigen/ unsupported/Eigen/ fmt/ sqlite3.h openssl/)
layer(protocol/run MAY drivers/instrument/ protocol/plan/ protocol/record/ FOREIGN Eigen/ fmt/ boost/math/)
layer(protocol/analysis MAY ${numbers} FOREIGN Eigen/ fmt/ boost/math/ Random123/ hwy/)
layer(protocol/uncertainty MAY ${numbers} protocol/analysis/ FOREIGN Eigen/ fmt/ boost/math/ boost/sort/ Random123/ hwy/)

# --- sim -----------------------------------------------------------------------------------------------------------------
# Written apart from what it checks: neither protocol nor a driver's codec.
layer(sim MAY drivers/instrument/ drivers/wire/ FOREIGN Eigen/ boost/ fmt/ Random123/)

# --- app -----------------------------------------------------------------------------------------------------------------
# commands, console -> session -> bench, results; report, compare, certificate -> results.
layer(app/xml FOREIGN libxml/ fmt/)
layer(app/units MAY app/xml/ protocol/plan/ FOREIGN fmt/)
layer(app/toml MAY app/system/ ${angle} protocol/plan/ FOREIGN toml++/ Eigen/ fmt/)
layer(app/system MAY drivers/instrument/ protocol/run/ FOREIGN fmt/ hwy/ spdlog/)
layer(app/bench MAY app/toml/ app/system/ drivers/ protocol/plan/ protocol/record/ protocol/run/ protocol/gravity/ sim/
  FOREIGN toml++/ Eigen/ nlohmann/ fmt/ boost/)
layer(app/results MAY app/bench/ app/system/ drivers/instrument/ protocol/ sim/ FOREIGN Eigen/ nlohmann/ fmt/)
layer(app/export MAY app/system/ protocol/ FOREIGN Eigen/ nlohmann/ fmt/)
layer(app/planner MAY app/bench/ app/results/ app/toml/ drivers/instrument/ drivers/text/ protocol/ sim/ FOREIGN toml++/ Eigen/ fmt/)
layer(app/robustness MAY app/results/ drivers/instrument/ protocol/ sim/ FOREIGN Eigen/ nlohmann/ fmt/)
layer(app/document MAY app/system/ app/xml/ FOREIGN lcms2.h libxml/ nlohmann/ qpdf/ fmt/)
layer(app/compare MAY app/results/ app/units/ app/xml/ app/system/ protocol/ FOREIGN Eigen/ libxml/ nlohmann/ fmt/)
layer(app/laboratory MAY app/system/ drivers/instrument/clock.h protocol/record/ FOREIGN soci/ sodium.h nlohmann/ fmt/)
layer(app/certificate MAY app/laboratory/ app/results/ drivers/instrument/clock.h app/document/ app/system/ app/units/ app/xml/ app/toml/ protocol/ FOREIGN
  Eigen/ unsupported/Eigen/ boost/math/ libxml/ nlohmann/ openssl/ unicode/ xmlsec/ fmt/)
layer(app/report MAY app/results/ app/document/ app/system/ protocol/ FOREIGN Eigen/ H5Cpp.h nlohmann/ fmt/)
layer(app/session MAY app/bench/ app/compare/ app/laboratory/ app/results/ app/system/ app/toml/ drivers/instrument/ drivers/wire/ protocol/ sim/
  FOREIGN Eigen/ boost/ nlohmann/ fmt/)
layer(app/self_test MAY app/bench/ app/certificate/ app/document/ app/laboratory/ app/results/ app/session/ app/system/ app/xml/ drivers/instrument/clock.h protocol/
  FOREIGN libxml/ openssl/ sqlite3.h fmt/)
layer(app/emulate MAY app/bench/ app/system/ drivers/instrument/ drivers/wire/ sim/ FOREIGN boost/ nlohmann/ fmt/)
set(below_people app/bench/ app/certificate/ app/compare/ app/document/ app/emulate/ app/export/ app/laboratory/ app/planner/ app/report/ app/results/ app/robustness/
  app/self_test/ app/session/ app/system/ app/toml/ app/units/ app/xml/ drivers/ protocol/ sim/)
layer(app/console MAY ${below_people} FOREIGN Eigen/ boost/ nlohmann/ openssl/ unicode/ fmt/)
layer(app/commands MAY ${below_people} app/console/ FOREIGN CLI/ Eigen/ boost/ mpi.h nlohmann/ fmt/)
layer(app TOP MAY app/ drivers/ protocol/ sim/ FOREIGN CLI/ boost/ curl/ matio.h nlohmann/ fmt/ hwy/)

# --- Nothing is left out ---------------------------------------------------------------------------------------------------
set(unlisted "")
foreach(top app drivers protocol sim)
  file(GLOB_RECURSE files RELATIVE "${SOURCE_DIR}" "${SOURCE_DIR}/${top}/*.h" "${SOURCE_DIR}/${top}/*.cc")
  if(ABCAL_EXTRA_FOLDER MATCHES "^${top}/")
    list(APPEND files "${ABCAL_EXTRA_FOLDER}/any.cc")
  endif()
  foreach(file IN LISTS files)
    get_filename_component(folder "${file}" DIRECTORY)
    if(folder STREQUAL top)
      continue()
    endif()
    set(found FALSE)
    foreach(known IN LISTS listed)
      string(FIND "${folder}/" "${known}/" at)
      if(at EQUAL 0)
        set(found TRUE)
      endif()
    endforeach()
    if(NOT found)
      list(APPEND unlisted "${folder}")
    endif()
  endforeach()
endforeach()
list(REMOVE_DUPLICATES unlisted)

if(checked LESS 20)
  message(FATAL_ERROR "only ${checked} files found below ${SOURCE_DIR}: the check looks in the wrong place")
endif()
if(unlisted)
  list(JOIN unlisted ", " names)
  message(FATAL_ERROR "no rule for ${names}: add a line to tests/layering_check.cmake with what it may include")
endif()
if(violations)
  message(FATAL_ERROR "includes that point the wrong way:\n${violations}")
endif()
message(STATUS "${checked} files include only what their layer may")
