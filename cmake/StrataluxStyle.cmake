# SPDX-License-Identifier: Apache-2.0
# Style checks as tests.
# The tree is formatted as clang-format 14 (Debian 12) does it; another version breaks other lines.
find_program(CLANG_FORMAT_PROGRAM clang-format)
if(CLANG_FORMAT_PROGRAM)
  execute_process(COMMAND "${CLANG_FORMAT_PROGRAM}" --version OUTPUT_VARIABLE clang_format_version)
  string(REGEX MATCH "version 14\\." is_clang_format_14 "${clang_format_version}")
  add_feature_info(format-check is_clang_format_14 "style.format, by clang-format 14")
endif()
add_test(NAME style.includes COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-includes.py")
add_test(NAME style.includes_selftest COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-includes-selftest.sh")
add_test(NAME style.spdx COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style.sh" spdx)
add_test(NAME style.spdx_selftest COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style-selftest.sh" spdx)
add_test(NAME style.scratch COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style.sh" scratch)
add_test(NAME style.scratch_selftest COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style-selftest.sh" scratch)
set(style_tests style.includes style.includes_selftest style.spdx style.spdx_selftest style.scratch
    style.scratch_selftest)
if(is_clang_format_14)
  add_test(NAME style.format COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style.sh" format)
  add_test(NAME style.format_selftest COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style-selftest.sh" format)
  list(APPEND style_tests style.format style.format_selftest)
endif()
set_tests_properties(${style_tests} PROPERTIES LABELS style)
