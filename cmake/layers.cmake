# Permitted includes of each folder of app, drivers, protocol and sim: layers point one way (docs/architecture.md).
# layer(FOLDER [TOP] MAY folders and headers of the project... FOREIGN headers of libraries...)
# Every folder may include itself and drivers/text/. TOP: only the files that stand directly in the folder.
# Two programs read this list: cmake/AbcalDoors.cmake makes the include roots of the targets, so that a forbidden include
# does not compile; tests/layering_check.cmake reads the files, and also covers libraries and folders that are not listed.

# --- drivers -------------------------------------------------------------------------------------------------------------
layer(drivers/text FOREIGN fmt/)
layer(drivers/instrument FOREIGN Eigen/ fmt/)
layer(drivers/wire MAY drivers/instrument/ FOREIGN boost/ libserialport.h fmt/ Eigen/)
# A folder with a driver.cc is a driver; all drivers have the same rule.
file(GLOB registrations RELATIVE "${SOURCE_DIR}" "${SOURCE_DIR}/drivers/*/driver.cc")
foreach(registration IN LISTS registrations)
  get_filename_component(driver ${registration} DIRECTORY)
  layer(${driver} MAY drivers/instrument/ drivers/wire/ drivers/registry.h FOREIGN boost/ fmt/ Eigen/ libxml/)
endforeach()
layer(drivers TOP MAY drivers/ FOREIGN fmt/)

# --- protocol ------------------------------------------------------------------------------------------------------------
set(angle drivers/instrument/angle.h)
# Estimators and uncertainty cannot even name an instrument.
set(numbers ${angle} protocol/quantities/output_names.h protocol/linear/ protocol/statistics/ protocol/plan/ protocol/record/run_record.h protocol/record/stage_record.h protocol/model/)
layer(protocol/plan MAY ${angle} FOREIGN Eigen/ fmt/)
layer(protocol/linear FOREIGN Eigen/)
layer(protocol/model MAY ${angle} protocol/plan/effect_sizes.h protocol/plan/limits.h protocol/plan/tolerances.h FOREIGN Eigen/)
layer(protocol/statistics FOREIGN boost/math/)
layer(protocol/gravity MAY ${angle} FOREIGN fmt/)
layer(protocol/record MAY ${angle} drivers/instrument/clock.h protocol/plan/ FOREIGN Eigen/ unsupported/Eigen/ fmt/ nlohmann/ sqlite3.h openssl/)
layer(protocol/run MAY drivers/instrument/ protocol/plan/ protocol/model/ protocol/record/ protocol/statistics/ FOREIGN Eigen/ fmt/)
layer(protocol/estimators MAY ${numbers} FOREIGN Eigen/ fmt/ Random123/ hwy/)
layer(protocol/quantities MAY ${numbers} protocol/estimators/shared/ FOREIGN Eigen/ fmt/)
layer(protocol/uncertainty MAY ${numbers} protocol/estimators/ FOREIGN Eigen/ fmt/ boost/math/ boost/sort/ Random123/ hwy/)
layer(protocol/temperature MAY ${numbers} protocol/estimators/ FOREIGN Eigen/ fmt/)

# --- sim -----------------------------------------------------------------------------------------------------------------
# Independent of the code that it tests: it includes neither protocol nor a driver's codec.
layer(sim MAY drivers/instrument/ drivers/wire/ FOREIGN Eigen/ boost/ fmt/ Random123/)

# --- app -----------------------------------------------------------------------------------------------------------------
# The true values of a simulated bench, without its instruments.
set(truth sim/bench_truth.h sim/counter_noise.h sim/emulated_serial_numbers.h sim/fault_kinds.h)
set(clock drivers/instrument/clock.h)
layer(app/system MAY ${clock} protocol/record/run_interrupted.h FOREIGN fmt/ hwy/ spdlog/)
layer(app/formats MAY app/system/ ${angle} protocol/plan/ FOREIGN Eigen/ fmt/ libxml/ toml++/)
layer(app/document MAY app/system/ app/formats/ FOREIGN cairo/ fmt/ lcms2.h libxml/ nlohmann/ pango/ qpdf/)
layer(app/bench_file MAY app/system/ app/formats/ drivers/instrument/ protocol/plan/ protocol/gravity/ protocol/record/ ${truth}
  FOREIGN Eigen/ fmt/ nlohmann/ toml++/)
layer(app/witness MAY app/system/ app/document/ ${angle} ${clock} protocol/plan/ protocol/record/ FOREIGN fmt/ nlohmann/)
set(ground app/system/ app/formats/ app/document/ app/bench_file/ app/witness/)
layer(app/measure MAY ${ground} drivers/ protocol/plan/ protocol/gravity/ protocol/record/ protocol/run/ protocol/estimators/ protocol/linear/
  protocol/model/ protocol/statistics/ sim/ FOREIGN Eigen/ nlohmann/ fmt/ boost/)
layer(app/results MAY ${ground} drivers/instrument/ protocol/ sim/ FOREIGN toml++/ Eigen/ nlohmann/ fmt/)
layer(app/analysed_run MAY app/measure/ app/results/ ${ground} drivers/ protocol/ sim/ FOREIGN Eigen/)
layer(app/laboratory MAY ${ground} app/results/ drivers/instrument/ protocol/ ${truth}
  FOREIGN soci/ sodium.h Eigen/ unsupported/Eigen/ libxml/ nlohmann/ openssl/ unicode/ xmlsec/ fmt/)
layer(app/studies MAY ${ground} app/results/ drivers/instrument/ protocol/ sim/ FOREIGN Eigen/ mpi.h nlohmann/ fmt/)
layer(app/console MAY ${ground} app/measure/ app/analysed_run/ app/results/ app/laboratory/ drivers/ protocol/ sim/
  FOREIGN Eigen/ boost/ libxml/ nlohmann/ openssl/ unicode/ fmt/)
layer(app/commands MAY app/ drivers/ protocol/ sim/ FOREIGN CLI/ Eigen/ boost/ libxml/ nlohmann/ openssl/ sqlite3.h fmt/)
layer(app/library MAY app/ drivers/ protocol/ sim/ abcal/ FOREIGN Eigen/ nlohmann/ pybind11/ fmt/)
layer(app TOP MAY app/ drivers/ protocol/ sim/ FOREIGN CLI/ H5Cpp.h boost/ curl/ matio.h nlohmann/ fmt/ hwy/)
