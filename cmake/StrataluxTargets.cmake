# SPDX-License-Identifier: Apache-2.0
# Target macros. One library per folder, named after its path: shared/image -> stratalux_shared_image.

# stratalux_cold(TARGET): words, rows and pages; optimising them costs a build more than it gains any run.
function(stratalux_cold name)
  if(STRATALUX_COLD_LIGHTLY)
    # There GCC takes an optional's value for read before it is set (maybe-uninitialized).
    target_compile_options(${name} PRIVATE $<$<CONFIG:Release>:-O1> $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized>)
  endif()
endfunction()

# What most sources read is read once, for those that are optimised and for the cold ones. Only where sources are compiled
# several together: the other presets find an include that is missing.
set(STRATALUX_HEADERS <algorithm> <array> <atomic> <chrono> <cmath> <condition_variable> <cstdint> <deque> <filesystem> <fstream>
    <functional> <map> <memory> <mutex> <numeric> <optional> <random> <set> <span> <sstream> <string> <string_view> <thread>
    <unordered_map> <utility> <variant> <vector> <Eigen/Core> <Eigen/Geometry>)
# Once precompiled, GCC's own std::string is warned of by its analysis of flow (as with -Wno-restrict), by each version in
# another way; the presets without still hear it of our lines.
set(STRATALUX_PRECOMPILED_OPTIONS $<$<CXX_COMPILER_ID:GNU>:-Wno-array-bounds -Wno-maybe-uninitialized -Wno-stringop-overflow
                                  -Wno-stringop-overread>)
function(stratalux_precompile name headers)
  if(CMAKE_UNITY_BUILD)
    target_compile_options(${name} PRIVATE "${STRATALUX_PRECOMPILED_OPTIONS}")
    target_precompile_headers(${name} REUSE_FROM ${headers})
  endif()
endfunction()
if(CMAKE_UNITY_BUILD)
  file(CONFIGURE OUTPUT "${CMAKE_BINARY_DIR}/generated/headers.cc" CONTENT "" @ONLY)
  foreach(headers stratalux_headers stratalux_cold_headers)
    add_library(${headers} OBJECT "${CMAKE_BINARY_DIR}/generated/headers.cc")
    target_precompile_headers(${headers} PRIVATE ${STRATALUX_HEADERS})
    target_link_libraries(${headers} PRIVATE Eigen3::Eigen)
  endforeach()
  stratalux_cold(stratalux_cold_headers)
endif()

# stratalux_library(NAME [COLD] SOURCES a.cc ... DEPS target ...): a static library, or an interface one without sources.
function(stratalux_library name)
  cmake_parse_arguments(ARG "COLD" "" "SOURCES;DEPS;PRIVATE_DEPS" ${ARGN})
  if(ARG_SOURCES)
    add_library(${name} STATIC ${ARG_SOURCES})
    if(ARG_COLD)
      stratalux_cold(${name})
      stratalux_precompile(${name} stratalux_cold_headers)
    else()
      stratalux_precompile(${name} stratalux_headers)
    endif()
    target_link_libraries(${name} PUBLIC ${ARG_DEPS} PRIVATE ${ARG_PRIVATE_DEPS})
  else()
    add_library(${name} INTERFACE)
    target_link_libraries(${name} INTERFACE ${ARG_DEPS})
  endif()
endfunction()

# What `cmake --install` installs; `cmake --build --preset release --target programs` builds no test.
add_custom_target(programs)
# The tests of label unit.
add_custom_target(unit_tests)

# stratalux_manual(PROGRAM PACKAGE): its manual page and completions, which it makes of its own table of options.
include(GNUInstallDirs)
function(stratalux_manual program package)
  set(page "${CMAKE_BINARY_DIR}/share/man/man1/${program}.1")
  set(bash "${CMAKE_BINARY_DIR}/share/bash-completion/completions/${program}")
  set(zsh "${CMAKE_BINARY_DIR}/share/zsh/vendor-completions/_${program}")
  set(fish "${CMAKE_BINARY_DIR}/share/fish/vendor_completions.d/${program}.fish")
  set(files "${page}" "${bash}" "${zsh}" "${fish}")
  foreach(file IN LISTS files)
    get_filename_component(folder "${file}" DIRECTORY)
    file(MAKE_DIRECTORY "${folder}")
    string(REPLACE "${CMAKE_BINARY_DIR}/share" "${CMAKE_INSTALL_DATADIR}" there "${folder}")
    install(FILES "${file}" DESTINATION "${there}" COMPONENT ${package})
  endforeach()
  add_custom_command(TARGET ${program} POST_BUILD BYPRODUCTS ${files} VERBATIM
                     COMMAND ${program} manual man > "${page}" COMMAND ${program} manual bash > "${bash}"
                     COMMAND ${program} manual zsh > "${zsh}" COMMAND ${program} manual fish > "${fish}")
endfunction()

# stratalux_program(NAME SOURCES ... DEPS ... [PACKAGE p]): a program in build/<preset>/bin, and in the package of its name or in p.
function(stratalux_program name)
  cmake_parse_arguments(ARG "COLD" "PACKAGE" "SOURCES;DEPS" ${ARGN})
  if(NOT ARG_PACKAGE)
    set(ARG_PACKAGE ${name})
  endif()
  add_executable(${name} ${ARG_SOURCES})
  if(ARG_COLD)
    stratalux_cold(${name})
  endif()
  target_link_libraries(${name} PRIVATE ${ARG_DEPS})
  install(TARGETS ${name} RUNTIME COMPONENT ${ARG_PACKAGE})
  add_dependencies(programs ${name})
  stratalux_manual(${name} ${ARG_PACKAGE})
endfunction()

# stratalux_test_build(TARGET [COMPUTES]): how a test is compiled, and GoogleTest's headers read once for all: otherwise tests
# take most of the time that the whole build takes. Without optimisation a test compiles in two thirds of the time, and those
# whose own lines solve with Eigen take twenty times as long to run: these are the ones that say COMPUTES.
function(stratalux_test_build name)
  cmake_parse_arguments(ARG "COMPUTES" "" "" ${ARGN})
  if(ARG_COMPUTES)
    set(headers stratalux_test_headers)
    set(level -O1)
  else()
    set(headers stratalux_plain_test_headers)
    set(level -O0)
  endif()
  target_compile_definitions(${name} PRIVATE STRATALUX_SOURCE_DIR="${CMAKE_SOURCE_DIR}" STRATALUX_BIN_DIR="${CMAKE_BINARY_DIR}/bin")
  target_compile_options(${name} PRIVATE $<$<CONFIG:Release>:${level}> "${STRATALUX_PRECOMPILED_OPTIONS}")
  target_link_libraries(${name} PRIVATE GTest::gtest GTest::gmock GTest::gtest_main)
  # Where sources are compiled several together (CMAKE_UNITY_BUILD): a sample of tests takes 61 s one by one, 42 s in fours.
  set_target_properties(${name} PROPERTIES UNITY_BUILD_BATCH_SIZE 4)
  if(NOT name STREQUAL headers)
    target_precompile_headers(${name} REUSE_FROM ${headers})
  endif()
endfunction()
if(STRATALUX_BUILD_TESTS)
  # Programs, since tests are: headers read with other flags could not be used.
  file(CONFIGURE OUTPUT "${CMAKE_BINARY_DIR}/generated/test_headers.cc" CONTENT "" @ONLY)
  foreach(headers stratalux_test_headers stratalux_plain_test_headers)
    add_executable(${headers} "${CMAKE_BINARY_DIR}/generated/test_headers.cc")
    target_precompile_headers(${headers} PRIVATE ${STRATALUX_HEADERS} <gmock/gmock.h> <gtest/gtest.h>)
    target_link_libraries(${headers} PRIVATE Eigen3::Eigen)
  endforeach()
  stratalux_test_build(stratalux_test_headers COMPUTES)
  stratalux_test_build(stratalux_plain_test_headers)
endif()

# stratalux_tests(NAME [COMPUTES] LABEL unit|integration SOURCES x_test.cc ... DEPS ...): one test binary a folder, one ctest
# a TEST().
function(stratalux_tests name)
  cmake_parse_arguments(ARG "COMPUTES" "LABEL;TIMEOUT" "SOURCES;DEPS" ${ARGN})
  if(NOT ARG_LABEL)
    set(ARG_LABEL unit)
  endif()
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE ${ARG_DEPS})
  if(ARG_COMPUTES)
    stratalux_test_build(${name} COMPUTES)
  else()
    stratalux_test_build(${name})
  endif()
  if(ARG_LABEL STREQUAL unit)
    add_dependencies(unit_tests ${name})
  endif()
  # No test may pass because an earlier program computed or learnt it.
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 60 PROPERTIES LABELS ${ARG_LABEL} TIMEOUT ${ARG_TIMEOUT}
                       ENVIRONMENT "STRATALUX_CACHE=" ENVIRONMENT_MODIFICATION "STATE_DIRECTORY=set:/nonexistent")
endfunction()

# stratalux_night(PART COMMAND program ... ENVIRONMENT A=1 ... TIMEOUT seconds [COST seconds] [THREADS n] [TURN name]): the whole number
# of a law whose sample runs with the other tests. Only `ctest -C night` (scripts/test.sh --night) runs it, with one place
# more than there are cores, for the parts of one thread wait more than they compute. COST: how long it takes, for ctest
# begins with the longest. THREADS: how many of the places it takes. TURN: the turn that it belongs to; each night runs
# one of them, and what has none.
function(stratalux_night part)
  cmake_parse_arguments(ARG "" "TIMEOUT;COST;THREADS;TURN" "COMMAND;ENVIRONMENT" ${ARGN})
  if(NOT ARG_COST)
    set(ARG_COST 100)
  endif()
  if(NOT ARG_THREADS)
    set(ARG_THREADS 1)
  endif()
  set(labels night)
  if(ARG_TURN)
    list(APPEND labels turn.${ARG_TURN})
  endif()
  add_test(NAME night.${part} CONFIGURATIONS night COMMAND ${ARG_COMMAND})
  set_tests_properties(night.${part} PROPERTIES LABELS "${labels}" TIMEOUT ${ARG_TIMEOUT} ENVIRONMENT "${ARG_ENVIRONMENT}" COST ${ARG_COST}
                       PROCESSORS ${ARG_THREADS})
endfunction()
