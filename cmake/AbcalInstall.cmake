# Contents of `cmake --install` and of the Debian packages: the program with its manual, completions, examples, rules for
# ports and a service; and, as a component of its own, the estimators as a library.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

# Packing must not build the tests; the files to be installed are built before.
set(CMAKE_SKIP_INSTALL_ALL_DEPENDENCY ON)

# Date of the manual and the changelog: that of the sources, so that a build can be repeated bit for bit.
set(ABCAL_SOURCE_DATE "$ENV{SOURCE_DATE_EPOCH}")
find_package(Git QUIET)
if(NOT ABCAL_SOURCE_DATE AND Git_FOUND)
  execute_process(COMMAND ${GIT_EXECUTABLE} -C ${PROJECT_SOURCE_DIR} log -1 --format=%ct
    OUTPUT_VARIABLE ABCAL_SOURCE_DATE OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
endif()

# --- the program ---------------------------------------------------------------------------------------------------
install(TARGETS abcal RUNTIME COMPONENT abcal)
# Where abcal looks for them (app/system/helper_program.cc).
install(TARGETS abcal-guard abcal-hdf5 abcal-mat abcal-transfer abcal-pdf abcal-sign abcal-witness RUNTIME DESTINATION libexec/abcal COMPONENT abcal)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/schemas DESTINATION ${CMAKE_INSTALL_DATADIR}/abcal COMPONENT abcal)
if(TARGET abcal-mpi)
  install(TARGETS abcal-mpi RUNTIME COMPONENT abcal)
endif()

# Manual pages and completions come from the command line's own tree. gzip -n: no time stamp, the same bits each time.
find_program(ABCAL_GZIP gzip REQUIRED)
set(manual_folder ${PROJECT_BINARY_DIR}/manual)
add_custom_command(OUTPUT ${manual_folder}/done
  COMMAND ${CMAKE_COMMAND} -E rm -rf ${manual_folder}
  COMMAND ${CMAKE_COMMAND} -E env SOURCE_DATE_EPOCH=${ABCAL_SOURCE_DATE} ${CMAKE_CROSSCOMPILING_EMULATOR} $<TARGET_FILE:abcal> --write-manual ${manual_folder}
  COMMAND sh -c "${ABCAL_GZIP} -9n '${manual_folder}'/*.1"
  COMMAND ${CMAKE_COMMAND} -E touch ${manual_folder}/done
  DEPENDS abcal VERBATIM COMMENT "Manual pages and completions")
add_custom_target(manual ALL DEPENDS ${manual_folder}/done)
install(DIRECTORY ${manual_folder}/ DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT abcal
  FILES_MATCHING PATTERN "*.1.gz")
install(FILES ${manual_folder}/abcal.bash DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions
  RENAME abcal COMPONENT abcal)
install(FILES ${manual_folder}/_abcal DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/vendor-completions COMPONENT abcal)

install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs/examples/cpp DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/libabcal-dev/examples
  COMPONENT dev)
# The pages that messages and the command line's help name, with examples, pictures and notebooks. The changelog has its own
# place as well.
install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs/ DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT doc
  PATTERN "examples/cpp" EXCLUDE PATTERN ".*" EXCLUDE)
# The same pages with a search, which scripts/docs builds before scripts/package comes here.
set(ABCAL_SITE "" CACHE PATH "Folder of the built site of the pages; empty: the package has none")
if(ABCAL_SITE)
  install(DIRECTORY ${ABCAL_SITE}/ DESTINATION ${CMAKE_INSTALL_DOCDIR}/site COMPONENT doc)
endif()
install(FILES ${PROJECT_SOURCE_DIR}/docs/udev/60-abcal.rules DESTINATION lib/udev/rules.d COMPONENT abcal)
# The services name the programs by their paths, which only the installation knows (cmake --install --prefix).
install(CODE "
  set(ABCAL_PROGRAM_PATH \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_BINDIR}/abcal\")
  set(ABCAL_HELPER_PATH \"\${CMAKE_INSTALL_PREFIX}/libexec/abcal\")
  file(READ \"${PROJECT_SOURCE_DIR}/cmake/packaging/hardening.conf\" ABCAL_SERVICE_HARDENING)
  foreach(service abcal-bench abcal-console abcal-witness)
    configure_file(\"${PROJECT_SOURCE_DIR}/cmake/packaging/\${service}.service.in\"
      \"${PROJECT_BINARY_DIR}/packaging/\${service}.service\" @ONLY)
  endforeach()" COMPONENT abcal)
install(FILES ${PROJECT_BINARY_DIR}/packaging/abcal-bench.service ${PROJECT_BINARY_DIR}/packaging/abcal-console.service
  ${PROJECT_BINARY_DIR}/packaging/abcal-witness.service DESTINATION lib/systemd/system COMPONENT abcal)

# --- the estimators as a library -------------------------------------------------------------------------------------
set(library_targets abcal_instrument abcal_messages abcal_plan abcal_linear abcal_statistics abcal_model abcal_record abcal_estimators)
foreach(target IN LISTS library_targets)
  string(REPLACE abcal_ "" name ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${name})
endforeach()
install(TARGETS ${library_targets} EXPORT abcal-targets ARCHIVE COMPONENT dev
  INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/abcal)
foreach(folder drivers/instrument drivers/text tests/contract protocol/plan protocol/statistics protocol/model protocol/record protocol/estimators)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/${folder}/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/abcal/${folder}
    COMPONENT dev FILES_MATCHING PATTERN "*.h")
endforeach()

# --- the library with the stable face, and its module for Python -------------------------------------------------------
install(TARGETS abcal_library EXPORT abcal-library-targets
  LIBRARY COMPONENT library NAMELINK_COMPONENT dev INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}
    ${CMAKE_INSTALL_INCLUDEDIR}/abcal)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/app/library/abcal/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/abcal COMPONENT dev
  FILES_MATCHING PATTERN "*.h")
install(FILES ${PROJECT_SOURCE_DIR}/drivers/registry.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/abcal/drivers COMPONENT dev)
install(FILES ${PROJECT_SOURCE_DIR}/drivers/wire/byte_stream.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/abcal/drivers/wire
  COMPONENT dev)
if(TARGET abcal_python)
  set(ABCAL_PYTHON_FOLDER lib/python3/dist-packages CACHE STRING "Where the module for Python is installed")
  install(TARGETS abcal_python LIBRARY DESTINATION ${ABCAL_PYTHON_FOLDER}/abcal COMPONENT python)
  install(FILES ${PROJECT_SOURCE_DIR}/app/library/python/abcal/__init__.py ${PROJECT_SOURCE_DIR}/app/library/python/abcal/__init__.pyi
    ${PROJECT_SOURCE_DIR}/app/library/python/abcal/py.typed DESTINATION ${ABCAL_PYTHON_FOLDER}/abcal COMPONENT python)
endif()

# Matrices pass between library and program, so that both must align them alike: Eigen changes that with -mavx or GCC's
# address sanitizer. The library is compiled with Eigen's alignment without them.
foreach(target IN LISTS library_targets ITEMS abcal_library)
  target_compile_definitions(${target} INTERFACE
    $<INSTALL_INTERFACE:EIGEN_MAX_ALIGN_BYTES=16> $<INSTALL_INTERFACE:EIGEN_MALLOC_ALREADY_ALIGNED=1>)
endforeach()

set(package_folder ${CMAKE_INSTALL_LIBDIR}/cmake/abcal)
install(EXPORT abcal-library-targets NAMESPACE abcal:: DESTINATION ${package_folder} COMPONENT dev)
install(EXPORT abcal-targets NAMESPACE abcal:: DESTINATION ${package_folder} COMPONENT dev)
configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/packaging/abcal-config.cmake.in
  ${PROJECT_BINARY_DIR}/packaging/abcal-config.cmake INSTALL_DESTINATION ${package_folder})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/packaging/abcal-config-version.cmake
  COMPATIBILITY SameMajorVersion)
install(FILES ${PROJECT_BINARY_DIR}/packaging/abcal-config.cmake
  ${PROJECT_BINARY_DIR}/packaging/abcal-config-version.cmake DESTINATION ${package_folder} COMPONENT dev)

# --- Debian packages: cpack -G DEB -----------------------------------------------------------------------------------
set(documents ${PROJECT_BINARY_DIR}/packaging)
string(TIMESTAMP ABCAL_CHANGELOG_DATE "%a, %d %b %Y %H:%M:%S +0000" UTC)
if(ABCAL_SOURCE_DATE)
  execute_process(COMMAND date -u -R -d "@${ABCAL_SOURCE_DATE}" OUTPUT_VARIABLE ABCAL_CHANGELOG_DATE
    OUTPUT_STRIP_TRAILING_WHITESPACE)
endif()
configure_file(${PROJECT_SOURCE_DIR}/cmake/packaging/changelog.Debian.in ${documents}/changelog.Debian @ONLY)
configure_file(${PROJECT_SOURCE_DIR}/docs/changelog.md ${documents}/changelog COPYONLY)
foreach(name changelog changelog.Debian)
  execute_process(COMMAND ${ABCAL_GZIP} -9nf ${documents}/${name} COMMAND_ERROR_IS_FATAL ANY)
endforeach()
set(package_components abcal dev doc library)
if(TARGET abcal_python)
  list(APPEND package_components python)
endif()
set(package_of_abcal abcal)
set(package_of_dev libabcal-dev)
set(package_of_doc abcal-doc)
set(package_of_library libabcal1)
set(package_of_python python3-abcal)
foreach(component IN LISTS package_components)
  set(package ${package_of_${component}})
  install(FILES ${PROJECT_SOURCE_DIR}/cmake/packaging/copyright ${documents}/changelog.gz
    ${documents}/changelog.Debian.gz DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component})
endforeach()

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME abcal)
set(CPACK_PACKAGE_CONTACT "abcal maintainers <maintainers@example.org>")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "")  # each package has its own, the first line of its description
set(CPACK_COMPONENTS_ALL ${package_components})
set(CPACK_SET_DESTDIR ON)  # so that what is installed sees the final prefix
set(CPACK_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
  OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_HOMEPAGE "https://example.org/abcal")
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)

set(CPACK_DEBIAN_ABCAL_PACKAGE_NAME abcal)
set(CPACK_DEBIAN_ABCAL_PACKAGE_SECTION science)
set(CPACK_DEBIAN_ABCAL_PACKAGE_SHLIBDEPS ON)
# The backend of the register is loaded when a register is opened, and fonts when a PDF is written, which dpkg-shlibdeps cannot see.
set(CPACK_DEBIAN_ABCAL_PACKAGE_DEPENDS "adduser, fonts-dejavu-core, libsoci-sqlite3-4.0 | libsoci-sqlite3-4.0t64")
set(CPACK_DEBIAN_ABCAL_PACKAGE_RECOMMENDS "abcal-doc (= ${PROJECT_VERSION}-1), gnuplot-nox, weasyprint, libsoci-postgresql4.0 | libsoci-postgresql4.0t64")
set(CPACK_DEBIAN_ABCAL_PACKAGE_CONTROL_EXTRA ${PROJECT_SOURCE_DIR}/cmake/packaging/postinst
  ${PROJECT_SOURCE_DIR}/cmake/packaging/prerm)
set(CPACK_COMPONENT_ABCAL_DESCRIPTION "calibrates triaxial accelerometers with gravity
abcal drives a two-axis rotation stage through three rotation experiments,
averages the accelerometer's readings at each angle, and computes the 3x3
sensitivity matrix, the offsets and the intrinsic properties with their
uncertainties (NIST's ABC protocol). Instruments may be real, emulated by
another process, or simulated in the program.")

set(CPACK_DEBIAN_DOC_PACKAGE_NAME abcal-doc)
set(CPACK_DEBIAN_DOC_PACKAGE_SECTION doc)
set(CPACK_DEBIAN_DOC_PACKAGE_ARCHITECTURE all)
# Before, the package abcal held these files (0.1, 0.2). No Breaks: `dpkg -i *.deb` comes to this package before the new abcal,
# and would refuse it.
set(CPACK_DEBIAN_DOC_PACKAGE_REPLACES "abcal (<= 0.2.0-1)")
set(CPACK_COMPONENT_DOC_DESCRIPTION "calibrates triaxial accelerometers with gravity, pages and examples
The pages of abcal: tutorial, bench files, estimators and their theory,
certificates, the library for C++ and Python, drivers and their protocols,
with example bench files and notebooks.")

set(CPACK_DEBIAN_DEV_PACKAGE_NAME libabcal-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS
  "libabcal1 (= ${PROJECT_VERSION}-1), libeigen3-dev, libfmt-dev, libhwy-dev, libsqlite3-dev, libssl-dev, pkgconf")
set(CPACK_COMPONENT_DEV_DESCRIPTION "calibrations of accelerometers, for C++ programs
Headers and a CMake package: find_package(abcal COMPONENTS library) gives the
target abcal::abcal with records, estimators, planner, Monte Carlo, runs on a
bench and certificates; abcal::estimators are the estimators alone, as static
libraries. The contract suite for drivers in other repositories is with them.")

set(CPACK_DEBIAN_LIBRARY_PACKAGE_NAME libabcal1)
set(CPACK_DEBIAN_LIBRARY_PACKAGE_SECTION libs)
set(CPACK_DEBIAN_LIBRARY_PACKAGE_SHLIBDEPS ON)
# The guard that halts a stage and the schemas of certificates come with the program.
set(CPACK_DEBIAN_LIBRARY_PACKAGE_DEPENDS "abcal (= ${PROJECT_VERSION}-1)")
install(FILES ${PROJECT_SOURCE_DIR}/cmake/packaging/libabcal1.lintian-overrides
  DESTINATION ${CMAKE_INSTALL_DATADIR}/lintian/overrides RENAME libabcal1 COMPONENT library)
file(WRITE ${documents}/triggers "activate-noawait ldconfig\n")
file(WRITE ${documents}/shlibs "libabcal 1 libabcal1 (>= ${PROJECT_VERSION})\n")
set(CPACK_DEBIAN_LIBRARY_PACKAGE_CONTROL_EXTRA ${documents}/triggers ${documents}/shlibs)
set(CPACK_COMPONENT_LIBRARY_DESCRIPTION "calibrations of accelerometers, shared library
What abcal does, for other programs: records, estimators with covariances,
planner, Monte Carlo, forward model, comparison, certificates, and runs on a
bench with the same safety as the command line.")

if(TARGET abcal_python)
  math(EXPR next_python "${ABCAL_PYTHON_MINOR} + 1")
  set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-abcal)
  set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
  # Compiled for one Python.
  set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "libabcal1 (= ${PROJECT_VERSION}-1), python3 (>= 3.${ABCAL_PYTHON_MINOR}), \
python3 (<< 3.${next_python}), python3-numpy, libc6, libgcc-s1, libstdc++6")
  set(CPACK_DEBIAN_PYTHON_PACKAGE_SUGGESTS "python3-pandas, python3-uncertainties, python3-xarray")
  set(CPACK_COMPONENT_PYTHON_DESCRIPTION "calibrations of accelerometers, for Python
import abcal: records from run files and NumPy arrays, estimators with
labelled covariances, planner, Monte Carlo, simulation, comparison,
certificates, and runs on a bench with callbacks or as an asynchronous
iterator.")
endif()
include(CPack)
